//! A node whose bit rate is not that of the bus disturbs the others hardly at all, says so on the
//! serial monitor, and comes back on a bus of its rate.
//! `crates/mcp2515-ordered/tests/another_rate.rs` has the same for the driver alone, for longer and
//! with more nodes.

use std::cell::RefCell;
use std::rc::Rc;

use bench::Cycles;
use bench::can::{Frame, Id, RecordKind, SoftNode};
use bench::dronecan::Value;
use rig::{ARRAY_COMMAND, MS, Program, Rig, STATUS_OF_NODE, has_preset_remote};

/// Limits: error frames of each node after it has come to the bus, and the delay of a frame of the
/// others.
const ERRORS: usize = 20;
const LATEST: Cycles = 50 * MS;

/// The bit rates that the board has.
fn rates() -> Vec<u32> {
    let fastest = rig::board().fastest_bit_rate();
    [125_000, 250_000, 500_000, 1_000_000].into_iter().filter(|&rate| rate <= fastest).collect()
}

/// The EEPROM of a node that was set to this bit rate.
fn eeprom_of(rate: u32) -> Vec<u8> {
    let mut rig = Rig::running();
    rig.set("CAN_BAUDRATE", i64::from(rate));
    rig.save();
    rig.board().avr().eeprom()
}

/// Two stations that talk beside the peer, which acknowledges.
struct Others {
    stations: [Rc<RefCell<SoftNode>>; 2],
    /// Time between two frames.
    period_ms: u64,
    sent: u32,
    due: Vec<Cycles>,
    latest: Cycles,
    error_frames: usize,
    of_node: usize,
}

impl Others {
    fn join(rig: &mut Rig, bit_rate: u32) -> Others {
        let stations = [(); 2].map(|()| Rc::new(RefCell::new(SoftNode::new(bit_rate))));
        for station in &stations {
            rig.bench.attach("other", station.clone());
        }
        Others {
            stations,
            period_ms: 20,
            sent: 0,
            due: vec![],
            latest: 0,
            error_frames: 0,
            of_node: 0,
        }
    }

    /// Runs for `ms` milliseconds, in which they send a command in each period, in turn.
    fn run_ms(&mut self, rig: &mut Rig, ms: u64) {
        let end = rig.now() + ms * MS;
        while rig.now() < end {
            let now = rig.now();
            let [n0, n1, n2, n3] = self.sent.to_be_bytes();
            let frame = Frame::extended(ARRAY_COMMAND | 10, &[n0, n1, n2, n3, 0x55, 0x55, 0, 0xC0]);
            self.stations[self.sent as usize % 2].borrow_mut().send_at(now, frame);
            self.due.push(now);
            self.sent += 1;
            rig.bench.run_until(now + self.period_ms * MS);
            self.collect(rig);
        }
    }

    fn collect(&mut self, rig: &mut Rig) {
        for record in rig.bench.bus().take_records() {
            let RecordKind::Frame { frame, .. } = record.kind else {
                self.error_frames += 1;
                continue;
            };
            if frame.id == Id::Extended(ARRAY_COMMAND | 10) {
                let n = u32::from_be_bytes(*frame.data().first_chunk().unwrap());
                self.latest = self.latest.max(record.end - self.due[n as usize]);
            } else {
                self.of_node += usize::from(rig::is_from_node(&frame));
            }
        }
        for board in rig.bench.boards() {
            let text = board.avr_mut().serial_take();
            rig.serial.extend(text.into_iter().map(|(_, byte)| char::from(byte)));
        }
    }
}

/// Starts `nodes` nodes of `rate` on a bus of another rate, and checks the limits.
#[track_caller]
fn assert_quiet(bit_rate: u32, rate: u32, nodes: usize, is_plugged_in: bool) {
    let what = format!("{nodes} of {rate} bit/s on a bus of {bit_rate}");
    let eeprom = eeprom_of(rate);
    let elf = Program::Preset.elf();
    let mut rig = Rig::on_bus_of(bit_rate, &elf, &vec![&eeprom[..]; nodes]);
    let mut others = Others::join(&mut rig, bit_rate);
    if !is_plugged_in {
        rig.connect_node(false);
        others.run_ms(&mut rig, 2500);
        assert_eq!(others.error_frames, 0, "{what}");
        rig.connect_node(true);
    }
    others.run_ms(&mut rig, 2000);
    println!("{what}: {} error frames, {} us", others.error_frames, others.latest / 16);
    assert!(others.error_frames <= ERRORS * nodes, "{what}: {} error frames", others.error_frames);
    assert!(others.latest <= LATEST, "{what}: {} us late", others.latest / 16);
    assert_eq!(others.of_node, 0, "{what}");
    if !has_preset_remote() {
        assert!(rig.serial.contains("another bit rate or crystal"), "{what}\n{}", rig.serial);
    }
}

/// Some of the pairs of a bus's rate and another one.
fn pairs() -> [(u32, u32); 3] {
    let fastest = rig::board().fastest_bit_rate();
    [(fastest, 125_000), (fastest, fastest / 2), (125_000, fastest)]
}

