//! A long run with random faults, from a seed: an autopilot and a companion that command 50 times a
//! second, nodes that disturb them (see `others`), other traffic, sometimes a client, and about
//! four faults a minute. The node must recover from each fault within [`RECOVERY_LIMIT_MS`]. In the
//! preset full it has eight outputs.
//!
//! Between faults the node follows and counts each command, each pulse has the width of a recent
//! command and begins 20 ms after the one before, statuses come in time and in order with the right
//! uptime, the health is OK, no receive buffer overruns, the node answers requests, and parameters
//! keep their values. At the end the stack must have stayed within its limit.
//!
//! During a fault each pulse has the last commanded width or the failsafe's. After a restart there
//! are no pulses until the node follows a command. The bootloader gets no update that was asked for
//! while the outputs were in use, or when they are in use again.

mod others;

use std::collections::BTreeMap;
use std::fmt;

use crate::documented::parameters;
use crate::status::{BROWN_OUT, DISARMED, RESET, TRANSFER_ERRORS, WATCHDOG};
use crate::{
    ARRAY_COMMAND, MS, NODE_STATUS, Rig, SERVO_PERIOD, US, array_command, has_all_features,
    started, status_fields,
};
use bench::Cycles;
use bench::Noise;
use bench::avr::ResetCause;
use bench::budget::{Budget, PAINT};
use bench::can::{Fault, Frame};
use bench::dronecan::{Message, NumberAndText, RESTART_MAGIC};
use others::{FOREIGN, Others, outputs};

/// Limit of the time from the end of a fault until the node follows commands and answers requests
/// again.
pub const RECOVERY_LIMIT_MS: u64 = 1000;

/// Time between two commands.
const SLOT_MS: u64 = 20;
/// Pulse width of the failsafe. No command asks for it.
const FAILSAFE_US: f64 = 1500.0;
/// Time after which the status no longer reports the conditions of a fault.
const CONDITIONS_CLEAR_AFTER: Cycles = 12_500 * MS;

/// For this time after a restart the status reports its cause.
const RESET_REPORTED: Cycles = 59_000 * MS;

/// Kinds of faults. Those that last do so for some tenths of a second to some seconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FaultKind {
    /// The node's cable is pulled.
    Cable,
    /// The bus is held dominant.
    Short,
    /// No frame is acknowledged.
    NoAcknowledge,
    /// Bits are inverted: 1 in 100,000 to 1 in 100.
    BitErrors,
    /// Another node sends back to back, before all others.
    Babble,
    /// The autopilot stops sending.
    Silence,
    /// The controller is reset.
    ChipReset,
    /// The controller's registers hold garbage.
    ChipBrownOut,
    /// The controller has no power.
    ChipPower,
    /// The controller falls asleep.
    ChipSleep,
    /// The controller stays in configuration mode.
    ChipHeld,
    /// A register of the controller changes by itself.
    Register,
    /// MISO reads all zeros or all ones.
    Miso,
    /// Bits between the chips are inverted.
    SpiNoise,
    /// The supply dips.
    BrownOut,
    /// The reset pin is pulled.
    ResetPin,
    /// The power is cut, perhaps during a save.
    PowerCut,
    /// The program hangs.
    Hang,
    /// A client restarts the node.
    Restart,
    /// Another node uses the node's ID.
    SameId,
    /// Another node commands the same output.
    SecondCommander,
    /// A client asks for an update, and commands begin. Only in the preset full.
    Update,
}

impl FaultKind {
    /// True if the program restarts.
    fn restarts(self) -> bool {
        matches!(
            self,
            Self::BrownOut | Self::ResetPin | Self::PowerCut | Self::Hang | Self::Restart
        )
    }

    fn is_lasting(self) -> bool {
        !self.restarts()
            && !matches!(
                self,
                Self::ChipReset
                    | Self::ChipBrownOut
                    | Self::ChipSleep
                    | Self::Register
                    | Self::Update
            )
    }
}

