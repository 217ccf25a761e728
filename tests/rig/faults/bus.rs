//! Faults of the bus.

use std::cell::RefCell;
use std::rc::Rc;

use super::{BUS_LIMIT_MS, Case, FAILSAFE, Measured, Trial};
use crate::status::{BUS_OFF, CONTROLLER, ERROR_PASSIVE};
use crate::{MS, Rig, board, started};
use bench::can::{Fault, Frame, SoftNode};

/// How long each fault lasts.
const LASTS_MS: u64 = 2500;

pub const ALL: [&Case; 14] = [
    &CABLE,
    &ALONE,
    &SHORT,
    &WRONG_RATE,
    &BABBLE,
    &NO_ACKNOWLEDGE,
    &DESTROYED,
    &DESTROYED_ALONE,
    &NOISE_5,
    &NOISE_4,
    &NOISE_3,
    &NOISE_2,
    &BROKEN_WHILE_STARTING,
    &OWN_RATE_WRONG,
];

/// Runs a case whose fault lasts [`LASTS_MS`].
fn during(fault: fn(&mut Rig, bool), line: &'static str, reported: u16) -> Measured {
    let mut trial = Trial::running();
    trial.begin(line, |rig| fault(rig, true));
    trial.live(LASTS_MS);
    trial.end(|rig| fault(rig, false));
    trial.recover(BUS_LIMIT_MS, reported)
}

/// The fields that most cases share.
const CASE: Case = Case {
    fault: "",
    noticed: "error-passive (bit 6)",
    reaction: "none needed",
    servo: FAILSAFE,
    logged_limit_ms: Some(250),
    limit_ms: BUS_LIMIT_MS,
    run: || unreachable!("each case has its own"),
};

pub const CABLE: Case = Case {
    fault: "the node's cable is pulled",
    noticed: "error-passive (bit 6), controller (bit 8)",
    reaction: "tries its frames until error-passive, then one to three a second",
    run: || during(|rig, on| rig.connect_node(!on), "CAN H/L: error-passive", CONTROLLER),
    ..CASE
};

pub const ALONE: Case = Case {
    fault: "no other node on the bus",
    noticed: "error-passive (bit 6), controller (bit 8)",
    reaction: "tries its frames until error-passive, then one to three a second",
    run: || {
        let leave = |rig: &mut Rig, on: bool| rig.bench.bus().connect(rig.peer_port, !on);
        during(leave, "CAN H/L: error-passive", CONTROLLER)
    },
    ..CASE
};

pub const SHORT: Case = Case {
    fault: "bus shorted, held dominant",
    noticed: "error-passive (bit 6), bus-off (bit 7) or controller (bit 8)",
    reaction: "the controller waits for recessive bits; old frames are dropped",
    run: || {
        let short = |rig: &mut Rig, on| {
            // The driver writes the filters again. The controller may join the free bus, and
            // overflow, before the driver polls it.
            rig.overflows_expected = true;
            rig.bench.bus().inject(Fault::StuckDominant(on));
        };
        during(short, "CAN H/L: ", 0)
    },
    ..CASE
};

pub const WRONG_RATE: Case = Case {
    fault: "another node sends all the time at half the bit rate",
    run: || {
        let mut trial = Trial::running();
        let intruder = Rc::new(RefCell::new(SoftNode::new(board().fastest_bit_rate() / 2)));
        let port = trial.rig.bench.attach("intruder", intruder.clone());
        trial.begin("CAN H/L: error-passive", |_| {
            intruder.borrow_mut().babble(Some(Frame::extended(0x123, &[0x55; 8])))
        });
        trial.live(LASTS_MS);
        trial.end(|rig| {
            intruder.borrow_mut().babble(None);
            rig.bench.bus().connect(port, false);
        });
        assert!(trial.statistics().is_none_or(|statistics| statistics.rx_errors > 0));
        trial.recover(BUS_LIMIT_MS, 0)
    },
    ..CASE
};

