//! The commanders of the soak, and the nodes that disturb them:
//!
//! * The *autopilot* commands output 1, in full output 2 and four motors, too. Half of its commands
//!   have several frames.
//! * The *companion* commands an output of its own: output 7 in full, another node's in default.
//! * The *half-commander* commands output 8, or another node's, once a second, and between these
//!   commands sends first frames alone: it completes what it begins now and then.
//! * The *half-sender* sends first frames alone, for the autopilot's outputs.
//! * The *stranger* sends NaN for all outputs 0.9 ms after each command of the autopilot, and each
//!   second an ArmingStatus and a SafetyState that would stop everything.

use std::collections::BTreeMap;

use bench::Cycles;
use bench::avr::{Firmware, Pulse};
use bench::bootloader;
use bench::can::Frame;
use bench::dronecan::{Message, TransferId, Value, split, types};

use super::{FAILSAFE_US, SERVO_PERIOD, SLOT_MS, Soak};
use crate::{
    ARMED, ARMING_STATUS, ARRAY_COMMAND, MS, NOT_ARMED, PWM, RAW_COMMAND, Rig, SAFE, SAFETY_STATE,
    US, array_command, has_all_features,
};

const AUTOPILOT: u32 = 10;
const COMPANION: u32 = 11;
const HALF_COMMANDER: u32 = 12;
const HALF_SENDER: u32 = 13;
const STRANGER: u32 = 14;
/// The highest of these node IDs.
pub(super) const LAST: u32 = STRANGER;

/// The most entries of an ArrayCommand.
const MOST_ENTRIES: u64 = 15;
/// The first actuator ID that no output has.
pub(super) const FOREIGN: u8 = 21;

/// Outputs in use, counted from 0. The ID of output n is n + 1; motors have an index from 0.
pub(super) const OUTPUTS: usize = 8;
pub(super) const MOTORS: std::ops::Range<usize> = 2..6;
const COMPANIONS: usize = 6;
pub(super) const HALF_COMMANDERS: usize = 7;

/// Pulse of a motor that stops.
const MOTOR_STOPS_US: f64 = 1000.0;

/// A pulse has the width of a command of this time, or of the last one before it.
const NEWEST: Cycles = 2 * SERVO_PERIOD + 10 * MS;
/// Commands are kept for this time, and the last one for longer.
const KEPT: Cycles = 1000 * MS;

/// The number of outputs in use.
pub(super) fn outputs() -> usize {
    if has_all_features() { OUTPUTS } else { 1 }
}

/// The widths that an output was commanded, in microseconds, with their times, oldest first.
#[derive(Clone, Default)]
pub(super) struct Commanded(Vec<(Cycles, f64)>);

impl Commanded {
    fn note(&mut self, now: Cycles, us: f64) {
        let newest_old = self.0.iter().rposition(|(at, _)| at + KEPT < now);
        self.0.drain(..newest_old.unwrap_or(0));
        self.0.push((now, us));
    }

    pub(super) fn last(&self) -> Option<f64> {
        self.0.last().map(|(_, us)| *us)
    }

    /// The time that the pulse lags behind: from the command after the one that it has the width
    /// of. `None` if no command of the last time has this width.
    fn lag(&self, start: Cycles, us: f64, tolerance_us: f64) -> Option<Cycles> {
        let since = start.saturating_sub(NEWEST);
        let given = self.0.iter().take_while(|(at, _)| *at <= start).count();
        let last_before = self.0[..given].iter().rposition(|(at, _)| *at < since).unwrap_or(0);
        let is_it = |(_, wanted): &(Cycles, f64)| (wanted - us).abs() <= tolerance_us;
        let found = last_before + self.0[last_before..given].iter().rposition(is_it)?;
        Some(self.0[..given].get(found + 1).map_or(0, |(at, _)| start - at))
    }
}

/// What the other nodes have sent.
pub(super) struct Others {
    pub(super) commanded: Vec<Commanded>,
    /// Transfer IDs of each sender and type.
    numbers: BTreeMap<u32, u8>,
    /// The autopilot's ArmingStatus. It is always armed in default, which has ARM_REQ 1.
    pub(super) is_armed: bool,
    /// Commands for outputs of the node since the faultless phase began: each is to be followed.
    pub(super) followed: u64,
    /// Transfers that the node may count as rejected.
    pub(super) rejected: u64,
    /// The half-commander's output has another type or ID.
    is_away: bool,
}