const FAULT_KINDS: [FaultKind; 22] = [
    FaultKind::Cable,
    FaultKind::Short,
    FaultKind::NoAcknowledge,
    FaultKind::BitErrors,
    FaultKind::Babble,
    FaultKind::Silence,
    FaultKind::ChipReset,
    FaultKind::ChipBrownOut,
    FaultKind::ChipPower,
    FaultKind::ChipSleep,
    FaultKind::ChipHeld,
    FaultKind::Register,
    FaultKind::Miso,
    FaultKind::SpiNoise,
    FaultKind::BrownOut,
    FaultKind::ResetPin,
    FaultKind::PowerCut,
    FaultKind::Hang,
    FaultKind::Restart,
    FaultKind::SameId,
    FaultKind::SecondCommander,
    FaultKind::Update,
];

/// CNF3, CNF2, CNF1, CANINTE, CANCTRL and RXB0CTRL (DS20001801J table 11-1).
const WATCHED: [u8; 6] = [0x28, 0x29, 0x2A, 0x2B, 0x0F, 0x60];
/// Bits of these registers that the driver checks.
const WATCHED_BITS: [u8; 6] = [0x07, 0xBF, 0xFF, 0x03, 0xE8, 0x64];

/// Counts and times of a run.
#[derive(Default)]
pub struct Report {
    /// For each kind of fault: how often it occurred, and the longest recovery in milliseconds.
    pub faults: BTreeMap<FaultKind, (u32, f64)>,
    pub commands: u64,
    /// First frames of commands that never end.
    pub halves: u64,
    /// The longest time from a command to a pulse that still has the width of the one before, in
    /// cycles. 20 ms are the period of the pulses.
    pub longest_lag: Cycles,
    /// Changes of an output's type or ID while running.
    pub changes: u64,
    /// Updates that the node handed over to the bootloader, and others.
    pub updates: [u64; 2],
    pub requests: u64,
    pub saves: u64,
    pub statuses: u64,
    pub frames: u64,
    /// Frames lost in the controller, all of them during faults.
    pub lost_in_faults: u32,
    /// RAM for variables and for the stack at its deepest, in bytes.
    pub ram: u16,
}

/// A node in a long run, with an autopilot and a client.
pub struct Soak {
    rig: Rig,
    random: Noise,
    others: Others,
    /// For each output the start of its last pulse.
    last_pulses: Vec<Option<Cycles>>,
    slot: u64,
    to_come: Vec<FaultKind>,
    /// Time of the autopilot's next status.
    status_due: Cycles,
    statuses_sent: u8,
    /// Value of TEMP_ID, which the client changes: in force and saved.
    temp_id: [i64; 2],
    booted: Cycles,
    /// Cause in the vendor-specific code, for a minute after a fault that restarted the program.
    restarted_by: u16,
    fault_ended: Cycles,
    pub report: Report,
}

impl Soak {
    /// A node that was just started.
    pub fn new(seed: u64) -> Soak {
        let mut rig = Rig::running_with(started());
        // This program checks for lost frames itself, between faults.
        rig.overflows_expected = true;
        others::set_up(&mut rig);
        let booted = rig.now() - 150 * MS;
        let mut soak = Soak {
            rig,
            random: Noise::new(seed),
            others: Others::new(),
            last_pulses: vec![None; outputs()],
            slot: 0,
            to_come: Vec::new(),
            status_due: 0,
            statuses_sent: 0,
            temp_id: [1; 2],
            booted,
            restarted_by: 0,
            fault_ended: 0,
            report: Report::default(),
        };
        soak.rig.forget();
        soak
    }

    /// Simulated time so far.
    pub fn now(&self) -> Cycles {
        self.rig.now()
    }

    /// Runs until `end`, or until `stop` returns true; checks that often.
    pub fn run_until(&mut self, end: Cycles, stop: &dyn Fn() -> bool) {
        while self.now() < end && !stop() {
            let rest_ms = (end - self.now()) / MS;
            let calm_ms = (4_000 + self.random.below(26_000)).min(rest_ms);
            self.run_without_faults(calm_ms, stop);
            if self.now() < end && !stop() {
                let fault = self.next_fault();
                self.run_fault(fault);
            }
        }
        self.check_the_stack();
    }

