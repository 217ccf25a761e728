//! The bus with stations without faults: time, records, totals, horizon, cables.

use super::*;
use std::cell::Cell;

const COMMAND: &str = "1003F20A#01000038C7";

/// Requests are between bits and at boundaries. The idle bits before them are skipped.
#[test]
fn a_frame_starts_at_the_first_bit_boundary_from_its_time_on() {
    for after in [0, 1, 15, 16, 17, 16_000, 1_000_001] {
        let mut rig = Rig::of(2);
        let due = rig.bus.now() + after;
        rig.nodes[0].borrow_mut().send_at(due, frame(COMMAND));
        rig.run_bits(after / BIT + 300);
        let record = rig.bus.take_records()[0];
        assert_eq!(record.start, due.next_multiple_of(BIT), "{after}");
    }
}

#[test]
fn a_record_has_the_frame_s_bits_and_times() {
    let mut rig = Rig::of(2);
    let start = rig.bus.now();
    rig.send(0, frame(COMMAND));
    rig.run_bits(200);
    let bits = frame(COMMAND).wire_bits().len() as u32;
    let end = start + u64::from(bits) * BIT;
    let kind = RecordKind::Frame { frame: frame(COMMAND), from: Some(rig.ports[0]), acked: true };
    assert_eq!(rig.bus.take_records(), [Record { start, end, bits, kind }]);
    assert_eq!(rig.bus.take_records(), []);
    let received = rig.nodes[1].borrow_mut().take_received();
    assert_eq!(received, [(end - BIT, frame(COMMAND))]);
}

#[test]
fn frames_of_one_node_leave_in_the_order_of_their_times_then_of_their_calls() {
    let mut rig = Rig::of(2);
    let now = rig.bus.now();
    {
        let mut node = rig.nodes[0].borrow_mut();
        node.send_at(now + 100_000, frame("001#"));
        node.send(frame("7FF#01"));
        node.send(frame("7FF#02"));
        node.send_at(now + 50_000, frame("7FF#03"));
        node.send_at(now + 50_000, frame("100#04"));
        assert_eq!(node.queued(), 5);
    }
    rig.run_bits(10_000);
    let order = ["7FF#01", "7FF#02", "7FF#03", "100#04", "001#"].map(frame);
    assert_eq!(rig.received(1), order);
    assert_eq!(rig.nodes[0].borrow().queued(), 0);
}

/// A frame that is queued for an earlier time must not replace the one on the wire.
#[test]
fn a_frame_queued_during_a_transmission_waits() {
    let mut rig = Rig::of(2);
    rig.send(0, frame("100#01"));
    rig.run_bits(20);
    rig.nodes[0].borrow_mut().send_at(0, frame("100#02"));
    rig.run_bits(200);
    assert_eq!(rig.received(1), ["100#01", "100#02"].map(frame));
}

#[test]
fn a_cleared_queue_keeps_only_the_frame_on_the_wire() {
    let mut rig = Rig::of(2);
    rig.send(0, frame("100#01"));
    rig.send(0, frame("100#02"));
    rig.run_bits(20);
    rig.nodes[0].borrow_mut().clear_queue();
    rig.run_bits(200);
    assert_eq!(rig.received(1), [frame("100#01")]);
}

#[test]
fn the_totals_count_frames_and_busy_bits() {
    let mut rig = Rig::of(3);
    let before = rig.bus.stats();
    assert_eq!((before.busy_bits, before.total_bits), (0, 100));
    rig.send(0, frame(COMMAND));
    rig.send(1, frame(COMMAND));
    rig.send(1, frame("123#"));
    rig.run_bits(1_000);
    let stats = rig.bus.stats();
    let (command, other) = (frame(COMMAND).bit_count(), frame("123#").bit_count());
    // The two commands are identical and were sent as one, which counts for the first sender.
    assert_eq!((stats.frames, stats.error_frames), (2, 0));
    assert_eq!(stats.busy_bits, u64::from(command + other));
    assert_eq!(stats.total_bits, 1_100);
    assert_eq!((stats.ports[0].frames, stats.ports[0].bits), (1, u64::from(command)));
    assert_eq!((stats.ports[1].frames, stats.ports[1].bits), (1, u64::from(other)));
    assert_eq!(stats.ports[1].name, "node 1");
    let load = stats.load_since(&before);
    assert!((load - f64::from(command + other) / 1_000.0).abs() < 1e-9);
}

