//! The bench with an autopilot on it, and what is to be known of both: simulated time passes here, and nothing else.
//!
//! No terminal and no wall clock, so a scene can be run by a test as well as by a person.
//!
//! Three stations share the bus: the node, the autopilot, and a third one that only acknowledges what it hears, as an
//! analyser does, until it is told to babble. So the autopilot still gets its ACKs when the node's cable is pulled.

use super::args::Args;
use super::fault::{Fault, Injection};
use super::state::{AutopilotState, Controller, News, State};
use crate::autopilot::Autopilot;
use crate::avr::{self, Avr, Firmware, ResetCause, regs};
use crate::bench::{Bench, node_elf};
use crate::board::Board;
use crate::can::{self, Frame, PortId, SoftNode};
use crate::mcp2515::Fate;
use crate::{Cycles, F_CPU_HZ};
use anyhow::Result;
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

/// Byte that node.elf fills its free RAM with at start.
const STACK_PAINT: u8 = 0xC5;
/// First byte behind the statics, where the paint begins.
const STACK_BOTTOM_SYMBOL: &str = "__heap_start";
/// The stack is looked at this often.
const STACK_PERIOD: Cycles = F_CPU_HZ / 10;
/// Wire bit that a bit error inverts: in the data field of an extended frame.
const FLIPPED_BIT: u32 = 50;
const ERROR_RATE_PER_MILLION: u32 = 200;
const SPI_NOISE_PER_MILLION: u32 = 100;
/// Bus and SPI noise of each run are the same.
const NOISE_SEED: u64 = 1;
/// Identifier of the babbler's frame: the most urgent message there is, of no known type, from a tool's node ID.
const BABBLE_ID: u32 = 0x0000_0A7F;
/// Full length, and a valid tail byte, for a babbler need not be broken otherwise.
const BABBLE_DATA: [u8; 8] = [0x55, 0x55, 0x55, 0x55, 0x55, 0x55, 0x55, 0xC0];

/// See the module.
pub struct Scene {
    bench: Bench,
    node: usize,
    node_port: PortId,
    autopilot: Autopilot,
    babbler: Rc<RefCell<SoftNode>>,
    /// Faults to come, in order of time.
    injections: VecDeque<Injection>,
    state: State,
    resets_seen: usize,
    stack_bottom: Option<u16>,
    next_stack_at: Cycles,
    /// What a chip does that got noise for commands is not the driver's mistake.
    spi_disturbed: bool,
}

impl Scene {
    /// Boots the firmware at time 0.
    ///
    /// # Errors
    /// If there is no firmware, or it cannot be run; the message says what to do.
    pub fn new(args: &Args) -> Result<Scene> {
        let path = args.elf.clone().unwrap_or_else(node_elf);
        Scene::boot(&Firmware::read(&path)?, args)
    }

    /// Boots a firmware that has been read already.
    ///
    /// # Errors
    /// If simavr does not know the chip.
    pub fn boot(firmware: &Firmware, args: &Args) -> Result<Scene> {
        let board = Board::new(Avr::with_firmware(firmware)?);
        let mut bench = Bench::new(args.bit_rate);
        let node = bench.add_board(board, "node");
        let mut autopilot = Autopilot::new(args.autopilot(), args.bit_rate);
        if let Some(deflection) = args.hold {
            autopilot.hold(deflection);
        }
        bench.attach("autopilot", autopilot.station());
        let babbler = Rc::new(RefCell::new(SoftNode::new(args.bit_rate)));
        bench.attach("babbler", babbler.clone());
        let mut injections: Vec<_> = args.inject.clone();
        injections.sort_by_key(|injection| injection.at);

        let mut state = State::new(args.bit_rate);
        let bytes: usize = firmware.flash.iter().map(|(_, bytes)| bytes.len()).sum();
        state.memory.flash = bytes as u32;
        let stack_bottom = firmware.symbols.get(STACK_BOTTOM_SYMBOL).map(|s| s.address as u16);
        if let Some(bottom) = stack_bottom {
            state.memory.statics = u32::from(bottom - regs::RAMSTART);
        }
        let mut scene = Scene {
            node_port: bench.port(node),
            bench,
            node,
            autopilot,
            babbler,
            injections: injections.into(),
            state,
            resets_seen: 1,
            stack_bottom,
            next_stack_at: STACK_PERIOD,
            spi_disturbed: false,
        };
        scene.set_temperature(args.temperature);
        scene.collect();
        Ok(scene)
    }