/// Sets the parameters of the outputs, and saves them. In full the board gets the bootloader, too,
/// but each reset starts the program, so that the hand-over is a restart.
pub(super) fn set_up(rig: &mut Rig) {
    if has_all_features() {
        let loader = bootloader(&crate::board())
            .and_then(|hex| Firmware::read_hex(&hex))
            .unwrap_or_else(|error| panic!("{error:#}"));
        for (address, bytes) in &loader.flash {
            rig.board().avr_mut().load_flash(*address, bytes);
        }
        rig.set("OUT_COUNT", OUTPUTS as i64);
        for (motor, index) in MOTORS.zip(0..) {
            rig.set(&format!("OUT{}_TYPE", motor + 1), 1);
            rig.set(&format!("OUT{}_ID", motor + 1), index);
        }
        rig.set("MOT_TIMEOUT", 500);
        rig.set(&format!("OUT{}_TIMEOUT", HALF_COMMANDERS + 1), 0);
    } else {
        rig.set("ARM_REQ", 1);
    }
    for output in 1..=outputs().min(HALF_COMMANDERS) {
        rig.set(&format!("OUT{output}_FS"), 1);
        rig.set(&format!("OUT{output}_TIMEOUT"), 500);
    }
    rig.save();
    rig.restart();
}

impl Others {
    /// From now on the commands are counted.
    pub(super) fn begin_count(&mut self) {
        (self.followed, self.rejected) = (0, 0);
    }

    /// The node has restarted: no output is commanded.
    pub(super) fn restart(&mut self) {
        self.commanded = vec![Commanded::default(); outputs()];
    }

    pub(super) fn new() -> Self {
        Self {
            commanded: vec![Commanded::default(); outputs()],
            numbers: BTreeMap::new(),
            is_armed: true,
            followed: 0,
            rejected: 0,
            is_away: false,
        }
    }
}

impl Soak {
    /// Queues a transfer of one frame.
    fn send_one(&mut self, id: u32, payload: &[u8]) {
        let number = self.next_number(id);
        self.rig.send(id, &[payload, &[0xC0 | number]].concat());
    }

    fn next_number(&mut self, id: u32) -> u8 {
        let number = self.others.numbers.entry(id).or_default();
        *number = (*number + 1) % 32;
        *number
    }

    /// Queues the frames of an ArrayCommand, the first at `at`, each `gap` after the one before.
    fn send_list(&mut self, source: u32, at: Cycles, gap: Cycles, entries: &[(u8, u8, f32)]) {
        let id = ARRAY_COMMAND | source;
        let number = self.next_number(id);
        let mut due = at;
        for data in array_command(entries, number) {
            self.rig.peer.borrow_mut().send_at(due, Frame::extended(id, &data));
            due += gap;
        }
    }

    /// Entries for other nodes, so that there are `count` in all.
    fn fill(&mut self, entries: &mut Vec<(u8, u8, f32)>, count: u64) {
        for id in (FOREIGN..).take((count as usize).saturating_sub(entries.len())) {
            entries.push((id, PWM, 1000.0 + self.random.below(1000) as f32));
        }
    }

    /// The autopilot commands its outputs: output 1 this width in microseconds, the others one that
    /// depends on it.
    pub(super) fn command(&mut self, us: u64) {
        let us = if us as f64 == FAILSAFE_US { us + 1 } else { us };
        let now = self.now();
        let mut widths = vec![us as f64];
        if has_all_features() {
            widths.push(2.0 * FAILSAFE_US - us as f64);
        }
        let mut entries: Vec<_> =
            widths.iter().zip(1..).map(|(us, id)| (id, PWM, *us as f32)).collect();
        if self.random.below(2) == 0 {
            let count = 2 + self.random.below(MOST_ENTRIES - 1);
            self.fill(&mut entries, count);
        }
        let gap = self.random.below(300) * US;
        self.send_list(AUTOPILOT, now, gap, &entries);
        self.report.commands += 1;
        self.others.followed += 1;
        if has_all_features() {
            widths.extend(self.command_motors(us));
        }
        for (commanded, us) in self.others.commanded.iter_mut().zip(widths) {
            commanded.note(now, us);
        }
    }

    /// An esc.RawCommand for the motors. Returns the widths that they are to have.
    fn command_motors(&mut self, us: u64) -> Vec<f64> {
        let throttle = |motor: usize| (us as i16 - 1000) * 8 + 30 * motor as i16;
        let throttles: Vec<i16> = (0..MOTORS.len()).map(throttle).collect();
        let id = RAW_COMMAND | AUTOPILOT;
        let number = TransferId::new(self.next_number(id));
        let command = Message::RawCommand(throttles.clone());
        let (_, payload) = command.encode().expect("a command");
        for data in split(&payload, number, types::RAW_COMMAND.seed.expect("known")) {
            self.rig.send(id, &data);
        }
        if !self.others.is_armed {
            self.others.rejected += 1;
            return vec![MOTOR_STOPS_US; MOTORS.len()];
        }
        self.report.commands += 1;
        self.others.followed += 1;
        throttles.iter().map(|throttle| 1000.0 + f64::from(*throttle) * 1000.0 / 8191.0).collect()
    }

