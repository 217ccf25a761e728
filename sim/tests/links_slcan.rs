//! Tests of SLCAN adapters with clients at their ports, some of which misbehave.

use std::cell::RefCell;
use std::path::PathBuf;
use std::rc::Rc;

use crate::links::{Client, Scratch, run_ms};
use bench::Bench;
use bench::can::{Frame, Id, SoftNode};
use sim::links::slcan::{self, Slcan};

const BIT_RATE: u32 = 1_000_000;

/// An adapter on a bus with one other node.
struct Stand {
    bench: Bench,
    peer: Rc<RefCell<SoftNode>>,
    adapter: Slcan,
    client: Client,
    path: PathBuf,
    _scratch: Scratch,
}

impl Stand {
    fn new() -> Stand {
        let scratch = Scratch::new();
        let path = scratch.path("can");
        let mut bench = Bench::new(BIT_RATE);
        let peer = Rc::new(RefCell::new(SoftNode::new(BIT_RATE)));
        bench.attach("peer", peer.clone());
        let adapter = slcan::open(&path, &mut bench).unwrap();
        let client = Client::open(&path);
        Stand { bench, peer, adapter, client, path, _scratch: scratch }
    }

    fn opened() -> Stand {
        let mut stand = Stand::new();
        assert_eq!(stand.request("C\rS8\rO\r"), "\r\r\r");
        stand
    }

    fn run_ms(&mut self, milliseconds: u64) {
        run_ms(&mut self.bench, &mut [&mut self.adapter], milliseconds);
    }

    /// Writes `text`, lets two milliseconds pass, and returns the answer.
    fn request(&mut self, text: &str) -> String {
        self.client.write(text.as_bytes());
        self.run_ms(2);
        self.read()
    }

    fn read(&mut self) -> String {
        String::from_utf8(self.client.read()).unwrap()
    }

    /// Lets the peer send frames.
    fn peer_sends(&mut self, frames: impl IntoIterator<Item = Frame>) {
        frames.into_iter().for_each(|frame| self.peer.borrow_mut().send(frame));
    }

    fn take_peer_frames(&mut self) -> Vec<Frame> {
        self.peer.borrow_mut().take_received().into_iter().map(|(_, frame)| frame).collect()
    }
}

#[test]
fn the_commands_with_which_pydronecan_and_python_can_open_the_adapter_succeed() {
    let mut stand = Stand::new();
    for (command, answer) in [
        ("\r", "\r"),
        ("C\r", "\r"),
        ("S8\r", "\r"),
        ("O\r", "\r"),
        ("F\r", "F00\r"),
        ("C\rC\rC\r", "\r\r\r"),
    ] {
        assert_eq!(stand.request(command), answer, "{command:?}");
    }
    assert_eq!(stand.request("C\rS8\r\rO\rO\rV\rN\r"), "\r\r\r\r\rV1013\rNA123\r");
}

#[test]
fn frames_go_to_the_bus_in_order_and_are_confirmed() {
    let mut stand = Stand::opened();
    assert_eq!(
        stand.request("T1404562A60100a95c00c0\rt1233010203\rr1233\rR000000010\r"),
        "Z\rz\rz\rZ\r"
    );
    assert_eq!(
        stand.take_peer_frames(),
        [
            Frame::extended(0x1404_562A, &[0x01, 0x00, 0xA9, 0x5C, 0x00, 0xC0]),
            Frame::standard(0x123, &[1, 2, 3]),
            Frame::remote(Id::Standard(0x123), 3),
            Frame::remote(Id::Extended(1), 0),
        ]
    );
}

#[test]
fn the_client_gets_frames_of_the_bus_with_a_timestamp_on_request() {
    let mut stand = Stand::opened();
    stand.peer_sends([Frame::extended(0x1801_552A, &[0xAB, 0xCD])]);
    stand.peer_sends([Frame::standard(0x123, &[])]);
    stand.run_ms(2);
    assert_eq!(stand.read(), "T1801552A2ABCD\rt1230\r");
    assert_eq!(stand.request("Z1\r"), "\r");
    let now_ms = stand.bench.now() / crate::avr::MS;
    stand.peer_sends([Frame::standard(0x123, &[])]);
    stand.run_ms(2);
    assert_eq!(stand.read(), format!("t1230{now_ms:04X}\r"));
}

