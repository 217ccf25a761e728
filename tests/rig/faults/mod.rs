//! Faults. One [`Case`] causes one fault and checks how the node recovers. The tests check the
//! cases; `make reliability` writes the times that they measure to docs/reliability.md.
//!
//! A [`Trial`] runs the node. An autopilot commands the servo to 1750 us 50 times a second and
//! sends its status once a second. OUT1_FS is the trim, 1500 us, and OUT1_TIMEOUT 300 ms. In every
//! fault each pulse has one of these two widths and begins 20 ms after the one before. The node has
//! recovered when it follows a command with another width *and* answers a request.

pub mod bus;
pub mod chip;
pub mod input;
pub mod page;
pub mod processor;

use crate::{MS, NODE, Rig, SERVO_PERIOD, has_all_features, started};
use bench::Cycles;
use bench::can::Id;
use bench::dronecan::{CanStats, Message};

/// Limit of the time from the end of a fault of the bus to full service.
pub const BUS_LIMIT_MS: u64 = 1000;
/// Limit of the time from a fault of the controller to its line on the serial monitor.
pub const CHIP_LOGGED_LIMIT_MS: u64 = 100;

pub const COMMANDED_US: f64 = 1750.0;
pub const FAILSAFE_US: f64 = 1500.0;
/// What the servo does in a fault, as the page says it.
const FAILSAFE: &str = "failsafe after `OUT1_TIMEOUT`";
const AFTERWARDS_US: f64 = 1250.0;

/// One fault.
pub struct Case {
    /// The fault, as the page names it.
    pub fault: &'static str,
    /// What detects the fault, and what reports it.
    pub noticed: &'static str,
    /// What the node does.
    pub reaction: &'static str,
    /// Where the servo is meanwhile.
    pub servo: &'static str,
    /// Limit of the time from the fault's beginning to its line on the serial monitor. `None` if
    /// the node logs nothing.
    pub logged_limit_ms: Option<u64>,
    /// Limit of the time from the fault's end to full service.
    pub limit_ms: u64,
    /// Causes the fault, checks the reports and the servo.
    pub run: fn() -> Measured,
}

/// Times that a case measured, in milliseconds. If a case has several runs: the longest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measured {
    pub logged_ms: Option<f64>,
    pub recovery_ms: f64,
}

impl Measured {
    /// The longer of the two for each time.
    pub fn or(self, other: Measured) -> Measured {
        let logged_ms = match (self.logged_ms, other.logged_ms) {
            (Some(one), Some(other)) => Some(one.max(other)),
            (one, other) => one.or(other),
        };
        Measured { logged_ms, recovery_ms: self.recovery_ms.max(other.recovery_ms) }
    }
}

