//! Failsafe: what the outputs do when no command comes, and when a safety switch stops them.

use super::{Outputs, bit, place};
use crate::hardware::OUTPUTS;
use crate::parts::{arming, update};
use crate::tables::condition::Conditions;
use crate::tables::parameters::Parameters;

impl Outputs {
    /// Starts the failsafe of each output when it is due. Call once a millisecond: it looks at one
    /// output. Returns true if it starts because no command was followed for the output's timeout.
    pub fn tick(&mut self, now_ms: u16, parameters: &Parameters) -> bool {
        let n = self.next_ticked();
        let bit = bit(n);
        if self.kinds.tick(bit, &mut self.each[place(n)], now_ms, parameters) {
            self.touch();
        }
        let output = &self.each[place(n)];
        let commander = output.commander;
        let is_disarmed = self.is_disarmed(bit, commander, parameters);
        if is_disarmed {
            // Nobody has said so: that would have ended the doubt.
            self.failing |= self.doubts.outputs() & bit;
        }
        if !output.is_following() {
            return false;
        }
        let is_late = output.is_late(self.kinds.timeout_ms(n, bit, parameters), now_ms);
        let is_left_out = self.kinds.is_left_out(bit, commander);
        if is_late || is_disarmed || is_left_out {
            self.fail_output(n, bit, parameters);
        }
        if is_late {
            if !self.kinds.needs_armed(bit) {
                self.failing |= bit;
            } else if !is_disarmed {
                self.doubts.begin(bit);
            }
        }
        is_late
    }

    /// The output to look at in this millisecond: one after the other.
    fn next_ticked(&mut self) -> usize {
        if OUTPUTS == 1 {
            return 0;
        }
        let output = place(self.ticked.into());
        self.ticked = if output + 1 < self.used() { output as u8 + 1 } else { 0 };
        output
    }

    /// Begins the failsafe of each output.
    pub fn fail_safe(&mut self, parameters: &Parameters) {
        let mut bit = 1;
        for n in 0..OUTPUTS {
            self.fail_output(n, bit, parameters);
            bit <<= 1;
        }
    }

    fn fail_output(&mut self, n: usize, bit: u8, parameters: &Parameters) {
        self.kinds.fail_safe(n, bit, &mut self.each[place(n)], parameters);
        self.touch();
    }

    /// Counts down the timeouts of ArmingStatus, of SafetyState and of each kind. Call once a
    /// second.
    pub fn second(&mut self, now_ms: u16, parameters: &Parameters) {
        self.logged = 0;
        if update::IS_THERE {
            self.recent_s = self.recent_s.saturating_sub(1);
        }
        self.arming.second();
        self.kinds.second(parameters);
        if self.safety.second() {
            self.end_safe(now_ms);
        }
    }

    /// An output has got another type or ID: it has no failsafe before a command for these.
    #[inline(always)]
    pub(super) fn expect_no_command(&mut self, bit: u8) {
        self.failing &= !bit;
        self.doubts.end(bit);
    }

    /// True if no output is in failsafe.
    pub fn has_recovered(&self) -> bool {
        self.failing == 0
    }

    /// Outputs in failsafe: bit n is output n.
    pub fn failing(&self) -> u8 {
        self.failing
    }

    /// Outputs in failsafe when [`take_change`](Self::take_change) was true last.
    pub fn reported(&self) -> u8 {
        self.reported
    }

    /// True if an output is in failsafe and several are in use. With one output, the status of the
    /// node says so.
    pub fn is_one_of_several_failing(&self) -> bool {
        self.failing != 0 && self.used() != 1
    }

    /// True, once, if other outputs are in failsafe than when it was true last, and have been for a
    /// round of [`tick`](Self::tick): outputs that fail together are reported together. False if
    /// one output is in use.
    pub fn take_change(&mut self) -> bool {
        if self.used() == 1 || self.ticked != 0 {
            return false;
        }
        let is_settled = self.failing == self.seen;
        self.seen = self.failing;
        let is_changed = is_settled && self.failing != self.reported;
        if is_changed {
            self.reported = self.failing;
        }
        is_changed
    }

