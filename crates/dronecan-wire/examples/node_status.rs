//! Makes the frame of a NodeStatus: `cargo run --example node_status`.

use dronecan_wire::{Data, Id, Sender, types};

fn main() {
    let id = Id::message(24, types::NODE_STATUS.id, 42);
    let status = [60, 0, 0, 0, 0, 0, 0]; // Up for 60 s, healthy, operational.
    let (mut sender, mut data) = (Sender::new(), Data::EMPTY);
    sender.begin(status.len() as u8, 0, types::NODE_STATUS.seed);
    while !sender.is_ready() {
        sender.step(&status[..], &mut data);
    }
    println!("send {:02X?} {:02X?}", id.to_bytes(), data.as_slice());
}
