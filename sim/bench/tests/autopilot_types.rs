//! The simulated autopilots send what the real ones send: the types, their priorities, frames and
//! rates. They are compared with the recordings in tests/data.

use bench::autopilot::{Autopilot, Profile, Settings};
use bench::can::{Frame, Id, SoftNode};
use bench::dronecan::{CanId, NodeId, NodeInfo, NodeStatus, TransferId, frames, message, types};
use bench::{Bench, Cycles, F_CPU_HZ};
use flate2::read::GzDecoder;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::rc::Rc;

const MS: Cycles = F_CPU_HZ / 1000;
/// Types that a real ArduPilot sends only if a parameter switches them on: `CAN_D1_UC_OPTION` 256
/// and `NTF_LED_TYPES` 32. PX4 sends LightsCommand unless `UAVCAN_LGT_NUM` is 0, as in its
/// recording.
const SWITCHED_ON: [&str; 3] = ["Stats", "CanStats", "LightsCommand"];

/// Transfers and frames of one type.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Count {
    transfers: u32,
    frames: u32,
}

/// The types of node 10 or 1 with their priorities.
type Counts = BTreeMap<(String, u8), Count>;

fn count(counts: &mut Counts, frame: &Frame) {
    let (Id::Extended(raw), Some(tail)) = (frame.id, frame.data().last()) else { return };
    let Some(id) = CanId::parse(raw) else { return };
    let (CanId::Message { priority, .. } | CanId::Service { priority, .. }) = id else { return };
    let entry = counts.entry((message::name_of(id), priority)).or_default();
    entry.transfers += u32::from(tail & 0x80 != 0);
    entry.frames += 1;
}

/// The frames of a recording from `from_s` to `to_s` seconds.
fn recorded(name: &str, from_s: f64, to_s: f64) -> Counts {
    let path = format!("{}/../../tests/data/{name}.log.gz", env!("CARGO_MANIFEST_DIR"));
    let lines = BufReader::new(GzDecoder::new(File::open(path).unwrap())).lines();
    let mut counts = Counts::new();
    for line in lines.map(Result::unwrap) {
        let (time, frame) = line.strip_prefix('(').unwrap().split_once(") can0 ").unwrap();
        let time: f64 = time.parse().unwrap();
        if (from_s..to_s).contains(&time) {
            count(&mut counts, &frame.parse().unwrap());
        }
    }
    counts.retain(|(name, _), _| !SWITCHED_ON.contains(&name.as_str()));
    counts
}

/// A bus with an autopilot, a listener, and node 120, which sends its status once a second and
/// answers GetNodeInfo.
struct Bus {
    bench: Bench,
    autopilot: Autopilot,
    listener: Rc<RefCell<SoftNode>>,
    node: Rc<RefCell<SoftNode>>,
}

impl Bus {
    fn new(settings: Settings) -> Bus {
        let mut bench = Bench::new(1_000_000);
        let autopilot = Autopilot::new(settings, 1_000_000);
        let [listener, node] = [(); 2].map(|()| Rc::new(RefCell::new(SoftNode::new(1_000_000))));
        bench.attach("autopilot", autopilot.station());
        bench.attach("listener", listener.clone());
        bench.attach("node", node.clone());
        Bus { bench, autopilot, listener, node }
    }

    /// What the autopilot sends in the next `seconds`.
    fn run(&mut self, seconds: u64) -> Counts {
        let mut counts = Counts::new();
        let source = NodeId::new(120).unwrap();
        let end = self.bench.now() + seconds * F_CPU_HZ;
        while self.bench.now() < end {
            let now = self.bench.now();
            if (now / MS).is_multiple_of(1000) {
                let second = (now / F_CPU_HZ) as u32;
                let status = NodeStatus { uptime_s: second, ..NodeStatus::default() };
                let id = types::NODE_STATUS.message_id(16, source);
                for frame in frames(id, &status.encode(), TransferId::new(second as u8)) {
                    self.node.borrow_mut().send_at(now, frame);
                }
            }
            self.autopilot.advance(now + MS);
            self.bench.run_for_ms(1);
            self.node.borrow_mut().take_received();
            let received = self.listener.borrow_mut().take_received();
            for (_, frame) in received {
                if !matches!(frame.id, Id::Extended(id) if id & 0x7F == 120) {
                    count(&mut counts, &frame);
                    self.answer(&frame);
                }
            }
        }
        counts
    }