    /// Simulated time.
    pub fn now(&self) -> Cycles {
        self.state.now
    }

    /// What is known.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// What is known, for taking the news.
    pub fn state_mut(&mut self) -> &mut State {
        &mut self.state
    }

    /// Simulates until `until`; faults of the command line happen at their times.
    pub fn advance(&mut self, until: Cycles) {
        while self.now() < until {
            let fault_at = self.injections.front().map_or(until, |injection| injection.at);
            self.run(until.min(fault_at));
            while let Some(injection) = self.injections.pop_front_if(|i| i.at <= self.state.now) {
                self.inject(injection.fault);
            }
        }
    }

    fn run(&mut self, until: Cycles) {
        if until > self.now() {
            self.autopilot.advance(until);
            self.bench.run_until(until);
            self.collect();
        }
    }

    /// Moves the servo by a part of its deflection, and holds it.
    pub fn nudge(&mut self, step: f64) {
        self.autopilot.nudge(step, self.now());
        self.look_at_autopilot();
    }

    /// Sweeps, or holds where it is.
    pub fn toggle_sweep(&mut self) {
        let now = self.now();
        if self.autopilot.is_sweeping() {
            self.autopilot.nudge(0.0, now);
        } else {
            self.autopilot.sweep(now);
        }
        self.look_at_autopilot();
    }

    /// Changes the unit of the commands.
    pub fn next_command_type(&mut self) {
        let next = self.autopilot.settings().command_type.next();
        self.autopilot.set_command_type(next);
        self.look_at_autopilot();
    }

    /// Changes the temperature at the sensor by so many degrees.
    pub fn warm(&mut self, degrees: f64) {
        self.set_temperature(self.state.sensor_c + degrees);
    }

    fn set_temperature(&mut self, celsius: f64) {
        self.state.sensor_c = celsius;
        self.bench.board(self.node).set_temperature_c(celsius);
    }

    /// Causes a fault now, or ends it if it lasts already.
    pub fn inject(&mut self, fault: Fault) {
        let on = !self.state.active_faults.contains(&fault);
        if fault.lasts() {
            self.state.active_faults.retain(|active| *active != fault);
            if on {
                self.state.active_faults.push(fault);
            }
        }
        let bus = self.bench.bus();
        let node_port = self.node_port;
        match fault {
            Fault::BitError => bus.inject(can::Fault::FlipBit { bit: FLIPPED_BIT }),
            Fault::ErrorRate => bus.inject(can::Fault::BitErrorRate {
                per_million: if on { ERROR_RATE_PER_MILLION } else { 0 },
                seed: NOISE_SEED,
            }),
            Fault::LoseFrame => bus.inject(can::Fault::LoseNextFrame { port: node_port }),
            Fault::NoAck => bus.inject(can::Fault::NoAck(on)),
            Fault::StuckDominant => bus.inject(can::Fault::StuckDominant(on)),
            Fault::Cable => bus.connect(node_port, !on),
            Fault::Babble => {
                let frame = on.then(|| Frame::extended(BABBLE_ID, &BABBLE_DATA));
                self.babbler.borrow_mut().babble(frame);
            }
            Fault::ChipReset => self.board().chip_reset(),
            Fault::SpiNoise => {
                self.spi_disturbed = true;
                let per_million = if on { SPI_NOISE_PER_MILLION } else { 0 };
                self.board().set_spi_noise(per_million, NOISE_SEED);
            }
            Fault::ChipPower if on => self.board().chip_power_off(0xFF),
            Fault::ChipPower => self.board().chip_power_on(),
            Fault::Silence => self.autopilot.set_silent(on),
            Fault::Reset => self.board().reset(ResetCause::External),
        }
        let state = match (fault.lasts(), on) {
            (true, true) => " on",
            (true, false) => " off",
            (false, _) => "",
        };
        let text = format!("{fault}{state}: {}", fault.explanation());
        self.state.tell(self.now(), News::Fault(text));
        self.look_at_autopilot();
    }