pub const BABBLE: Case = Case {
    fault: "another node floods the bus, before all others",
    noticed: "controller (bit 8)",
    reaction: "tries each frame for a second, then drops it; frames for other nodes take no time",
    logged_limit_ms: Some(1300),
    run: || {
        let flood = |rig: &mut Rig, on: bool| {
            let frame =
                Frame::extended(0x0010_0A7F, &[0x55, 0x55, 0x55, 0x55, 0x55, 0x55, 0x55, 0xC0]);
            rig.peer.borrow_mut().babble(on.then_some(frame));
        };
        during(flood, "CAN H/L: not sent", CONTROLLER)
    },
    ..CASE
};

pub const NO_ACKNOWLEDGE: Case = Case {
    fault: "no node acknowledges (error-passive)",
    reaction: "continues to send; logs that it is error-active again with the first frames that \
               it can send",
    run: || {
        let mut trial = Trial::running();
        trial.begin("CAN H/L: error-passive", |rig| rig.bench.bus().inject(Fault::NoAck(true)));
        trial.live(500);
        // From 128 on, a missing acknowledgement does not raise TEC. Another node's frame that
        // begins inside the error frame does, up to bus-off.
        let tec = trial.rig.board().chip().borrow().tec();
        assert!(
            (128..=256).contains(&tec) || trial.rig.serial.contains("CAN H/L: bus-off"),
            "TEC leaves the range of an error-passive sender: {tec}"
        );
        trial.end(|rig| rig.bench.bus().inject(Fault::NoAck(false)));
        let measured = trial.recover(BUS_LIMIT_MS, 0);
        assert!(trial.rig.serial.contains("over: CAN H/L: error-passive"), "{}", trial.rig.serial);
        let (_, code) = trial.rig.status_now();
        assert_eq!(
            code & ERROR_PASSIVE,
            0,
            "error-passive is reported after the node left it: {code:#06x}"
        );
        measured
    },
    ..CASE
};

pub const DESTROYED: Case = Case {
    fault: "each frame is destroyed",
    reaction: "after 1.5 s without a frame it listens only, until it has heard one and no error",
    run: || {
        let mut trial = Trial::running();
        trial.begin("CAN H/L: error-passive", |rig| {
            rig.bench.bus().inject(Fault::DestroyFrames(true));
        });
        trial.live(LASTS_MS);
        trial.end(|rig| rig.bench.bus().inject(Fault::DestroyFrames(false)));
        assert!(!trial.rig.serial.contains("another bit rate"), "{}", trial.rig.serial);
        trial.recover(BUS_LIMIT_MS, 0)
    },
    ..CASE
};

pub const DESTROYED_ALONE: Case = Case {
    fault: "each frame is destroyed, and only the node sends: bus-off through transmit errors",
    noticed: "bus-off (bit 7), counted in `CanStats`",
    reaction: "the controller comes back after 128 x 11 recessive bits, and tries one to three \
               frames a second",
    servo: FAILSAFE,
    logged_limit_ms: Some(500),
    limit_ms: BUS_LIMIT_MS,
    run: || {
        let mut trial = Trial::running();
        trial.begin("CAN H/L: bus-off", |rig| rig.bench.bus().inject(Fault::DestroyFrames(true)));
        trial.autopilot_sends = false;
        trial.live(LASTS_MS);
        trial.autopilot_sends = true;
        trial.end(|rig| rig.bench.bus().inject(Fault::DestroyFrames(false)));
        let measured = trial.recover(BUS_LIMIT_MS, BUS_OFF);
        let statistics = trial.statistics();
        assert!(statistics.is_none_or(|statistics| statistics.busoff_errors > 0), "{statistics:?}");
        measured
    },
};