    /// Answers a GetNodeInfo request.
    fn answer(&mut self, request: &Frame) {
        let Id::Extended(raw) = request.id else { return };
        let Some(CanId::Service { priority, service_id: 1, request: true, destination, source }) =
            CanId::parse(raw)
        else {
            return;
        };
        let (source, destination) = (destination, source);
        let id = CanId::Service { priority, service_id: 1, request: false, destination, source };
        let info: NodeInfo =
            NodeInfo { name: b"org.example.servo".to_vec(), ..NodeInfo::default() };
        let transfer_id = TransferId::new(request.data()[0]);
        for frame in frames(id, &info.encode(), transfer_id) {
            self.node.borrow_mut().send_at(self.bench.now(), frame);
        }
    }
}

/// Asserts the same types, priorities and frames, and rates that differ by at most a seventh (a
/// software in the loop sleeps longer than it wants to), or by two transfers.
#[track_caller]
fn assert_equal(simulated: &Counts, recorded: &Counts) {
    let names = |counts: &Counts| counts.keys().cloned().collect::<BTreeSet<_>>();
    assert_eq!(names(simulated), names(recorded), "types and priorities");
    for (kind, real) in recorded {
        let ours = simulated[kind];
        let each = |count: Count| f64::from(count.frames) / f64::from(count.transfers);
        assert!((each(ours) - each(*real)).abs() < 0.02, "{kind:?}: {ours:?}, {real:?}");
        let difference = ours.transfers.abs_diff(real.transfers);
        assert!(difference <= 2.max(real.transfers / 7), "{kind:?}: {ours:?}, {real:?}");
    }
}

#[test]
fn ardupilot_sends_what_arduplane_sent_while_it_was_disarmed_and_in_flight() {
    let settings = Settings { servos: 7, motors: 3, ..Settings::of(Profile::Ardupilot) };
    let mut bus = Bus::new(settings);
    bus.autopilot.set_armed(false);
    assert_equal(&bus.run(7), &recorded("ardupilot/flight-arming", 1.1, 8.1));
    bus.autopilot.set_armed(true);
    assert_equal(&bus.run(20), &recorded("ardupilot/flight-arming", 10.0, 30.0));
}

#[test]
fn ardupilot_sends_what_arduplane_sent_to_eight_fast_motors() {
    let settings =
        Settings { servos: 0, motors: 8, motor_rate_hz: 400, ..Settings::of(Profile::Ardupilot) };
    let mut bus = Bus::new(settings);
    bus.run(3);
    assert_equal(&bus.run(5), &recorded("ardupilot/motors-400hz", 1.3, 6.3));
}

#[test]
fn ardupilot_leaves_the_throttle_out_of_its_commands_while_disarmed() {
    let settings = Settings {
        servos: 4,
        actuator: 1,
        omits_disarmed: true,
        ..Settings::of(Profile::Ardupilot)
    };
    let mut bus = Bus::new(settings);
    bus.run(2);
    // ARMING_REQUIRE 2: armed from 31 to 40 s, then disarmed.
    assert_equal(&bus.run(9), &recorded("ardupilot/rearm-refused", 31.0, 40.0));
    bus.autopilot.set_armed(false);
    bus.run(1);
    assert_equal(&bus.run(10), &recorded("ardupilot/rearm-refused", 42.0, 52.0));
}

/// PX4 sends as many commands for motors as its loop makes: 322 a second here.
#[test]
fn px4_sends_what_px4_sent_while_it_was_armed() {
    let mut bus =
        Bus::new(Settings { motors: 4, motor_rate_hz: 322, ..Settings::of(Profile::Px4) });
    bus.run(2);
    let mut simulated = bus.run(4);
    let lights = ("LightsCommand".to_owned(), 31);
    assert_eq!(simulated.remove(&lights).map(|count| count.transfers), Some(40));
    assert_equal(&simulated, &recorded("px4/motors", 11.0, 15.0));
}