/// A frame that no station acknowledges stays in the peer's queue.
#[test]
fn an_adapter_that_is_closed_or_in_listen_mode_does_not_send_or_acknowledge() {
    let mut stand = Stand::new();
    let frame = Frame::standard(0x7FF, &[]);
    for (request, answer, queued, received) in [
        ("t1230\r", "\x07", 1, ""),
        // What waited arrives.
        ("S8\rO\r", "\r\rt7FF0\r", 0, "t7FF0\r"),
        ("C\r", "\r", 1, ""),
    ] {
        assert_eq!(stand.request(request), answer, "{request:?}");
        stand.peer_sends([frame]);
        stand.run_ms(5);
        assert_eq!(stand.read(), received, "{request:?}");
        assert_eq!(stand.peer.borrow().queued(), queued, "{request:?}");
    }
    let mut stand = Stand::new();
    assert_eq!(stand.request("S8\rL\rt1230\r"), "\r\r\x07");
    stand.peer_sends([frame]);
    stand.run_ms(5);
    assert_eq!(stand.peer.borrow().queued(), 1);
}

#[test]
fn another_bit_rate_is_rejected_and_the_adapter_stays_closed() {
    let mut stand = Stand::new();
    assert_eq!(stand.request("S6\rO\r"), "\x07\x07");
    let hint = stand.adapter.take_hint().unwrap();
    assert!(
        hint.ends_with("can requested 500 kbit/s, but the bus has 1000: the adapter stays closed"),
        "{hint}"
    );
    assert_eq!(stand.adapter.take_hint(), None, "each hint is given once");
    assert_eq!(stand.request("S8\rO\rS8\r"), "\r\r\x07");
}

#[test]
fn an_invalid_command_is_answered_with_the_bell_and_the_next_one_works() {
    let mut stand = Stand::opened();
    let overlong = "T".repeat(3000);
    assert_eq!(stand.request("?\rX0\rt8001\rT1404562A8\r"), "\x07".repeat(4));
    assert_eq!(stand.request(&format!("{overlong}\rV\r")), "\x07V1013\r");
    stand.client.write(&[0, 0xFF, 0x07, 0x80, b'\r']);
    assert_eq!(stand.request("t12"), "\x07");
    assert_eq!(stand.request("30\rt1230\nxy"), "z\r");
    assert_eq!(stand.request("\r"), "\x07");
    assert_eq!(stand.take_peer_frames(), [Frame::standard(0x123, &[])]);
}

/// A frame that the client wrote just before it closed the channel must not be lost.
#[test]
fn the_last_frames_go_out_before_the_channel_closes() {
    let mut stand = Stand::opened();
    let frames: String = (0..40).map(|n| format!("t1232{n:04X}\r")).collect();
    stand.client.write(format!("{frames}C\r").as_bytes());
    stand.run_ms(10);
    assert_eq!(stand.take_peer_frames().len(), 40);
    assert!(stand.read().ends_with("z\r\r") || stand.read().is_empty());
    assert!(stand.adapter.status().contains("closed"));
}

#[test]
fn a_client_that_does_not_read_loses_the_oldest_frames_and_a_flag_is_set() {
    let mut stand = Stand::opened();
    let total = 14_000u32;
    stand.peer_sends((0..total).map(|number| Frame::extended(number, &[])));
    stand.run_ms(1300);
    assert_eq!(stand.peer.borrow().queued(), 0, "the bus still works");
    let lost = stand.adapter.lost().1;
    assert!(lost > 0);
    let mut received = String::new();
    for _ in 0..100 {
        received += &stand.read();
        stand.run_ms(1);
    }
    let ids: Vec<u32> = received
        .split_terminator('\r')
        .map(|l| u32::from_str_radix(&l[1..9], 16).unwrap())
        .collect();
    assert_eq!(ids.len() as u64 + lost, u64::from(total));
    assert!(ids.is_sorted() && ids.last() == Some(&(total - 1)));
    assert_eq!(stand.request("F\r"), "F09\r");
    assert_eq!(stand.request("F\r"), "F00\r");
}

