//! Tests of SLCAN adapters with clients at their ports, some of which misbehave.

use std::cell::RefCell;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

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
    stand.peer.borrow_mut().send(Frame::extended(0x1801_552A, &[0xAB, 0xCD]));
    stand.peer.borrow_mut().send(Frame::standard(0x123, &[]));
    stand.run_ms(2);
    assert_eq!(stand.read(), "T1801552A2ABCD\rt1230\r");
    assert_eq!(stand.request("Z1\r"), "\r");
    let now_ms = stand.bench.now() / crate::links::MS;
    stand.peer.borrow_mut().send(Frame::standard(0x123, &[]));
    stand.run_ms(2);
    assert_eq!(stand.read(), format!("t1230{now_ms:04X}\r"));
}

#[test]
fn a_closed_adapter_does_not_send_receive_or_acknowledge() {
    let mut stand = Stand::new();
    assert_eq!(stand.request("t1230\r"), "\x07");
    stand.peer.borrow_mut().send(Frame::standard(0x7FF, &[]));
    stand.run_ms(5);
    assert_eq!(stand.read(), "");
    assert_eq!(stand.peer.borrow().queued(), 1, "no station acknowledges");
    assert_eq!(stand.request("S8\rO\r"), "\r\rt7FF0\r");
    assert_eq!(stand.request("C\r"), "\r");
    stand.peer.borrow_mut().send(Frame::standard(0x7FF, &[]));
    stand.run_ms(5);
    assert_eq!(stand.peer.borrow().queued(), 1);
}

#[test]
fn an_adapter_in_listen_mode_does_not_acknowledge() {
    let mut stand = Stand::new();
    assert_eq!(stand.request("S8\rL\rt1230\r"), "\r\r\x07");
    stand.peer.borrow_mut().send(Frame::standard(0x7FF, &[]));
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
    for number in 0..total {
        stand.peer.borrow_mut().send(Frame::extended(number, &[]));
    }
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
    let stop = Arc::new(AtomicBool::new(false));
    let (path, stopped) = (stand.path.clone(), stop.clone());
    let flooder = thread::spawn(move || {
        let mut client = Client::open(&path);
        while !stopped.load(Ordering::Relaxed) {
            if client.write_some(&[b'x'; 4096]) == 0 {
                thread::yield_now();
            }
        }
    });
    for number in 0..200 {
        stand.peer.borrow_mut().send(Frame::standard(number, &[]));
        stand.run_ms(1);
    }
    stop.store(true, Ordering::Relaxed);
    flooder.join().unwrap();
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
    for number in 0..1500 {
        stand.peer.borrow_mut().send(Frame::standard(number, &[]));
    }
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

/// Every frame arrives, in order.
#[test]
fn a_full_bus_of_client_traffic_loses_no_frame() {
    const FRAMES: u64 = 10_000;
    let scratch = Scratch::new();
    let (from, to) = (scratch.path("from"), scratch.path("to"));
    let mut bench = Bench::new(BIT_RATE);
    let mut sender = slcan::open(&from, &mut bench).unwrap();
    let mut receiver = slcan::open(&to, &mut bench).unwrap();
    let received = Arc::new(AtomicU64::new(0));
    let stop = Arc::new(AtomicBool::new(false));
    let (reader_received, reader_stop) = (received.clone(), stop.clone());
    let reader = thread::spawn(move || {
        let mut client = Client::open(&to);
        client.write(b"S8\rO\r");
        let mut text = Vec::new();
        while !reader_stop.load(Ordering::Relaxed) {
            text.extend(client.read());
            let lines = text.iter().filter(|byte| **byte == b'\r').count() as u64;
            reader_received.store(lines.saturating_sub(2), Ordering::Relaxed);
            thread::sleep(Duration::from_millis(1));
        }
        text
    });
    let writer_stop = stop.clone();
    let writer = thread::spawn(move || {
        let mut client = Client::open(&from);
        client.write(b"S8\rO\r");
        let text: Vec<u8> =
            (0..FRAMES).flat_map(|n| format!("T1404562A8{n:016x}\r").into_bytes()).collect();
        let mut rest = text.as_slice();
        while !rest.is_empty() && !writer_stop.load(Ordering::Relaxed) {
            rest = &rest[client.write_some(rest)..];
            client.read();
        }
    });
    // The receiver must be on the bus before the first frame is sent.
    for _ in 0..1000 {
        receiver.serve(&bench);
        if receiver.status().contains("open") {
            break;
        }
        thread::sleep(Duration::from_millis(1));
    }
    bench.run_for_ms(1);
    let (mut carried, mut rounds_left) = (0, 30_000);
    while received.load(Ordering::Relaxed) < FRAMES && rounds_left > 0 {
        // The simulation must not run ahead of the test's threads by too much.
        if carried - received.load(Ordering::Relaxed).min(carried) > 2000 {
            receiver.serve(&bench);
        } else {
            run_ms(&mut bench, &mut [&mut sender, &mut receiver], 1);
            let before = std::mem::replace(&mut carried, bench.bus().stats().frames);
            if carried != before {
                continue;
            }
        }
        rounds_left -= 1;
        thread::sleep(Duration::from_millis(1));
    }
    stop.store(true, Ordering::Relaxed);
    writer.join().unwrap();
    let text = reader.join().unwrap();
    assert_eq!((sender.lost(), receiver.lost()), ((0, 0), (0, 0)));
    let numbers: Vec<u64> = text
        .split(|byte| *byte == b'\r')
        .filter(|line| line.first() == Some(&b'T'))
        .map(|line| u64::from_str_radix(std::str::from_utf8(&line[10..]).unwrap(), 16).unwrap())
        .collect();
    assert_eq!(numbers.len() as u64, FRAMES);
    assert!(numbers.iter().enumerate().all(|(index, number)| index as u64 == *number));
}