    /// A random kind; each kind occurs once before one is repeated. Those that restart the program
    /// occur less often, so that it also runs long.
    fn next_fault(&mut self) -> FaultKind {
        loop {
            if self.to_come.is_empty() {
                self.to_come.extend(FAULT_KINDS);
            }
            let fault =
                self.to_come.swap_remove(self.random.below(self.to_come.len() as u64) as usize);
            let is_possible = fault != FaultKind::Update || has_all_features();
            if is_possible && (!fault.restarts() || self.random.below(6) == 0) {
                return fault;
            }
        }
    }

    // ---- between faults ----

    fn run_without_faults(&mut self, for_ms: u64, stop: &dyn Fn() -> bool) {
        let end = self.now() + for_ms * MS;
        self.begin_without_faults();
        let before = self.counters();
        self.others.begin_count();
        let lost = self.rig.board().chip().borrow().rx_overflows();
        let resets = self.rig.board().avr().resets().len();
        self.rig.forget();
        let mut last_status = None;
        while self.now() < end && !stop() {
            self.slot();
            match self.random.below(300) {
                0..=2 => self.ask(),
                3 => self.change_a_parameter(),
                4..=9 => self.send_foreign_burst(),
                20 if has_all_features() => self.change_an_output(),
                12..=19 => self.send_unfinished_transfer(),
                10 => self.rig.board().avr_mut().serial_send(b"\r\n"),
                11 => {
                    let celsius = 5.0 + self.random.below(50) as f64;
                    self.rig.board().set_temperature_c(celsius);
                }
                _ => {}
            }
            self.check_pulses();
            self.check_statuses(&mut last_status);
            let serial = &self.rig.serial;
            assert!(!serial.contains("reset:"), "a restart in quiet times\n{serial}");
            // The last line may be incomplete.
            let from = self.rig.serial.rfind('\n').map_or(0, |at| at + 1);
            self.rig.serial.drain(..from);
            self.rig.broken.clear();
            self.rig.transfers.clear();
            self.rig.error_frames = 0;
            self.report.frames += self.rig.traffic.len() as u64;
            self.rig.traffic.clear();
        }
        let after = self.counters();
        let followed = after[0].wrapping_sub(before[0]);
        let missing = (self.others.followed as u16).wrapping_sub(followed);
        assert!(
            missing == 0,
            "{missing} of {} commands are not followed; counters {before:?} to {after:?}",
            self.others.followed
        );
        assert_eq!(after[3], before[3], "sends given up");
        // The filters let some frames for other nodes through.
        let limit = if has_all_features() { u64::MAX } else { 40 + self.others.rejected };
        assert!(
            u64::from(after[1].wrapping_sub(before[1])) <= limit,
            "frames refused {before:?} to {after:?}"
        );
        assert_eq!(after[2], before[2], "receive overruns {before:?} to {after:?}");
        assert_eq!(
            self.rig.board().chip().borrow().rx_overflows(),
            lost,
            "frames lost in the controller"
        );
        assert_eq!(self.rig.board().avr().resets().len(), resets, "resets of the chip");
        self.rig.board().chip().borrow_mut().take_frame_log();
        self.rig.peer.borrow_mut().take_events();
    }

    /// Sends one command, once a second a status, and runs until the next command is due.
    fn slot(&mut self) {
        let sweep = (self.slot as f64 / 100.0).sin();
        let us = 1500.0 + 440.0 * sweep + self.random.below(10) as f64;
        if self.slot.is_multiple_of(25) {
            self.send_arming();
        }
        self.command(us as u64);
        self.disturb();
        // In time, whatever the test does between.
        while self.status_due < self.now() + 500 * MS {
            self.status_due = self.now().max(self.status_due + 1000 * MS);
            self.statuses_sent = self.statuses_sent.wrapping_add(1);
            let data = [10, 0, 0, 0, 0, 0, 0, 0xC0 | (self.statuses_sent % 32)];
            self.rig
                .peer
                .borrow_mut()
                .send_at(self.status_due, Frame::extended(NODE_STATUS | 10, &data));
        }
        self.slot += 1;
        self.rig.run_ms(SLOT_MS);
    }