#[test]
fn a_client_that_floods_a_blocked_bus_does_not_stop_the_simulation() {
    let mut stand = Stand::opened();
    stand.bench.bus().inject(bench::can::Fault::StuckDominant(true));
    let flood = b"t1230\r".repeat(1000);
    let mut written = 0;
    for _ in 0..3000 {
        written += stand.client.write_some(&flood);
        stand.run_ms(1);
        stand.client.read();
    }
    let lost = stand.adapter.lost().0;
    assert!(lost >= 100, "{lost} of {written} bytes");
    stand.bench.bus().clear_faults();
    stand.run_ms(500);
    stand.client.read();
    let flags = stand.request("\r\rF\r");
    assert!(flags.contains('F'), "{flags:?}");
}

#[test]
fn a_flood_of_invalid_bytes_does_not_stop_the_simulation() {
    let mut stand = Stand::opened();
    for number in 0..200 {
        while stand.client.write_some(&[b'x'; 4096]) > 0 {}
        stand.peer_sends([Frame::standard(number, &[])]);
        stand.run_ms(1);
    }
    assert_eq!(stand.peer.borrow().queued(), 0);
}

#[test]
fn the_adapter_works_after_a_client_that_ended_within_a_frame() {
    let mut stand = Stand::opened();
    stand.request("T1404562A6010");
    stand.client = Client::open(&stand.path);
    assert_eq!(stand.request("\rC\rS8\rO\rt1230\r"), "\r\r\rz\r");
    assert_eq!(stand.take_peer_frames(), [Frame::standard(0x123, &[])]);
}

#[test]
fn a_new_client_does_not_get_frames_for_the_last_one() {
    let mut stand = Stand::opened();
    stand.peer_sends((0..1500).map(|number| Frame::standard(number, &[])));
    stand.run_ms(200);
    stand.client = Client::open(&stand.path);
    assert_eq!(stand.request("C\rS8\rO\r"), "\r\r\r");
}

#[test]
fn two_adapters_arbitrate_and_receive_each_others_frames_but_not_their_own() {
    let mut stand = Stand::opened();
    let scratch = Scratch::new();
    let mut other = slcan::open(&scratch.path("can2"), &mut stand.bench).unwrap();
    let mut client = Client::open(&scratch.path("can2"));
    client.write(b"S8\rO\r");
    run_ms(&mut stand.bench, &mut [&mut stand.adapter, &mut other], 2);
    client.read();
    stand.client.write(b"t2220\rt2230\r");
    client.write(b"t1110\rt1120\r");
    run_ms(&mut stand.bench, &mut [&mut stand.adapter, &mut other], 3);
    assert_eq!(stand.read(), "z\rz\rt1110\rt1120\r");
    assert_eq!(client.read(), b"z\rz\rt2220\rt2230\r");
    let ids: Vec<Id> = stand.take_peer_frames().into_iter().map(|frame| frame.id).collect();
    assert_eq!(ids, [0x111, 0x112, 0x222, 0x223].map(Id::Standard));
}

/// Every frame arrives, in order. The client writes more than the bus takes.
#[test]
fn a_full_bus_of_client_traffic_loses_no_frame() {
    const FRAMES: u64 = 10_000;
    let scratch = Scratch::new();
    let paths = [scratch.path("from"), scratch.path("to")];
    let mut bench = Bench::new(BIT_RATE);
    let [mut sender, mut receiver] = [0, 1].map(|at| slcan::open(&paths[at], &mut bench).unwrap());
    let [mut writer, mut reader] = [0, 1].map(|at| Client::open(&paths[at]));
    for client in [&mut writer, &mut reader] {
        client.write(b"S8\rO\r");
        run_ms(&mut bench, &mut [&mut sender, &mut receiver], 2);
        assert_eq!(client.read(), b"\r\r");
    }
    let text: String = (0..FRAMES).map(|n| format!("T1404562A8{n:016x}\r")).collect();
    let (mut rest, mut received) = (text.as_bytes(), Vec::new());
    for _ in 0..10_000 {
        rest = &rest[writer.write_some(rest)..];
        run_ms(&mut bench, &mut [&mut sender, &mut receiver], 1);
        writer.read();
        received.extend(reader.read());
        if received.len() >= text.len() {
            break;
        }
    }
    assert_eq!((sender.lost(), receiver.lost()), ((0, 0), (0, 0)));
    let received = String::from_utf8(received).unwrap();
    assert!(received == text.to_uppercase(), "{} of {} bytes", received.len(), text.len());
}