/// On an idle bus 32 bits; in a frame the bits up to the ACK slot, and then up to the one in which
/// receivers accept it.
#[test]
fn the_horizon_ends_with_the_first_bit_in_which_something_can_happen() {
    let mut rig = Rig::of(2);
    let now = rig.bus.now();
    assert_eq!(rig.bus.horizon(), now + 32 * BIT);
    rig.send(0, frame("123#"));
    assert_eq!(rig.bus.horizon(), now + BIT, "the SOF must be stepped next");
    rig.run_bits(10);
    let Bits { ack_slot, last_eof, .. } = bits_of(&frame("123#"));
    assert_eq!(rig.bus.horizon(), now + (ack_slot + 1) * BIT);
    rig.run_bits(ack_slot + 1 - 10);
    assert_eq!(rig.bus.horizon(), now + last_eof * BIT);
    rig.run_bits(last_eof - ack_slot - 1);
    assert_eq!(rig.bus.horizon(), rig.bus.now() + BIT);
    rig.run_bits(60);
    assert_eq!(rig.bus.horizon(), rig.bus.now() + 32 * BIT);
}

/// Two senders can still lose the arbitration, and a fault can hit any bit.
#[test]
fn the_horizon_is_one_bit_in_arbitration_and_while_there_is_a_fault() {
    let mut rig = Rig::of(3);
    rig.send(0, frame("123#"));
    rig.send(1, frame("124#"));
    rig.run_bits(5);
    assert_eq!(rig.bus.horizon(), rig.bus.now() + BIT);
    rig.run_bits(10);
    assert!(rig.bus.horizon() > rig.bus.now() + BIT, "one has lost");
    rig.bus.inject(Fault::BitErrorRate { per_million: 1, seed: 1 });
    assert_eq!(rig.bus.horizon(), rig.bus.now() + BIT);
}

/// A frame that is due within the next 32 bits limits the horizon to the end of its SOF.
#[test]
fn the_horizon_ends_with_the_first_bit_that_is_not_idle() {
    let rig = Rig::of(2);
    let now = rig.bus.now();
    rig.nodes[0].borrow_mut().send_at(now + 5 * BIT + 3, frame("123#"));
    assert_eq!(rig.bus.horizon(), now + 7 * BIT);
}

#[test]
fn time_passes_in_whole_bits() {
    let mut rig = Rig::of(1);
    let now = rig.bus.now();
    rig.bus.run_until(now + BIT - 1);
    assert_eq!(rig.bus.now(), now);
    rig.bus.run_until(now + BIT);
    assert_eq!(rig.bus.now(), now + BIT);
    rig.bus.run_until(now);
    assert_eq!(rig.bus.now(), now + BIT, "time must not go back");
}

#[test]
fn a_babbling_node_stops_all_frames_with_higher_identifiers() {
    let mut rig = Rig::of(3);
    rig.nodes[0].borrow_mut().babble(Some(frame("010#00")));
    rig.send(0, frame("020#"));
    rig.send(1, frame("00F#01"));
    rig.send(1, frame("011#02"));
    rig.run_bits(10_000);
    let heard = rig.received(2);
    assert_eq!(heard.iter().filter(|&&other| other != frame("010#00")).count(), 1);
    assert_eq!(heard[0], frame("00F#01"));
    let stats = rig.bus.stats();
    assert!(stats.busy_bits > 9_990);
    rig.nodes[0].borrow_mut().babble(None);
    rig.run_bits(1_000);
    let rest = rig.received(2);
    assert_eq!(rest[rest.len() - 2..], ["011#02", "020#"].map(frame));
}

/// The tap gets every change of level with its time.
#[test]
fn the_wire_tap_gets_each_change_of_level() {
    let mut rig = Rig::of(2);
    let edges: Rc<RefCell<Vec<(Cycles, Level)>>> = Rc::default();
    let log = edges.clone();
    rig.bus.set_wire_tap(Some(Box::new(move |at, level| log.borrow_mut().push((at, level)))));
    let start = rig.bus.now();
    rig.send(0, frame(COMMAND));
    rig.run_bits(200);
    let mut bits = frame(COMMAND).wire_bits();
    bits[bits_of(&frame(COMMAND)).ack_slot as usize] = Level::Dominant;
    let mut expected = Vec::new();
    let mut last = Level::Recessive;
    for (at, &level) in (start..).step_by(BIT as usize).zip(&bits) {
        if level != last {
            expected.push((at, level));
        }
        last = level;
    }
    assert_eq!(*edges.borrow(), expected);
}