    #[track_caller]
    fn check_statuses(&mut self, last: &mut Option<(Cycles, u8)>) {
        for (at, data) in self.rig.statuses() {
            let (uptime, health, mode, code) = status_fields(&data);
            let exact = (at - self.booted) as f64 / (1000 * MS) as f64;
            assert!((f64::from(uptime) - exact).abs() < 1.6, "uptime {uptime} after {exact:.3} s");
            if at > self.fault_ended + CONDITIONS_CLEAR_AFTER {
                // Another node's incomplete transfer and a disarmed vehicle are reported but are no
                // faults.
                let disarmed = if self.others.is_armed { 0 } else { DISARMED };
                let code = code & !(TRANSFER_ERRORS | disarmed);
                if self.restarted_by != 0 && at < self.booted + RESET_REPORTED {
                    // The other conditions of the fault remain with it.
                    assert_eq!(
                        (mode, code & RESET),
                        (0, self.restarted_by),
                        "mode and cause of the restart"
                    );
                } else if self.restarted_by == 0 || at > self.booted + RESET_REPORTED + 2000 * MS {
                    assert_eq!(
                        (health, mode, code),
                        (0, 0, 0),
                        "health, mode and vendor code, {} ms after the last fault and {} after \
                         the start",
                        (at - self.fault_ended) / MS,
                        (at - self.booted) / MS
                    );
                }
            }
            if let Some((before, number)) = *last {
                let gap_ms = (at - before) / MS;
                // The node moves its status away from the autopilot's at first, so one can come
                // early.
                let limit_ms = if at > self.fault_ended + 4000 * MS { 1100 } else { 1530 };
                assert!((499..=limit_ms).contains(&gap_ms), "{gap_ms} ms between statuses");
                assert_eq!(data[7] & 31, (number + 1) % 32, "transfer IDs");
            }
            *last = Some((at, data[7] & 31));
            self.report.statuses += 1;
        }
    }

    /// Reads the counters on the serial monitor: followed, rejected, overruns, given up.
    #[track_caller]
    fn counters(&mut self) -> [u16; 4] {
        // Lets queued lines out first.
        self.rig.run_ms(100);
        self.rig.serial.clear();
        self.rig.board().avr_mut().serial_send(b"?");
        self.rig.wait_for_line("given up", 300);
        let number = |what: &str| {
            let (_, rest) = self.rig.serial.split_once(what).expect("all counters");
            let digits: String =
                rest.trim_start().chars().take_while(char::is_ascii_digit).collect();
            digits.parse().expect("a number")
        };
        ["commands followed", "frames refused", "overruns", "given up"].map(number)
    }

    // ---- others on the bus ----

    /// A client sends one request.
    fn ask(&mut self) {
        match self.random.below(3) {
            0 => {
                let information = self.rig.information();
                assert!(information.name().starts_with("org."), "{}", information.name());
            }
            1 => {
                let index = self.random.below(parameters().len() as u64) as u16;
                assert!(!self.rig.parameter_at(index).name.is_empty());
            }
            _ if has_all_features() => _ = self.rig.ask(&Message::TransportStatsRequest),
            _ => assert_eq!(self.rig.get("OUT1_TIMEOUT"), 500),
        }
        self.report.requests += 1;
    }

    /// A client sets a parameter, reads it back, and sometimes saves all.
    fn change_a_parameter(&mut self) {
        assert_eq!(self.rig.get("TEMP_ID"), self.temp_id[0]);
        let value = self.random.below(65_536) as i64;
        self.rig.set("TEMP_ID", value);
        self.temp_id[0] = value;
        self.report.requests += 2;
        if self.random.below(3) == 0 {
            self.rig.request(&Message::ExecuteOpcode(bench::dronecan::Opcode::SAVE));
            // Commands continue meanwhile.
            for _ in 0..40 {
                self.slot();
            }
            self.temp_id[1] = value;
            self.report.saves += 1;
        }
    }

    /// Sends the beginning of a command or request that never ends, or a command of the draft,
    /// which a node with a v0 autopilot ignores.
    fn send_unfinished_transfer(&mut self) {
        let first = [0xC1, 0x45, 0x00, 0x01, 0x20, 0xA1, 0x07, 0x80];
        let source = others::LAST + 1 + self.random.below(80) as u32;
        let id = match self.random.below(3) {
            0 => ARRAY_COMMAND | source,
            1 => 0x1E0B_F880 | source,
            _ => 0x084C_0008 | source << 10,
        };
        self.rig.send(id & 0x1FFF_FFFF, &first);
        self.others.rejected += 2;
    }