    fn board(&mut self) -> &mut Board {
        self.bench.board(self.node)
    }

    /// Takes everything out of the bench that has come up since the last call.
    fn collect(&mut self) {
        self.state.pass(self.bench.now());
        self.look_at_board();
        self.look_at_chip();
        self.look_at_bus();
        self.look_at_autopilot();
    }

    fn look_at_board(&mut self) {
        let now = self.state.now;
        let board = self.bench.board(self.node);
        for (at, byte) in board.avr_mut().serial_take() {
            self.state.serial_byte(at, byte);
        }
        for pulse in board.take_servo_pulses() {
            self.state.pulse(pulse.start, pulse.width_cycles, pulse.period_cycles);
        }
        for violation in board.take_violations() {
            let text = format!("{}: {}", violation.source, violation.text);
            if self.spi_disturbed {
                self.state.tell(violation.at, News::Fault(format!("after SPI noise, {text}")));
            } else {
                self.state.violation(violation.at, text);
            }
        }
        let resets = board.avr().resets();
        for reset in &resets[self.resets_seen.min(resets.len())..] {
            let text = format!("the AVR was reset: {:?}", reset.cause);
            self.state.tell(reset.at, News::Reset(text));
        }
        self.resets_seen = resets.len();
        match board.avr().state() {
            avr::State::Crashed(pc) => {
                let text = format!("the program counter left the flash at {pc:#06x}");
                self.state.crashed(now, text);
            }
            avr::State::Done => {
                self.state.crashed(now, String::from("asleep for ever, with interrupts off"));
            }
            avr::State::Running | avr::State::Sleeping => {}
        }
        if let Some(bottom) = self.stack_bottom
            && now >= self.next_stack_at
        {
            self.next_stack_at = now + STACK_PERIOD;
            let used = u32::from(board.avr().stack_high_water(STACK_PAINT, bottom));
            self.state.memory.stack = self.state.memory.stack.max(Some(used));
        }
    }

    fn look_at_chip(&mut self) {
        let chip = self.bench.board(self.node).chip();
        let mut chip = chip.borrow_mut();
        for entry in chip.take_frame_log() {
            if let Fate::Cleared(at) = entry.fate {
                self.state.served(at - entry.received_at);
            }
        }
        self.state.look_at_controller(Controller {
            mode: format!("{:?}", chip.mode()),
            tec: chip.tec(),
            rec: chip.rec(),
            error_state: chip.error_state(),
            overflows: u64::from(chip.rx_overflows()),
        });
    }

    fn look_at_bus(&mut self) {
        for record in self.bench.bus().take_records() {
            let from = match record.kind {
                can::RecordKind::Frame { from, .. } | can::RecordKind::ErrorFrame { from, .. } => from,
            };
            let station = from.map(|port| self.bench.bus().name(port).to_owned());
            let from_node = from == Some(self.node_port);
            self.state.record(&record, from_node, station.as_deref());
        }
        // What the stations heard is on the bus's record; kept, it would only grow.
        self.autopilot.take_received();
        let mut babbler = self.babbler.borrow_mut();
        babbler.take_received();
    }