#[test]
#[ignore = "takes long: make test-all"]
fn a_node_that_starts_on_a_bus_of_another_rate_disturbs_few_frames_at_each_pair() {
    for bit_rate in rates() {
        for rate in rates().into_iter().filter(|&rate| rate != bit_rate) {
            assert_quiet(bit_rate, rate, 1, true);
        }
    }
}

#[test]
#[ignore = "takes long: make test-all"]
fn a_node_that_is_plugged_into_a_bus_of_another_rate_disturbs_few_frames() {
    for (bit_rate, rate) in pairs() {
        assert_quiet(bit_rate, rate, 1, false);
    }
}

/// The others send a frame each `period_ms`. Between them each error that the node does not hear
/// looks like silence.
#[track_caller]
fn assert_quiet_with_little_traffic(rate: u32, period_ms: u64) {
    let fastest = rig::board().fastest_bit_rate();
    let what = format!("{rate} bit/s beside a frame each {period_ms} ms");
    let mut rig = Rig::on_bus_of(fastest, &Program::Preset.elf(), &[&eeprom_of(rate)]);
    let mut others = Others::join(&mut rig, fastest);
    others.period_ms = period_ms;
    others.run_ms(&mut rig, 2000);
    let first = std::mem::take(&mut others.error_frames);
    println!("{what}: {first} error frames");
    assert!(first <= ERRORS, "{what}: {first} error frames");
    others.run_ms(&mut rig, 4000);
    assert_eq!((others.error_frames, others.of_node), (0, 0), "{what}\n{}", rig.serial);
}

#[test]
#[ignore = "takes long: make test-all"]
fn after_its_start_a_node_of_any_other_rate_disturbs_no_frame_of_a_bus_with_little_traffic() {
    let fastest = rig::board().fastest_bit_rate();
    for rate in rates().into_iter().filter(|&rate| rate != fastest) {
        for period_ms in [500, 1000] {
            assert_quiet_with_little_traffic(rate, period_ms);
        }
    }
}

#[test]
#[ignore = "takes long: make test-all"]
fn several_nodes_of_another_rate_disturb_few_frames() {
    let fastest = rig::board().fastest_bit_rate();
    assert_quiet(fastest, fastest / 2, 4, true);
}

/// A node with CAN_BAUDRATE 0 on a bus of each rate. It disturbs few frames, and answers.
#[test]
fn a_node_that_finds_the_rate_is_on_the_bus_within_a_second() {
    let elf = Program::Full.elf();
    let eeprom = {
        let mut rig = Rig::with_firmware(&elf);
        rig.wait_until_up();
        rig.set("CAN_BAUDRATE", 0);
        rig.save();
        rig.board().avr().eeprom()
    };
    for bit_rate in rates() {
        let mut rig = Rig::on_bus_of(bit_rate, &elf, &[&eeprom]);
        let mut others = Others::join(&mut rig, bit_rate);
        others.run_ms(&mut rig, 1000);
        println!("{bit_rate}: {} error frames, {} us", others.error_frames, others.latest / 16);
        assert!(others.of_node > 0, "{bit_rate} bit/s\n{}", rig.serial);
        assert!(others.error_frames <= ERRORS, "{bit_rate}: {} errors", others.error_frames);
        assert!(others.latest <= LATEST, "{bit_rate}: {} us late", others.latest / 16);
        // It has the rate, and answers.
        assert_eq!(rig.parameter("CAN_BAUDRATE").value, Value::Integer(0));
    }
}

/// The saved rate is wrong. The node is silent on the bus, and comes back on one of its rate, where
/// the rate can be set and saved.
#[test]
fn a_wrong_rate_that_was_saved_is_corrected_on_a_bus_of_that_rate() {
    let fastest = rig::board().fastest_bit_rate();
    let elf = Program::Preset.elf();
    for rate in rates().into_iter().filter(|&rate| rate != fastest) {
        let mut rig = Rig::on_bus_of(rate, &elf, &[&eeprom_of(rate)]);
        // Nobody else sends.
        rig.wait_for("a status", 1000, |rig| !rig.statuses().is_empty());
        rig.set("CAN_BAUDRATE", i64::from(fastest));
        rig.save();
        let eeprom = rig.board().avr().eeprom();
        Rig::on_bus_of(fastest, &elf, &[&eeprom]).wait_until_up();
    }
}

#[test]
#[ignore = "takes long: make test-all"]
fn a_node_that_is_alone_tries_its_status_every_second() {
    let mut rig = Rig::powered();
    let port = rig.peer_port;
    rig.bench.bus().connect(port, false);
    // Once it is error-passive, nobody destroys its frames.
    rig.run_ms(3000);
    rig.forget();
    rig.run_ms(10_000);
    let status = Id::Extended(STATUS_OF_NODE);
    let statuses = rig.traffic.iter().filter(|(_, frame)| frame.id == status).count();
    assert!((9..=11).contains(&statuses), "{statuses} in 10 s");
}