    /// Sends a burst of frames for other nodes, at any priority.
    fn send_foreign_burst(&mut self) {
        for _ in 0..self.random.below(40) {
            let [priority, source] =
                [self.random.below(32) as u32, self.random.below(100) as u32 + 11];
            let kind = [0x0003_F200, 0x0004_2E00, 0x0004_5600][self.random.below(3) as usize];
            let id = (priority << 24 | kind | source) & 0x1FFF_FFFF;
            // An ESC's status is not for the node. An ArrayCommand is, but has no command for the
            // node's actuator.
            let data = self.random.next_u64().to_le_bytes();
            let frame = match kind {
                0x0003_F200 => {
                    Frame::extended(id, &[FOREIGN, 0, 0, 0x38, 0xC0 | self.random.below(32) as u8])
                }
                _ => Frame::extended(id, &data),
            };
            self.rig.send_frame(frame);
        }
    }

    // ---- faults ----

    fn run_fault(&mut self, fault: FaultKind) {
        let last_width = self.others.commanded[0].last().map(|us| us as u64);
        let for_ms = 100 + self.random.below(2900);
        let lost = self.rig.board().chip().borrow().rx_overflows();
        self.rig.violations_expected = true;
        self.rig.forget();
        self.forget_pulses();
        self.begin(fault);
        let begun = self.now();
        while fault.is_lasting() && self.now() < begun + for_ms * MS {
            // Like an autopilot, drops the frames that it could not send.
            self.rig.peer.borrow_mut().clear_queue();
            if fault != FaultKind::Silence {
                self.send_arming();
                self.command(last_width.unwrap_or(1200));
            }
            if fault == FaultKind::SameId {
                self.rig.send_status_from(120);
            }
            if fault == FaultKind::SecondCommander {
                for data in array_command(&[(1, 4, last_width.unwrap_or(1200) as f32)], 0) {
                    self.rig.send(ARRAY_COMMAND | 11, &data);
                }
            }
            self.rig.run_ms(SLOT_MS);
        }
        // A bit that is inverted between the chips can be one of a command.
        self.check_pulses_in_fault(&format!("{fault:?}"), fault == FaultKind::SpiNoise);
        self.end(fault);
        let recovery_ms = self.recover(fault, last_width);
        if fault.restarts() || self.rig.serial.contains("reset:") {
            self.booted = self.boot_time();
            self.restarted_by = match fault {
                // The hand-over to the bootloader is a reset by the watchdog.
                FaultKind::Hang | FaultKind::Update => WATCHDOG,
                FaultKind::BrownOut => BROWN_OUT,
                _ => 0,
            };
            self.temp_id[0] = self.temp_id[1];
            self.others.restart();
        }
        self.rig.run_ms(50);
        self.fault_ended = self.now();
        self.rig.board().take_violations();
        self.rig.violations_expected = false;
        self.report.lost_in_faults += self.rig.board().chip().borrow().rx_overflows() - lost;
        let (count, worst) = self.report.faults.entry(fault).or_default();
        *count += 1;
        *worst = worst.max(recovery_ms);
    }