/// A station that counts its calls.
#[derive(Default)]
struct Counter {
    bit_time_ps: Cell<Option<u64>>,
    busy: bool,
    stepped: u64,
    skipped: u64,
}

impl Station for Counter {
    fn drive(&mut self, _at: Cycles) -> Level {
        Level::Recessive
    }
    fn sample(&mut self, _level: Level, _at: Cycles) {
        self.stepped += 1;
    }
    fn quiet(&self, _at: Cycles) -> bool {
        !self.busy
    }
    fn transmitting(&self) -> bool {
        false
    }
    fn bit_time_ps(&self) -> Option<u64> {
        self.bit_time_ps.get()
    }
    fn skip_idle(&mut self, bits: u64) {
        self.skipped += bits;
    }
}

#[test]
fn every_idle_bit_is_either_stepped_or_skipped() {
    let counter = Rc::new(RefCell::new(Counter::default()));
    counter.borrow().bit_time_ps.set(Some(1_000_000));
    let mut bus = Bus::new(1_000_000);
    bus.attach("counter", counter.clone());
    bus.run_until(1_000 * BIT);
    assert_eq!((counter.borrow().stepped, counter.borrow().skipped), (0, 1_000));
    counter.borrow_mut().busy = true;
    bus.run_until(1_500 * BIT);
    assert_eq!((counter.borrow().stepped, counter.borrow().skipped), (500, 1_000));
}

#[test]
fn a_station_without_a_bit_time_is_not_stepped() {
    let counter = Rc::new(RefCell::new(Counter { busy: true, ..Counter::default() }));
    let mut bus = Bus::new(1_000_000);
    bus.attach("counter", counter.clone());
    bus.run_until(100 * BIT);
    assert_eq!((counter.borrow().stepped, counter.borrow().skipped), (0, 0));
    counter.borrow().bit_time_ps.set(Some(1_000_000));
    bus.run_until(200 * BIT);
    assert_eq!(counter.borrow().stepped, 100);
}

/// After an error frame and a frame with a known sender.
#[test]
fn noise_on_the_idle_bus_has_no_sender() {
    let mut rig = Rig::of(2);
    rig.bus.inject(Fault::FlipBit { bit: 50 });
    rig.send(0, frame(COMMAND));
    rig.run_bits(400);
    rig.bus.inject(Fault::BitErrorRate { per_million: 1000, seed: 1 });
    rig.run_bits(10_000);
    let sender = |record: Record| match record.kind {
        RecordKind::Frame { from, .. } | RecordKind::ErrorFrame { from, .. } => from,
    };
    let senders: Vec<_> = rig.bus.take_records().into_iter().map(sender).collect();
    assert_eq!(senders[..2], [Some(rig.ports[0]); 2]);
    assert!(senders.len() > 7 && senders[2..].iter().all(Option::is_none), "{senders:?}");
}

#[test]
fn records_that_are_not_taken_are_limited_and_counted() {
    let mut rig = Rig::of(2);
    rig.nodes[0].borrow_mut().babble(Some(frame("555#")));
    let frames = 65_536 + 10;
    rig.run_bits(u64::from(frame("555#").bit_count()) * frames);
    assert_eq!(rig.bus.stats().frames, frames);
    assert_eq!(rig.bus.stats().lost_records, 10);
    assert_eq!(rig.bus.take_records().len(), 65_536);
}

/// 83.333 kbit/s does not divide 16 MHz: bits of 192 and 193 cycles, without drift.
#[test]
fn a_bus_whose_rate_does_not_divide_the_clock_works() {
    let node = || Rc::new(RefCell::new(SoftNode::new(83_333)));
    let (sender, receiver) = (node(), node());
    let mut bus = Bus::new(83_333);
    bus.attach("sender", sender.clone());
    bus.attach("receiver", receiver.clone());
    sender.borrow_mut().send_at(16_000_000, frame(COMMAND));
    bus.run_until(17_000_000);
    let received = receiver.borrow_mut().take_received();
    assert_eq!(received.len(), 1);
    let bits = frame(COMMAND).wire_bits().len() as u64;
    let end = (83_333 + bits - 1) * 16_000_000 / 83_333;
    assert_eq!(received[0].0, end);
}