    /// The autopilot says if the vehicle is armed.
    pub(super) fn send_arming(&mut self) {
        let status = if self.others.is_armed { ARMED } else { NOT_ARMED };
        self.send_one(ARMING_STATUS | AUTOPILOT, &[status]);
    }

    /// After a fault: the vehicle is armed or not, in default always armed, and all outputs are
    /// commanded.
    pub(super) fn begin_without_faults(&mut self) {
        self.others.is_armed = !has_all_features() || self.random.below(3) != 0;
        self.command(1200);
        self.send_arming();
        self.rig.run_ms(SLOT_MS);
        self.others.restart();
        // A sender that lost commands in the fault is trusted again from a list that ends in 16 of
        // each 64 ms: see `src/node/trust.rs`. Of ten lists, one each 20 ms, at least one does.
        for _ in 0..10 {
            for (source, id) in [(AUTOPILOT, 1), (COMPANION, COMPANIONS as u8 + 1)] {
                let entries = [(id, PWM, 1200.0), (FOREIGN, PWM, 1000.0)];
                self.send_list(source, self.now(), 0, &entries);
            }
            self.rig.run_ms(SLOT_MS);
        }
        self.command_as_half_commander(self.now());
        for _ in 0..4 {
            self.slot();
        }
        self.forget_pulses();
    }

    /// What the others send until the autopilot's next command.
    pub(super) fn disturb(&mut self) {
        let now = self.now();
        let nan: Vec<_> = (1..=OUTPUTS as u8).map(|id| (id, PWM, f32::NAN)).collect();
        self.send_list(STRANGER, now + 900 * US, 0, &nan);
        self.others.rejected += 1;
        if self.slot.is_multiple_of(50) {
            self.send_one(ARMING_STATUS | STRANGER, &[NOT_ARMED]);
            self.others.rejected += 1;
            if has_all_features() {
                self.send_one(SAFETY_STATE | STRANGER, &[SAFE]);
            }
        }
        self.command_as_companion(now + 10 * MS);
        let completes = self.slot % 50 == 25 && !self.others.is_away;
        if completes {
            self.command_as_half_commander(now + 14 * MS);
        }
        for source in [HALF_COMMANDER, HALF_SENDER] {
            // A whole command of the half-commander is not disturbed, so that it is sure to be
            // followed.
            let is_quiet = completes || self.others.is_away;
            for _ in 0..if is_quiet { 0 } else { self.random.below(3) } {
                let after_us = self.random.below(SLOT_MS * 1000);
                let at = now + after_us * US;
                self.send_half(source, at);
            }
        }
        if completes {
            let before_us = self.random.below(3000);
            self.send_half(HALF_COMMANDER, now + SLOT_MS * MS - before_us * US);
        }
    }

    fn command_as_companion(&mut self, at: Cycles) {
        let us = 1010.0 + self.random.below(900) as f32;
        let mut entries = vec![(COMPANIONS as u8 + 1, PWM, us)];
        if has_all_features() {
            let count = 1 + self.random.below(MOST_ENTRIES);
            self.fill(&mut entries, count);
            self.others.commanded[COMPANIONS].note(at, us.into());
            self.others.followed += 1;
            self.report.commands += 1;
        }
        self.send_list(COMPANION, at, 0, &entries);
    }

    fn command_as_half_commander(&mut self, at: Cycles) {
        let us = 1010.0 + self.random.below(900) as f32;
        let mut entries = vec![(HALF_COMMANDERS as u8 + 1, PWM, us)];
        let count = 2 + self.random.below(MOST_ENTRIES - 1);
        self.fill(&mut entries, count);
        if has_all_features() {
            self.others.commanded[HALF_COMMANDERS].note(at, us.into());
            self.others.followed += 1;
            self.report.commands += 1;
        }
        self.send_list(HALF_COMMANDER, at, 0, &entries);
    }

    /// The first frame of a command for the autopilot's outputs, and nothing more.
    fn send_half(&mut self, source: u32, at: Cycles) {
        let entries: Vec<_> = (1..=MOST_ENTRIES as u8).map(|id| (id, PWM, 1900.0)).collect();
        let number = self.next_number(ARRAY_COMMAND | source);
        let first = &array_command(&entries, number)[0];
        let frame = Frame::extended(ARRAY_COMMAND | source, first);
        self.rig.peer.borrow_mut().send_at(at, frame);
        self.report.halves += 1;
        self.others.rejected += 2;
    }

    // ---- changes while running ----