    fn begin(&mut self, fault: FaultKind) {
        let seed = self.random.next_u64();
        match fault {
            FaultKind::Cable => self.rig.connect_node(false),
            FaultKind::Short => self.rig.bench.bus().inject(Fault::StuckDominant(true)),
            FaultKind::NoAcknowledge => self.rig.bench.bus().inject(Fault::NoAck(true)),
            FaultKind::BitErrors => {
                let per_million = [10, 100, 1000, 10_000][self.random.below(4) as usize];
                self.rig.bench.bus().inject(Fault::BitErrorRate { per_million, seed });
            }
            FaultKind::Babble => {
                self.rig.peer.borrow_mut().babble(Some(Frame::extended(0x0000_0A7F, &[0x55; 8])))
            }
            FaultKind::Silence | FaultKind::SameId | FaultKind::SecondCommander => {}
            FaultKind::Update => self.update_while_commands_begin(),
            FaultKind::ChipReset => self.rig.board().chip_reset(),
            FaultKind::ChipBrownOut => self.rig.board().chip_brown_out(seed),
            FaultKind::ChipPower => {
                self.rig.board().chip_power_off([0x00, 0xFF][seed as usize & 1])
            }
            FaultKind::ChipSleep => self.rig.board().chip_fall_asleep(),
            FaultKind::ChipHeld => self.rig.board().chip_hold_in_configuration(true),
            FaultKind::Register => {
                let which = self.random.below(WATCHED.len() as u64) as usize;
                let bits: Vec<u8> = (0..8)
                    .map(|bit| 1 << bit)
                    .filter(|bit| WATCHED_BITS[which] & bit != 0)
                    .collect();
                let bit = bits[self.random.below(bits.len() as u64) as usize];
                self.rig.board().chip_flip_bits(WATCHED[which], bit);
            }
            FaultKind::Miso => {
                self.rig.board().set_stuck_miso(Some([0x00, 0xFF][seed as usize & 1]))
            }
            FaultKind::SpiNoise => self.rig.board().set_spi_noise(100, seed),
            FaultKind::BrownOut => self.reset(ResetCause::BrownOut),
            FaultKind::ResetPin => self.reset(ResetCause::External),
            FaultKind::PowerCut => {
                if self.random.below(2) == 0 {
                    // Unsaved changes may be lost or saved, but the parameters must be one
                    // consistent set.
                    self.rig.set("TEMP_ID", self.temp_id[1]);
                    self.rig.request(&Message::ExecuteOpcode(bench::dronecan::Opcode::SAVE));
                    let delay = self.random.below(400);
                    self.rig.run_ms(delay);
                }
                self.reset(ResetCause::PowerOn);
            }
            FaultKind::Hang => self.hang(),
            FaultKind::Restart => {
                self.rig.request(&Message::RestartNode(RESTART_MAGIC));
                self.rig.run_ms(150);
            }
        }
    }

    fn reset(&mut self, cause: ResetCause) {
        self.rig.board().reset(cause);
    }

    /// Makes the main loop hang until the watchdog resets the chip.
    fn hang(&mut self) {
        let program = self.rig.board().avr().flash().to_vec();
        // WDR is 0x95A8; the last one of the program is in the main loop. RJMP to itself is 0xCFFF.
        // The bootloader begins behind it.
        let end = program.len().min(0x7800);
        let wdr = (0x68..end)
            .step_by(2)
            .rfind(|&at| program[at..at + 2] == [0xA8, 0x95])
            .expect("a main loop");
        self.rig.board().avr_mut().load_flash(wdr, &[0xFF, 0xCF]);
        self.rig.run_ms(300);
        self.rig.board().avr_mut().load_flash(0, &program);
        // The restarted program hung again.
        self.rig.run_ms(300);
    }

    fn end(&mut self, fault: FaultKind) {
        match fault {
            FaultKind::Cable => self.rig.connect_node(true),
            FaultKind::Short | FaultKind::NoAcknowledge | FaultKind::BitErrors => {
                self.rig.bench.bus().clear_faults()
            }
            FaultKind::Babble => self.rig.peer.borrow_mut().babble(None),
            FaultKind::ChipPower => self.rig.board().chip_power_on(),
            FaultKind::ChipHeld => self.rig.board().chip_hold_in_configuration(false),
            FaultKind::Miso => self.rig.board().set_stuck_miso(None),
            FaultKind::SpiNoise => self.rig.board().set_spi_noise(0, 0),
            _ => {}
        }
    }