/// Bit errors for [`LASTS_MS`]. The node counts them and logs nothing.
fn noise(per_million: u32) -> Measured {
    let mut trial = Trial::running();
    trial.begin("", |rig| {
        rig.bench.bus().inject(Fault::BitErrorRate { per_million, seed: u64::from(per_million) })
    });
    trial.live(LASTS_MS);
    trial.end(|rig| rig.bench.bus().inject(Fault::BitErrorRate { per_million: 0, seed: 0 }));
    assert!(trial.rig.error_frames > 0, "the fault caused no error frame");
    let measured = trial.recover(BUS_LIMIT_MS, 0);
    let statistics = trial.statistics();
    assert!(statistics.is_none_or(|of| of.rx_errors > 0 || of.busoff_errors > 0), "{statistics:?}");
    Measured { logged_ms: None, ..measured }
}

const NOISE: Case = Case {
    fault: "",
    noticed: "counted in `CanStats`; if errors are that frequent, error-passive (bit 6) or \
              bus-off (bit 7)",
    reaction: "the controller sends destroyed frames again",
    servo: "follows the commands that it receives, else failsafe",
    logged_limit_ms: None,
    limit_ms: BUS_LIMIT_MS,
    run: || noise(0),
};
pub const NOISE_5: Case = Case { fault: "bit errors, 1 in 100,000", run: || noise(10), ..NOISE };
pub const NOISE_4: Case = Case { fault: "bit errors, 1 in 10,000", run: || noise(100), ..NOISE };
pub const NOISE_3: Case = Case { fault: "bit errors, 1 in 1,000", run: || noise(1000), ..NOISE };
pub const NOISE_2: Case = Case { fault: "bit errors, 1 in 100", run: || noise(10_000), ..NOISE };

pub const BROKEN_WHILE_STARTING: Case = Case {
    fault: "bus held dominant while the node starts",
    noticed: "bus never idle (bit 8)",
    reaction: "restarts the controller ten times a second",
    servo: "no pulse before the first command",
    logged_limit_ms: Some(250),
    limit_ms: BUS_LIMIT_MS,
    run: || {
        let mut trial = Trial::running();
        // The controller may join the free bus, and overflow, before the driver polls it.
        trial.rig.overflows_expected = true;
        trial.begin("CAN H/L: never idle", |rig| {
            rig.bench.bus().inject(Fault::StuckDominant(true));
            rig.cut_power();
        });
        trial.live(LASTS_MS);
        assert_eq!(trial.rig.pulses, []);
        trial.end(|rig| rig.bench.bus().inject(Fault::StuckDominant(false)));
        trial.recover(BUS_LIMIT_MS, 0)
    },
};

pub const OWN_RATE_WRONG: Case = Case {
    fault: "the node itself is set to another bit rate than the bus",
    noticed: "errors, and no valid frame (bit 8), on the serial monitor only",
    reaction: "listens only, after at most 20 error frames; on a bus on which nobody sends it \
               tries its status each second. Correct its bit rate on a bus that has the node's \
               rate",
    servo: "no pulse before the first command",
    logged_limit_ms: Some(1300),
    limit_ms: BUS_LIMIT_MS,
    run: || {
        // Each power-up replaces the EEPROM, because the node reads its bit rate only when it
        // starts.
        let mut rig = Rig::running_with(started());
        let right = rig.board().avr().eeprom();
        rig.set("CAN_BAUDRATE", i64::from(board().fastest_bit_rate() / 2));
        rig.save();
        let wrong = rig.board().avr().eeprom();
        let mut trial = Trial::with(rig);
        trial.begin("another bit rate or crystal", |rig| {
            rig.board().avr_mut().set_eeprom(&wrong);
            rig.cut_power();
        });
        trial.live(LASTS_MS);
        trial.rig.error_frames = 0;
        trial.live(LASTS_MS);
        assert_eq!(trial.rig.error_frames, 0, "it listens");
        assert_eq!(trial.rig.pulses, []);
        trial.end(|rig| {
            rig.board().avr_mut().set_eeprom(&right);
            rig.cut_power();
            let started = rig.now() + MS;
            rig.run_until(started);
        });
        trial.recover(BUS_LIMIT_MS, 0)
    },
};