/// Makes a test of each name, which checks the cases behind it.
#[macro_export]
macro_rules! check_each {
    ($module:ident: $($(#[$ignore:meta])? $name:ident: $($case:ident),+;)+) => {
        $(
            #[test]
            $(#[$ignore])?
            fn $name() {
                $($crate::faults::$module::$case.check();)+
            }
        )+
    };
}

impl Case {
    /// Runs the case and checks its limits.
    #[track_caller]
    pub fn check(&self) -> Measured {
        let measured = (self.run)();
        println!("{}: {measured:?}", self.fault);
        if let Some(limit) = self.logged_limit_ms.map(|limit| limit + crate::corner().start_ms()) {
            let logged =
                measured.logged_ms.unwrap_or_else(|| panic!("{}: nothing was logged", self.fault));
            assert!(
                logged <= limit as f64,
                "{}: logged after {logged:.1} of {limit} ms",
                self.fault
            );
        }
        let took = measured.recovery_ms;
        assert!(
            took <= self.limit_ms as f64,
            "{}: recovered after {took:.1} of {} ms",
            self.fault,
            self.limit_ms
        );
        measured
    }
}

/// A node and an autopilot that commands it, before, during and after a fault.
pub struct Trial {
    pub rig: Rig,
    /// True if the autopilot sends.
    pub autopilot_sends: bool,
    begun: Cycles,
    ended: Cycles,
    slot_due: Cycles,
    status_due: Cycles,
    /// The expected text on the serial monitor, and when it came.
    line: &'static str,
    logged_at: Option<Cycles>,
}

impl Trial {
    /// Starts a node whose servo follows the autopilot's commands.
    #[track_caller]
    pub fn running() -> Trial {
        Trial::with(Rig::running_with(started()))
    }

    /// Like [`Trial::running`] with this rig.
    #[track_caller]
    pub fn with(mut rig: Rig) -> Trial {
        rig.set("OUT1_FS", 1);
        rig.set("OUT1_TIMEOUT", 300);
        if has_all_features() {
            rig.set("STATS_RATE", 10);
        }
        let mut trial = Trial {
            rig,
            autopilot_sends: true,
            begun: 0,
            ended: 0,
            slot_due: 0,
            status_due: 0,
            line: "",
            logged_at: None,
        };
        // After 1.2 s the driver knows that the bit rate is that of the bus.
        trial.live(1300);
        // A DroneCAN message for other nodes. After it the node's filters accept DroneCAN v0 only.
        trial.rig.send(0x1804_2E0A, &[0xC0]);
        trial.live(100);
        trial
    }

    /// Begins the fault. `line` is the text that the serial monitor must contain; empty if none.
    pub fn begin(&mut self, line: &'static str, fault: impl FnOnce(&mut Rig)) {
        self.rig.forget();
        (self.line, self.logged_at) = (line, None);
        self.begun = self.rig.now();
        fault(&mut self.rig);
    }

    /// Runs for `ms` milliseconds with the autopilot.
    #[track_caller]
    pub fn live(&mut self, ms: u64) {
        self.live_with(ms, COMMANDED_US, |_| {});
    }

    /// Like [`Trial::live`] with another commanded width; calls `also` each millisecond.
    #[track_caller]
    pub fn live_with(&mut self, ms: u64, command_us: f64, mut also: impl FnMut(&mut Rig)) {
        for _ in 0..ms {
            if self.rig.now() >= self.slot_due && self.autopilot_sends {
                self.slot_due = self.rig.now() + 20 * MS;
                // Like an autopilot, drops the frames that it could not send.
                self.rig.peer.borrow_mut().clear_queue();
                self.rig.send_command(1, 4, command_us as f32);
                if self.rig.now() >= self.status_due {
                    self.status_due = self.rig.now() + 1000 * MS;
                    self.rig.send_status_from(10);
                }
            }
            also(&mut self.rig);
            self.rig.run_ms(1);
            if self.logged_at.is_none() && self.rig.serial.contains(self.line) {
                self.logged_at = Some(self.rig.now());
            }
        }
    }

    /// Ends the fault. Checks that each pulse until now had the commanded width or the failsafe's,
    /// without a gap.
    #[track_caller]
    pub fn end(&mut self, fault: impl FnOnce(&mut Rig)) {
        assert_servo(&self.rig, &[COMMANDED_US, FAILSAFE_US]);
        self.end_unchecked(fault);
    }

    /// Ends the fault without a check of the servo.
    pub fn end_unchecked(&mut self, fault: impl FnOnce(&mut Rig)) {
        fault(&mut self.rig);
        self.ended = self.rig.now();
    }

    /// Waits until the node follows a command with another width and answers a request. Then the
    /// status must have the bits `reported`, and the node must not have flooded the bus.
    #[track_caller]
    pub fn recover(&mut self, limit_ms: u64, reported: u16) -> Measured {
        self.rig.traffic.clear();
        self.rig.pulses.clear();
        let mut errors_before = self.rig.error_frames;
        let answers = self.rig.answers().len();
        let mut next_request = 0;
        loop {
            if self.rig.now() >= next_request && self.rig.answers().len() == answers {
                next_request = self.rig.now() + 50 * MS;
                self.rig.request(&Message::NodeInfoRequest);
            }
            self.live_with(1, AFTERWARDS_US, |_| {});
            if self.rig.now() <= self.ended + 30 * MS {
                // After a fault that happens once the node needs time to detect it.
                errors_before = self.rig.error_frames;
            }
            let follows =
                self.rig.pulses.last().is_some_and(|pulse| pulse.width_us() == AFTERWARDS_US);
            if follows && self.rig.answers().len() > answers {
                break;
            }
            let took = (self.rig.now() - self.ended) / MS;
            assert!(
                took <= limit_ms,
                "no recovery within {limit_ms} ms\nserial monitor:\n{}",
                self.rig.serial
            );
        }
        let measured = Measured {
            logged_ms: self.logged_at.map(|at| (at - self.begun) as f64 / MS as f64),
            recovery_ms: (self.rig.now() - self.ended) as f64 / MS as f64,
        };
        let in_service = self.rig.now();
        assert_servo(&self.rig, &[COMMANDED_US, FAILSAFE_US, AFTERWARDS_US]);
        self.live_with(1000 - measured.recovery_ms.min(900.0) as u64, AFTERWARDS_US, |_| {});
        // The node sends 10 telemetry messages of two frames, statistics of four, statuses, a
        // temperature, answers of eleven.
        let frames = frames_of_node(&self.rig);
        assert!(frames < 200, "{frames} frames in the second after the fault");
        let errors = self.rig.error_frames - errors_before;
        assert!(errors < 50, "{errors} error frames after the fault");
        // The recovery must last.
        let widths = self
            .rig
            .pulses
            .iter()
            .filter(|pulse| pulse.start > in_service)
            .map(|pulse| pulse.width_us());
        assert!(
            widths.into_iter().all(|us| us == AFTERWARDS_US),
            "the servo left the commanded position after the recovery"
        );
        let (_, code) = self.rig.status_now();
        assert_eq!(code & reported, reported, "vendor code {code:#06x}");
        measured
    }

    /// The newest CanStats; `None` if the firmware does not send them.
    #[track_caller]
    pub fn statistics(&self) -> Option<CanStats> {
        if !has_all_features() {
            return None;
        }
        let all = self.rig.node_messages(|message| match message {
            Message::CanStats(statistics) => Some(statistics),
            _ => None,
        });
        Some(all.last().expect("statistics come ten times a second").1)
    }
}

/// Number of frames that the node has sent.
pub fn frames_of_node(rig: &Rig) -> usize {
    let from_node = |id: Id| matches!(id, Id::Extended(id) if id & 0x7F == NODE);
    rig.traffic.iter().filter(|(_, frame)| from_node(frame.id)).count()
}

/// Checks that each pulse has one of these widths (in us) and begins one period after the one
/// before.
#[track_caller]
pub fn assert_servo(rig: &Rig, widths: &[f64]) {
    for pulse in &rig.pulses {
        assert!(
            widths.contains(&pulse.width_us()),
            "a pulse of {} us\n{}",
            pulse.width_us(),
            rig.serial
        );
    }
    for pulse in rig.pulses.iter().skip(1) {
        assert_eq!(pulse.period_cycles, Some(SERVO_PERIOD), "the period");
    }
}