    /// A client asks for an update some time after the last command, and commands begin again soon
    /// after. The node may hand over to the bootloader only if the vehicle was said to be disarmed,
    /// or was not commanded for two seconds, and never once it follows commands.
    #[track_caller]
    fn update_while_commands_begin(&mut self) {
        let last = self.now();
        let us = self.others.commanded[0].last().map_or(1200, |us| us as u64);
        let was_armed = self.others.is_armed;
        self.send_arming();
        self.command(us);
        let silent_ms = [0, 4200][self.random.below(2) as usize] + self.random.below(2000);
        self.rig.run_ms(silent_ms);
        let resets = self.rig.board().avr().resets().len();
        let request = NumberAndText { number: 0, text: b"fw.bin".to_vec() };
        self.rig.request(&Message::BeginUpdate(request));
        let wait_us = self.random.below(800_000);
        self.rig.run_until(self.now() + wait_us * US);
        let begin = self.now();
        self.others.is_armed = true;
        for _ in 0..60 {
            self.command(us);
            self.send_arming();
            self.rig.run_ms(SLOT_MS);
        }
        let reset = self.rig.board().avr().resets_after(resets).first().map(|reset| reset.at);
        self.report.updates[usize::from(reset.is_none())] += 1;
        if let Some(at) = reset {
            assert!(at < begin + SLOT_MS * MS, "the bootloader ran while commands were followed");
            // A status that says disarmed counts for four to five seconds.
            let may = !was_armed && silent_ms < 5000 || at >= last + 2000 * MS;
            assert!(may, "the bootloader ran {silent_ms} ms after a command, armed: {was_armed}");
        }
    }

    /// Sends commands and requests until the node follows one and answers one. Returns the time
    /// that took, in milliseconds.
    #[track_caller]
    fn recover(&mut self, fault: FaultKind, last_width: Option<u64>) -> f64 {
        self.forget_pulses();
        let ended = self.now();
        // A width that differs from the last one, to recognise it.
        let width = if last_width.is_some_and(|width| width < 1500) { 1800 } else { 1200 };
        let answers = self.rig.answers().len();
        loop {
            self.rig.peer.borrow_mut().clear_queue();
            self.command(width);
            self.send_arming();
            if self.rig.answers().len() == answers {
                self.rig.request(&Message::NodeInfoRequest);
            }
            self.rig.run_ms(SLOT_MS);
            let follows =
                self.rig.pulses.last().is_some_and(|pulse| pulse.width_us() == width as f64);
            if follows && self.rig.answers().len() > answers {
                break;
            }
            let took_ms = (self.now() - ended) / MS;
            assert!(
                took_ms <= RECOVERY_LIMIT_MS,
                "{fault:?}: no recovery in {took_ms} ms\n{}",
                self.rig.serial
            );
        }
        (self.now() - ended) as f64 / MS as f64
    }

    /// The time at which the program started, from its uptime.
    fn boot_time(&mut self) -> Cycles {
        self.rig.run_ms(20);
        self.rig.forget();
        let uptime = self.rig.information().status.uptime_s;
        self.now() - Cycles::from(uptime) * 1000 * MS - 500 * MS
    }

    #[track_caller]
    fn check_the_stack(&mut self) {
        let avr = self.rig.board().avr();
        let bottom = avr.symbol("__heap_start").expect("a symbol").address as u16;
        assert_eq!(
            avr.sram_range(bottom..=bottom + 1),
            [PAINT; 2],
            "the stack has kept clear of the variables"
        );
        self.report.ram = self.report.ram.max(bottom - 0x100 + avr.stack_high_water(PAINT, bottom));
        assert!(
            u32::from(self.report.ram) <= Budget::of(crate::board().chip).statics_and_stack,
            "{} B",
            self.report.ram
        );
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} commands, {} half commands; at most \
             {:.1} ms from a command to a pulse without it",
            self.commands,
            self.halves,
            self.longest_lag as f64 / MS as f64,
        )?;
        if has_all_features() {
            let [handed_over, other] = self.updates;
            writeln!(
                f,
                "{} changes of types and IDs; {handed_over} updates began, {other} did not",
                self.changes
            )?;
        }
        writeln!(
            f,
            "{} requests, {} saves, {} statuses, {} frames; {} frames lost, all of them in faults; \
             {} B of RAM",
            self.requests, self.saves, self.statuses, self.frames, self.lost_in_faults, self.ram
        )?;
        writeln!(f, "{:<14}{:>7}  longest recovery", "fault", "times")?;
        for (fault, (count, worst)) in &self.faults {
            writeln!(f, "{:<14}{count:>7}  {worst:.0} ms", format!("{fault:?}"))?;
        }
        Ok(())
    }
}