    fn look_at_autopilot(&mut self) {
        let autopilot = &self.autopilot;
        self.state.autopilot = AutopilotState {
            node_id: autopilot.settings().node_id.get(),
            deflection: autopilot.deflection(self.state.now),
            sweeping: autopilot.is_sweeping(),
            silent: autopilot.is_silent(),
            command_type: autopilot.settings().command_type.to_string(),
            commands_sent: autopilot.commands_sent(),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    /// `rjmp .`: a program that does nothing for ever.
    const IDLE: [u8; 2] = [0xFF, 0xCF];

    fn scene(program: &[u8], options: &str) -> Scene {
        let firmware = Firmware { flash: vec![(0, program.to_vec())], ..Firmware::default() };
        let line = format!("sim {options}");
        let args = Args::try_parse_from(line.split_whitespace()).unwrap();
        Scene::boot(&firmware, &args).unwrap()
    }

    fn news(scene: &mut Scene) -> Vec<(Cycles, News)> {
        scene.state_mut().take_news()
    }

    #[test]
    fn the_autopilot_is_heard_on_the_bus() {
        let mut scene = scene(&IDLE, "");
        scene.advance(F_CPU_HZ / 2);
        assert_eq!(scene.state().bus.frames, 26);
        assert_eq!(scene.state().bus.unacknowledged, 0);
        let line = scene.state().traffic.last().unwrap();
        assert_eq!((line.who.as_str(), line.name.as_str()), ("1", "ArrayCommand"));
        assert_eq!(scene.state().status, None);
    }

    #[test]
    fn faults_happen_at_their_time_in_any_order_and_end_when_repeated() {
        let mut scene = scene(&IDLE, "--inject silence@30ms --inject babble@10ms --inject babble@20ms");
        scene.advance(F_CPU_HZ / 20);
        let faults: Vec<_> = news(&mut scene)
            .into_iter()
            .filter_map(|(at, news)| match news {
                News::Fault(text) => Some((at * 1000 / F_CPU_HZ, text)),
                _ => None,
            })
            .collect();
        let times: Vec<_> = faults.iter().map(|(ms, _)| *ms).collect();
        assert_eq!(times, [10, 20, 30]);
        assert!(faults[0].1.starts_with("babble on"), "{faults:?}");
        assert!(faults[1].1.starts_with("babble off"), "{faults:?}");
        assert_eq!(scene.state().active_faults, [Fault::Silence]);
        assert!(scene.state().bus.load_percent(scene.now()) > 10.0);
    }

    #[test]
    fn without_ack_the_frames_are_counted_as_such() {
        let mut scene = scene(&IDLE, "--inject no-ack@0s");
        scene.advance(F_CPU_HZ / 100);
        assert!(scene.state().bus.error_frames > 0);
        assert_eq!(scene.state().active_faults, [Fault::NoAck]);
    }

    #[test]
    fn keys_steer_the_autopilot() {
        let mut scene = scene(&IDLE, "--hold 0.5");
        scene.nudge(0.25);
        assert_eq!(scene.state().autopilot.deflection, 0.75);
        scene.toggle_sweep();
        assert!(scene.state().autopilot.sweeping);
        scene.toggle_sweep();
        assert!(!scene.state().autopilot.sweeping);
        assert!((scene.state().autopilot.deflection - 0.75).abs() < 1e-9);
        scene.next_command_type();
        assert_eq!(scene.state().autopilot.command_type, "position");
        scene.warm(-1.0);
        assert_eq!(scene.state().sensor_c, 24.0);
    }

    /// What blocked the bus must not be followed by a burst of commands from the past.
    #[test]
    fn commands_that_could_not_be_sent_are_given_up() {
        let mut scene = scene(&IDLE, "--inject stuck-dominant@0s --inject stuck-dominant@1s");
        for slice in 1..=120 {
            scene.advance(slice * F_CPU_HZ / 100);
        }
        let frames = scene.state().bus.frames;
        assert!((10..=16).contains(&frames), "{frames} frames in 0.2 s");
    }

    #[test]
    fn a_program_that_leaves_the_flash_has_crashed() {
        let mut scene = scene(&[0x00, 0x00], "");
        scene.advance(F_CPU_HZ / 10);
        scene.advance(F_CPU_HZ / 5);
        let crash = scene.state().crash.clone().unwrap();
        assert!(crash.contains("left the flash"), "{crash}");
        let told = news(&mut scene).into_iter().filter(|(_, n)| matches!(n, News::Crash(_)));
        assert_eq!(told.count(), 1);
    }

    #[test]
    fn a_pressed_reset_button_is_told_with_its_cause() {
        let mut scene = scene(&IDLE, "--inject reset@5ms");
        scene.advance(F_CPU_HZ / 100);
        let told = news(&mut scene)
            .into_iter()
            .any(|(at, n)| matches!(n, News::Reset(text) if text.contains("External")) && at / (F_CPU_HZ / 1000) == 5);
        assert!(told);
    }

    #[test]
    fn the_same_options_give_the_same_run() {
        let run = || {
            let mut scene = scene(&IDLE, "--inject error-rate@10ms");
            scene.advance(F_CPU_HZ / 5);
            news(&mut scene)
        };
        assert_eq!(run(), run());
    }
}
