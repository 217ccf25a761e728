//! The node on a bus of this PC: `cargo run -p own-node --example pc -- mcast:0`, or
//! `slcan:/dev/ttyACM0`, or `can0`. It keeps its parameters in memory.

use std::collections::{HashMap, VecDeque};
use std::convert::Infallible;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use dronecan_host::link::Bus;
use dronecan_host::{Frame, Id};
use embedded_can::nb::Can;
use embedded_can::{ExtendedId, Frame as _};
use mcp2515_ordered::AnyFrame;
use own_node::{Action, Node, PARAMETERS, Storage};

fn main() -> Result<()> {
    let bus = std::env::args().nth(1).context("which bus? For example mcast:0")?;
    let mut link = Link::new(Bus::new(bus.parse().map_err(anyhow::Error::msg)?, 1_000_000, None));
    link.bus.open(Duration::ZERO)?;
    let start = Instant::now();
    let mut node = Node::new(link, Memory::default(), *b"own-node on a PC");
    println!("on {bus}");
    loop {
        let Ok(action) = node.turn(start.elapsed().as_millis() as u32, 300 * 32);
        match action {
            Some(Action::Move(thousandths)) => println!("move to {thousandths} thousandths"),
            Some(Action::Restart) => println!("restart"),
            None => std::thread::sleep(Duration::from_millis(1)),
        }
    }
}

#[derive(Default)]
struct Memory(HashMap<usize, i32>);

impl Storage for Memory {
    fn load(&mut self, at: usize) -> Option<i32> {
        self.0.get(&at).copied()
    }

    fn store(&mut self, values: &[i32; PARAMETERS.len()]) -> bool {
        self.0 = values.iter().copied().enumerate().collect();
        true
    }
}

/// A bus of this PC as a driver of `embedded-can`.
struct Link {
    bus: Bus,
    start: Instant,
    received: VecDeque<AnyFrame>,
}

impl Link {
    fn new(bus: Bus) -> Self {
        Self { bus, start: Instant::now(), received: VecDeque::new() }
    }
}

impl Can for Link {
    type Frame = AnyFrame;
    type Error = Infallible;

    fn transmit(&mut self, frame: &AnyFrame) -> nb::Result<Option<AnyFrame>, Infallible> {
        if let embedded_can::Id::Extended(id) = frame.id() {
            self.bus.send(self.start.elapsed(), Frame::extended(id.as_raw(), frame.data()));
        }
        Ok(None)
    }

    fn receive(&mut self) -> nb::Result<AnyFrame, Infallible> {
        if self.received.is_empty() {
            let frames = self.bus.serve(self.start.elapsed());
            self.received.extend(frames.iter().filter_map(|frame| match frame.id {
                Id::Extended(id) => AnyFrame::new(ExtendedId::new(id)?, frame.data()),
                Id::Standard(_) => None,
            }));
        }
        self.received.pop_front().ok_or(nb::Error::WouldBlock)
    }
}