    /// A client changes the type, the ID or neither of the half-commander's output and changes it
    /// back. While armed the node refuses that, and the pulse stays. Else the pulse ends, and the
    /// old commands start no other.
    #[track_caller]
    pub(super) fn change_an_output(&mut self) {
        let (what, new, old) =
            if self.random.below(2) == 0 { ("TYPE", 1, 0) } else { ("ID", 60, 8) };
        let name = format!("OUT{}_{what}", HALF_COMMANDERS + 1);
        self.others.is_away = true;
        let is_refused = self.others.is_armed;
        self.report.changes += 1;
        // An open command delays new filters, and with them the answer.
        for _ in 0..4 {
            self.slot();
        }
        for value in [new, old] {
            let answer = self.rig.request_value(&name, Value::Integer(value));
            let expected = if is_refused { old } else { value };
            assert_eq!(answer, Value::Integer(expected), "{name} = {value}");
            if !is_refused {
                // The last pulse begins in the first slot at the latest. In the second one none is
                // missed, so the time since the last one begins anew.
                self.slot();
                self.check_pulses();
                self.slot();
                let now = self.now();
                self.last_pulses[HALF_COMMANDERS].iter_mut().for_each(|last| *last = now);
                self.check_pulses();
                self.others.commanded[HALF_COMMANDERS] = Commanded::default();
                self.last_pulses[HALF_COMMANDERS] = None;
            }
            for _ in 0..3 {
                self.slot();
                self.check_pulses();
            }
        }
        self.others.is_away = false;
    }

    // ---- pulses ----

    /// Takes the pulses of each output.
    fn take_pulses(&mut self) -> Vec<Vec<Pulse>> {
        let mut all = vec![std::mem::take(&mut self.rig.pulses)];
        if outputs() > 1 {
            all.extend(self.rig.board().take_output_pulses());
        }
        all
    }

    /// Drops the pulses so far.
    pub(super) fn forget_pulses(&mut self) {
        self.take_pulses();
        self.last_pulses = vec![None; outputs()];
    }

    /// Checks that each output has pulses, each with the width of a recent command, one period
    /// apart.
    #[track_caller]
    pub(super) fn check_pulses(&mut self) {
        let now = self.now();
        for (output, pulses) in self.take_pulses().into_iter().enumerate() {
            // An edge that the program makes may be off by half a microsecond.
            let (jitter, tolerance_us) = match output {
                0 => (0, 0.0),
                _ if MOTORS.contains(&output) => (16, 1.6),
                _ => (16, 1.0),
            };
            for pulse in pulses {
                let us = pulse.width_us();
                if self.last_pulses[output].is_some() {
                    let off = pulse.period_cycles.unwrap_or(0).abs_diff(SERVO_PERIOD);
                    assert!(off <= jitter, "output {}: {off} cycles off", output + 1);
                }
                self.last_pulses[output] = Some(pulse.start);
                let commanded = &self.others.commanded[output];
                let Some(lag) = commanded.lag(pulse.start, us, tolerance_us) else {
                    panic!(
                        "a pulse of {us} us on output {} at {}, commanded {:?}",
                        output + 1,
                        pulse.start,
                        &commanded.0[commanded.0.len().saturating_sub(6)..]
                    );
                };
                self.report.longest_lag = self.report.longest_lag.max(lag);
            }
            let commanded = &self.others.commanded[output];
            let is_commanded = commanded.0.first().is_some_and(|(at, _)| at + NEWEST < now);
            let last = self.last_pulses[output];
            assert!(
                !is_commanded || last.is_some_and(|last| last + NEWEST > now),
                "no pulse on output {}",
                output + 1
            );
        }
    }

    /// Checks that each pulse has a width that is allowed during a fault: the last commanded or the
    /// failsafe's.
    #[track_caller]
    pub(super) fn check_pulses_in_fault(&mut self, what: &str, is_any: bool) {
        let resets = self.rig.board().avr().resets();
        for (output, pulses) in self.take_pulses().into_iter().enumerate() {
            let last = self.others.commanded[output].last();
            let failsafe = if MOTORS.contains(&output) { MOTOR_STOPS_US } else { FAILSAFE_US };
            for pulse in pulses {
                // A reset ends a pulse that the program would end.
                let end = pulse.start + pulse.width_cycles;
                if resets.iter().any(|reset| (pulse.start..=end + US).contains(&reset.at)) {
                    continue;
                }
                let us = pulse.width_us();
                // The last pulse before a hand-over to the bootloader ends some microseconds late.
                let is_it = |wanted: f64| (wanted - us).abs() <= 4.0;
                let is_expected = last.is_some_and(is_it) || is_it(failsafe);
                let is_possible = is_any && (1000.0..=2000.0).contains(&us);
                assert!(
                    is_expected || is_possible,
                    "{what}: {us} us on output {}, commanded {last:?}",
                    output + 1
                );
            }
        }
        self.last_pulses = vec![None; outputs()];
    }
}