    /// The output of the next actuator.Status: those with an actuator ID take turns.
    pub fn next_to_report(&mut self) -> Option<usize> {
        if OUTPUTS == 1 {
            return Some(0);
        }
        for _ in 0..self.used() {
            let output = place(self.telemetry.into());
            self.telemetry = if output + 1 < self.used() { output as u8 + 1 } else { 0 };
            if self.kinds.is_actuator(bit(output)) {
                return Some(output);
            }
        }
        None
    }

    /// True if commands are not expected: the safety switch is on, or the autopilot says that the
    /// vehicle is disarmed. ArduPilot then leaves out channels without a pulse.
    pub fn may_be_silent(&self) -> bool {
        self.safety.is_safe() || self.arming.is_said_disarmed()
    }

    /// The conditions that are no fault now: FAILSAFE while [`may_be_silent`](Self::may_be_silent),
    /// and lost frames while the next commands come soon.
    pub fn excused(&self, now_ms: u16) -> Conditions {
        let mut excused = Conditions::NONE;
        excused.set(Conditions::FAILSAFE, self.may_be_silent());
        excused.set(Conditions::FRAMES_LOST, self.are_commands_frequent(now_ms));
        excused
    }

    /// True if outputs follow commands, and each of these got one in the last 50 ms.
    fn are_commands_frequent(&self, now_ms: u16) -> bool {
        /// The longest time between commands that a lost one does not make noticeable.
        const FREQUENT_MS: u16 = 50;
        // A node with one output loses no frame.
        if OUTPUTS == 1 {
            return false;
        }
        let mut is_following = false;
        for output in &self.each {
            if output.is_following() {
                if !output.has_followed_within(FREQUENT_MS, now_ms) {
                    return false;
                }
                is_following = true;
            }
        }
        is_following
    }

    /// True if an update would take the outputs away from somebody: while armed; and unless
    /// [`may_be_silent`](Self::may_be_silent), within two to three seconds of a followed command.
    pub fn are_in_use(&self) -> bool {
        self.arming.is_armed() || !self.may_be_silent() && self.recent_s != 0
    }

    /// True if a node is the last whose command an output followed.
    #[inline(never)]
    pub fn has_commander(&self, id: u8) -> bool {
        arming::IS_BY_SOURCE
            && id != 0
            && self.commander_bits & bit(id.into()) != 0
            && self.commanded_by(id) != 0
    }

    /// Outputs whose last followed command was this node's: bit n is output n.
    #[inline(never)]
    fn commanded_by(&self, id: u8) -> u8 {
        let (mut bit, mut outputs) = (1u8, 0);
        for output in &self.each {
            if output.commander == id {
                outputs |= bit;
            }
            bit <<= 1;
        }
        outputs
    }

    /// Acts on the status of an ArmingStatus. False: it is not kept, because four others are armed.
    #[inline(always)]
    pub fn act_on_arming_status(&mut self, source: u8, status: u8) -> bool {
        let is_kept = self.arming.act_on_status(source, status);
        if arming::IS_BY_SOURCE && self.doubts.outputs() != 0 {
            let doubted = self.doubts.end(self.commanded_by(source));
            if self.arming.is_armed_by(source) {
                self.failing |= doubted;
            }
        }
        is_kept
    }

    /// Acts on a SafetyState. While it says safe, silence is expected, and the outputs do what
    /// SAFE_MODE says.
    pub fn act_on_safety_state(
        &mut self,
        source: u8,
        status: u8,
        now_ms: u16,
        parameters: &Parameters,
    ) {
        const SAFE: u8 = 0;
        if status != SAFE {
            if self.safety.is_safe_by(source) {
                self.end_safe(now_ms);
            }
            return;
        }
        let was_safe = self.safety.is_safe();
        self.safety.begin(source);
        self.failing |= self.doubts.end(u8::MAX);
        for (n, output) in self.each.iter_mut().enumerate() {
            if !was_safe {
                output.is_to_resume = output.is_following() || self.failing & bit(n) != 0;
            }
            self.kinds.begin_safe(bit(n), output, self.safety.ends_pulses(parameters));
        }
        // Commands are missing for a reason.
        self.failing = 0;
        self.touch();
    }

    /// From now on commands are expected again, if they were before.
    fn end_safe(&mut self, now_ms: u16) {
        self.safety.end();
        for output in &mut self.each {
            output.resume(now_ms);
        }
    }
}
