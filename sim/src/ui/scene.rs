//! The scene: the bench, the autopilot on its bus, and the [`State`] of both. Advancing a scene
//! lets simulated time pass.
//!
//! A scene uses no terminal and no wall clock, so a test can run it, too.
//!
//! At least three stations share the bus: the node, the autopilot, and a babbler. The babbler
//! acknowledges all frames, as a bus analyser does, until the fault `babble` makes it send. So the
//! autopilot still gets its ACKs when the node's cable is pulled. Further boards and links can add
//! stations. The scene serves the links at least each simulated millisecond.

use super::args::Args;
use super::discharge::Discharge;
use super::escs::Escs;
use super::findings::{Findings, Said};
use super::pace::Speed;
use super::state::{AutopilotState, Controller, Event, State};
use crate::fault::{Fault, Injection};
use crate::links::Link;
use crate::links::script::{BenchEvent, RPM_MAX, Script};
use crate::pins::Watched;
use crate::usage::OrUsage;
use anyhow::{Context, Result, anyhow};
use bench::autopilot::{Autopilot, Moves, Settings};
use bench::avr::{Avr, Firmware, ResetCause};
use bench::board::Board;
use bench::budget::Budget;
use bench::can::PortId;
use bench::corner::Corner;
use bench::dronecan::text::visible;
use bench::findings;
use bench::i2c;
use bench::inject::{Injector, Target};
use bench::mcp2515::{Fate, LoggedFrame};
use bench::node_ids::{self, CAN_NODE};
use bench::pins::Setting;
use bench::wiring::Wiring;
use bench::{Bench, Cycles, F_CPU_HZ, firmware_like, node_elf};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};

/// Value of an erased flash byte.
const ERASED: u8 = 0xFF;
/// Revolutions a minute for a press of a key.
const SPIN_STEP_RPM: i64 = 600;
/// Simulated time between two measurements of the flash that a bootloader writes.
const FLASH_PERIOD: Cycles = F_CPU_HZ / 10;
/// Sender of the fault `same-id` before the first NodeStatus of the node.
const DEFAULT_NODE_ID: u8 = 120;

/// Longest simulated time between two calls of [`Link::serve`].
const SERVE_PERIOD: Cycles = F_CPU_HZ / 1000;
/// Simulated time between two updates of the links' status lines.
const STATUS_PERIOD: Cycles = F_CPU_HZ / 10;

/// A bench with its boards, autopilot, links and script, and the state that the views show.
pub struct Scene {
    bench: Bench,
    node: usize,
    node_port: PortId,
    /// Numbers of the further boards.
    others: Vec<usize>,
    /// True if each further board started with a node ID of its own.
    have_own_ids: bool,
    autopilot: Option<(Autopilot, PortId)>,
    /// Settings of the autopilot before the last `other-dialect`.
    replaced: Option<Settings>,
    links: Vec<Box<dyn Link>>,
    script: Option<Script>,
    next_status_at: Cycles,
    /// End of the application section in bytes, if there is a bootloader, which can replace the
    /// application.
    application_end: Option<usize>,
    injector: Injector,
    /// Faults of `--inject` that are not due yet, in order of time.
    injections: VecDeque<Injection>,
    state: State,
    resets_seen: usize,
    jumps_seen: usize,
    unmodelled_seen: usize,
    findings: Findings,
    next_flash_at: Cycles,
    /// True once a fault has disturbed the chip or its SPI: wrong commands from then on are not
    /// the driver's mistakes.
    is_chip_disturbed: bool,
    discharge: Option<Discharge>,
    watched: Vec<Watched>,
    /// The devices on the two-wire bus of the node's board.
    i2c: i2c::Devices,
}

impl Scene {
    /// Reads the firmware that `args` names, and powers the boards at time 0.
    ///
    /// # Errors
    /// If the firmware or the bootloader is missing or does not fit, or a link cannot be opened;
    /// the message says what to do.
    pub fn new(args: &Args) -> Result<Scene> {
        // With --no-program the firmware only describes the board, and may be missing.
        let (path, firmware) = match firmware(args) {
            Err(_) if args.links.no_program && args.elf.is_none() => Default::default(),
            found => found?,
        };
        let wiring =
            Wiring::of_program(&firmware).with_context(|| path.display().to_string()).or_usage()?;
        let chip = args.wires.apply(wiring).or_usage()?.chip;
        firmware.check_fits(chip).with_context(|| path.display().to_string()).or_usage()?;
        Scene::boot(&firmware, args)
    }

    /// Powers the boards at time 0 with a firmware that is read already.
    ///
    /// # Errors
    /// If the firmware does not fit the chip, an option does not fit the board, or a link cannot be
    /// opened.
    pub fn boot(firmware: &Firmware, args: &Args) -> Result<Scene> {
        let wiring = args.wires.apply(Wiring::of_program(firmware)?).or_usage()?;
        let loader = args
            .links
            .bootloader
            .as_ref()
            .map(|hex| bootloader(hex.as_deref(), &wiring))
            .transpose()?;
        let (loader, boot_section) = loader.unzip();
        let nothing = Firmware::default();
        let first = if args.links.no_program { &nothing } else { firmware };
        let powered = |program: &Firmware, seed: u64| {
            let mut avr = Avr::programmed_on(args.processor.into(), wiring.chip, program)?;
            avr.seed(seed);
            if let Some(loader) = &loader {
                avr.install_bootloader(loader)?;
            }
            avr.reset(ResetCause::PowerOn);
            avr.watch_stack();
            anyhow::Ok(avr)
        };
        let knows_vendor_code = firmware.board.is_some();
        let limits = knows_vendor_code.then(|| Budget::of(wiring.chip));
        let bit_rate = args.bit_rate(&wiring);
        let circuit_inputs_mv = args.circuit_millivolts(&wiring).or_usage()?;
        let shaft_rpm = args.shaft_rpm(&wiring).or_usage()?;
        let avr = powered(first, 0)?;
        let resets_seen = avr.resets().len();
        let mut bench = Bench::new(bit_rate);
        let corner = args.wires.corner();
        let fitted = |avr: Avr| {
            let mut board = Board::wired(avr, &wiring)?;
            board.set_corner(&corner);
            anyhow::Ok(board)
        };
        let node = bench.add_board(fitted(avr)?, "node");
        // Other projects' programs have their IDs themselves, and so have EEPROMs from files.
        let can_have_ids = knows_vendor_code && args.links.eeprom.is_none();
        let mut have_own_ids = can_have_ids;
        let others = (2..args.links.nodes + 2).map(|number| {
            let seed = number as u64;
            let mut avr = powered(firmware, seed)?;
            let id = node_ids::id_of(number - 2).filter(|_| can_have_ids);
            let saved = id.map(|id| {
                let parameters = [(CAN_NODE, id.into())];
                let bit_rate = bit_rate.min(wiring.fastest_bit_rate());
                node_ids::saved(powered(firmware, seed)?, &wiring, bit_rate, &parameters)
            });
            match saved.transpose()?.flatten() {
                Some(cells) => avr.set_eeprom(&cells),
                None => have_own_ids = false,
            }
            Ok(bench.add_board(fitted(avr)?, &format!("node{number}")))
        });
        let others = others.collect::<Result<Vec<usize>>>()?;
        let autopilot = args.autopilot().or_usage()?.map(|settings| {
            let mut autopilot = Autopilot::new(settings, bit_rate);
            if let Some(deflection) = args.hold {
                autopilot.hold(deflection);
            }
            let port = bench.attach("autopilot", autopilot.station());
            (autopilot, port)
        });
        let injector = Injector::new(&mut bench);
        let boards: Vec<usize> = [node].into_iter().chain(others.iter().copied()).collect();
        let script = args
            .links
            .script
            .as_deref()
            .map(|path| Script::open(path, &mut bench))
            .transpose()
            .or_usage()?;
        for setting in &args.set {
            setting.check(&wiring).or_usage()?;
        }
        let watched: Vec<Watched> =
            args.watch.iter().map(|pin| Watched::attach(*pin, bench.board(node))).collect();
        let links = args.links.open(&mut bench, &boards, boot_section, &args.watch)?;
        let mut injections: Vec<_> = args.inject.clone();
        injections.sort_by_key(|injection| injection.at);

        let mut state = State::new(bit_rate);
        state.memory.flash = first.flash.iter().map(|(_, bytes)| bytes.len() as u32).sum();
        // The bootloader can load another program, so the statics of this one do not count.
        let has_statics = loader.is_none() && firmware.has_statics;
        state.memory.statics = has_statics.then_some(firmware.statics);
        state.memory.limits = limits;
        state.knows_vendor_code = knows_vendor_code;
        state.report(0, Event::Board(format!("{wiring}; bus {} kbit/s", bit_rate / 1000)));
        if corner != Corner::default() {
            state.report(0, Event::Board(format!("corner: {corner}")));
        }
        state.wiring = wiring;
        state.escs = Escs::new(&args.escs);
        let mut scene = Scene {
            node_port: bench.port(node),
            bench,
            node,
            others,
            have_own_ids,
            autopilot,
            replaced: None,
            links,
            script,
            next_status_at: 0,
            application_end: boot_section,
            injector,
            injections: injections.into(),
            state,
            resets_seen,
            jumps_seen: 0,
            unmodelled_seen: 0,
            findings: Findings::new(boot_section),
            next_flash_at: FLASH_PERIOD,
            is_chip_disturbed: false,
            discharge: args.pwr_discharge.map(|minutes| {
                let [full_mv, _] = circuit_inputs_mv;
                Discharge::new(full_mv, minutes)
            }),
            watched,
            i2c: i2c::Devices::default(),
        };
        if !knows_vendor_code {
            scene.findings.watch_selects(scene.bench.board(node));
        }
        scene.set_temperature(args.temperature);
        scene.set_circuit_inputs(circuit_inputs_mv);
        scene.set_shaft(shaft_rpm);
        for setting in &args.set {
            setting.apply(scene.board());
        }
        for setting in &args.i2c {
            scene.i2c.set(setting);
        }
        let devices = scene.i2c.clone();
        scene.board().avr_mut().connect_twi(Box::new(devices));
        for text in scene.watched.iter().map(Watched::text) {
            scene.state.report(0, Event::Pin(text));
        }
        scene.collect()?;
        scene.update_links();
        scene.report_links(args);
        Ok(scene)
    }

    fn report_links(&mut self, args: &Args) {
        for line in self.state.links.clone() {
            self.state.report(0, Event::Link(line));
        }
        if self.needs_real_time() && args.speed != Speed::Factor(1.0) {
            let text = "--speed is not 1, but clients use the wall clock: they can time out or \
                        get too many frames";
            self.state.report(0, Event::Link(String::from(text)));
        }
    }

    /// Simulated time.
    pub fn now(&self) -> Cycles {
        self.state.now
    }

    /// The state of the bench.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// The state of the bench, for taking its events.
    pub fn state_mut(&mut self) -> &mut State {
        &mut self.state
    }

    /// True if a link can have clients that use the wall clock.
    pub fn needs_real_time(&self) -> bool {
        self.links.iter().any(|link| link.needs_real_time())
    }

    /// True while a client has a limited time to answer; see [`Link::gives_time`].
    pub fn gives_time(&self) -> bool {
        self.links.iter().any(|link| link.gives_time())
    }

    /// Simulates until `until`, or until a debugger halts a board. Causes the faults of the command
    /// line and the events of the script at their times.
    ///
    /// # Errors
    /// If a link cannot go on; see [`Link::serve`].
    pub fn advance(&mut self, until: Cycles) -> Result<()> {
        while self.now() < until {
            let mut next =
                self.injections.front().map_or(until, |injection| injection.at).min(until);
            if let Some(at) =
                self.script.as_ref().and_then(Script::next_event_at).filter(|at| *at > self.now())
            {
                next = next.min(at);
            }
            // An autopilot answers requests between two slices only, as links do.
            if !self.links.is_empty() || self.script.is_some() || self.autopilot.is_some() {
                next = next.min(self.now() + SERVE_PERIOD);
            }
            self.run(next)?;
            self.discharge();
            while let Some(injection) = self.injections.pop_front_if(|i| i.at <= self.state.now) {
                self.inject(injection.fault);
            }
            let events = self
                .script
                .as_mut()
                .map(|script| script.take_events(self.state.now))
                .unwrap_or_default();
            for (_, event) in events {
                self.apply(event);
            }
            self.serve_links()?;
            // Time does not pass while a board is halted: return, so that the caller sees keys and
            // signals.
            if self.bench.is_halted() {
                break;
            }
        }
        Ok(())
    }

    fn run(&mut self, until: Cycles) -> Result<()> {
        if until > self.now() {
            if let Some((autopilot, _)) = &mut self.autopilot {
                autopilot.advance(until);
            }
            self.bench.run_until(until);
            self.collect()?;
        }
        Ok(())
    }

    fn apply(&mut self, event: BenchEvent) {
        match event {
            BenchEvent::Temperature(celsius) => self.set_temperature(celsius),
            BenchEvent::CircuitVoltage(millivolts) => {
                let [_, current] = self.state.circuit_inputs_mv;
                self.set_circuit_inputs([millivolts, current]);
            }
            BenchEvent::CircuitCurrent(millivolts) => {
                let [voltage, _] = self.state.circuit_inputs_mv;
                self.set_circuit_inputs([voltage, millivolts]);
            }
            BenchEvent::Button(pressed) => self.board().press_button(pressed),
            BenchEvent::Fault(fault) => self.inject(fault),
            BenchEvent::Set(setting) => self.set_pin(setting),
            BenchEvent::I2c(setting) => self.i2c.set(&setting),
            BenchEvent::Shaft(rpm) => self.set_shaft(rpm),
            BenchEvent::Serial(bytes) => self.board().avr_mut().serial_send(&bytes),
        }
    }

    /// Applies a level to a pin, unless the bench itself drives it.
    fn set_pin(&mut self, setting: Setting) {
        let now = self.now();
        match setting.check(&self.state.wiring) {
            Ok(()) => setting.apply(self.board()),
            Err(error) => self.state.report(now, Event::Pin(format!("not set: {error}"))),
        }
    }

    /// Serves the links without letting time pass.
    ///
    /// # Errors
    /// If a link cannot go on; see [`Link::serve`].
    pub fn serve(&mut self) -> Result<()> {
        self.serve_links()?;
        self.update_links();
        Ok(())
    }

    fn serve_links(&mut self) -> Result<()> {
        if let Some(script) = &mut self.script {
            script.serve(&mut self.bench)?;
        }
        let now = self.now();
        for link in &mut self.links {
            link.serve(&mut self.bench)?;
            if let Some(hint) = link.take_hint() {
                self.state.add_hint(now, hint);
            }
        }
        if self.now() >= self.next_status_at {
            self.next_status_at = self.now() + STATUS_PERIOD;
            self.update_links();
        }
        Ok(())
    }

    /// Ends the run: the links write their files.
    ///
    /// # Errors
    /// If a link cannot write its file.
    pub fn finish(&mut self) -> Result<()> {
        let mut result =
            self.script.as_mut().map_or(Ok(()), |script| script.finish(&mut self.bench));
        if let Some(hint) = self.script.as_mut().and_then(Script::take_hint) {
            self.state.add_hint(self.state.now, hint);
        }
        // An error of one file must not keep the others from being written.
        for link in &mut self.links {
            result = result.and(link.finish(&mut self.bench));
        }
        self.update_links();
        result
    }

    fn update_links(&mut self) {
        let ids = match self.have_own_ids {
            true => ", with other node IDs",
            false => "",
        };
        let further = match self.others.len() {
            0 => None,
            1 => Some(format!("1 further board, node2, has the same firmware as the node{ids}")),
            count => Some(format!(
                "{count} further boards, node2 to node{}, have the same firmware as the node{ids}",
                count + 1
            )),
        };
        let script = self.script.as_ref().map(Script::status);
        let links = self.links.iter().map(|link| link.status());
        self.state.links = further
            .into_iter()
            .chain(script)
            .chain(links)
            .filter(|status| !status.is_empty())
            // A status has the paths of the command line.
            .map(|status| visible(&status).into_owned())
            .collect();
    }

    /// Changes the commanded deflection by `step` and holds it there. 1 is full deflection.
    pub fn nudge(&mut self, step: f64) {
        let now = self.now();
        if let Some((autopilot, _)) = &mut self.autopilot {
            autopilot.nudge(step, now);
        }
        self.update_autopilot();
    }

    /// Starts the sweep, or stops it and holds the deflection.
    pub fn toggle_sweep(&mut self) {
        let now = self.now();
        match &mut self.autopilot {
            Some((autopilot, _)) if autopilot.is_sweeping() => autopilot.nudge(0.0, now),
            Some((autopilot, _)) => autopilot.sweep(now),
            None => {}
        }
        self.update_autopilot();
    }

    /// Changes the unit of the commands to the next one.
    pub fn next_command_type(&mut self) {
        if let Some((autopilot, _)) = &mut self.autopilot {
            autopilot.next_command_type();
        }
        self.update_autopilot();
    }

    /// Changes the temperature at the sensor by `degrees` degrees Celsius.
    pub fn warm(&mut self, degrees: f64) {
        self.set_temperature(self.state.sensor_c + degrees);
    }

    fn set_temperature(&mut self, celsius: f64) {
        self.state.sensor_c = celsius;
        self.bench.board(self.node).set_temperature_c(celsius);
    }

    /// Changes the speed of the shaft by steps of [`SPIN_STEP_RPM`].
    pub fn spin(&mut self, steps: i8) {
        if self.state.wiring.rpm.is_none() {
            return;
        }
        let change = i64::from(steps) * SPIN_STEP_RPM;
        let rpm = (i64::from(self.state.shaft_rpm) + change).clamp(0, RPM_MAX.into());
        self.set_shaft(rpm as u32);
    }

    fn set_shaft(&mut self, rpm: u32) {
        self.state.shaft_rpm = rpm;
        self.board().set_shaft_rpm(rpm);
    }

    /// Lowers the voltage of the circuit with `--pwr-discharge`.
    fn discharge(&mut self) {
        let Some(discharge) = self.discharge else { return };
        let [before, current] = self.state.circuit_inputs_mv;
        let voltage = discharge.millivolts(self.now());
        if voltage != before {
            self.set_circuit_inputs([voltage, current]);
        }
    }

    fn set_circuit_inputs(&mut self, millivolts: [u32; 2]) {
        self.state.circuit_inputs_mv = millivolts;
        let [voltage, current] = millivolts;
        self.bench.board(self.node).set_circuit_millivolts(voltage, current);
    }

    /// Begins a fault now; ends it if it lasts and is on.
    pub fn inject(&mut self, fault: Fault) {
        self.is_chip_disturbed |= fault.disturbs_chip();
        let mut target = Target {
            bench: &mut self.bench,
            node: self.node,
            autopilot: self.autopilot.as_mut().map(|(autopilot, _)| autopilot),
            node_id: self.state.status.map_or(DEFAULT_NODE_ID, |(_, node, _)| node.get()),
            sensor_c: self.state.sensor_c,
        };
        let on = self.injector.inject(fault, &mut target);
        self.state.active_faults = self.injector.active().to_vec();
        if fault == Fault::OtherDialect {
            self.replace_autopilot();
        }
        let state = match (fault.lasts(), on) {
            (true, true) => " on",
            (true, false) => " off",
            (false, _) => "",
        };
        let text = format!("{fault}{state}: {}", fault.explanation());
        self.state.report(self.now(), Event::Fault(text));
        self.update_autopilot();
    }

    /// Ends a fault if it is on.
    pub fn end(&mut self, fault: Fault) {
        if self.state.active_faults.contains(&fault) {
            self.inject(fault);
        }
    }

    /// Ends each fault that is on.
    pub fn end_all(&mut self) {
        for fault in self.state.active_faults.clone() {
            self.end(fault);
        }
    }

    /// Replaces the autopilot by one of the other dialect, at its power-on. The next replacement
    /// has the first one's settings again.
    fn replace_autopilot(&mut self) {
        let Some((autopilot, port)) = &mut self.autopilot else { return };
        let old = autopilot.settings().clone();
        let dialect = old.dialect.other();
        let new = self.replaced.replace(old.clone()).unwrap_or_else(|| old.in_dialect(dialect));
        autopilot.replace(new, &mut self.bench, port);
    }

    fn board(&mut self) -> &mut Board {
        self.bench.board(self.node)
    }

    /// Moves all new output of the bench into the state, the script and the links.
    fn collect(&mut self) -> Result<()> {
        self.state.advance_to(self.bench.now());
        self.collect_from_board();
        self.collect_from_others();
        self.collect_from_chip();
        self.collect_from_bus()?;
        self.update_autopilot();
        Ok(())
    }

    fn collect_from_board(&mut self) {
        let now = self.state.now;
        let board = self.bench.board(self.node);
        let serial = board.avr_mut().serial_take();
        let rate = board.avr().serial_sent_rate();
        for (at, byte) in &serial {
            self.state.push_serial_byte(*at, *byte);
        }
        for said in self.findings.check(board, self.state.bus.bit_rate, !serial.is_empty()) {
            match said {
                Said::Hint(_) if self.is_chip_disturbed => {}
                Said::Hint(text) => self.state.add_hint(now, text),
                Said::Note(text) => self.state.report(now, Event::Board(text)),
            }
        }
        self.state.spi = board.spi_use();
        for link in &mut self.links {
            link.serial_output(self.node, &serial, rate);
        }
        let pulses = board.take_servo_pulses().into_iter();
        let has_servo = !self.findings.is_chip_select(board.wiring().servo);
        for pulse in pulses.filter(|_| has_servo) {
            self.state.add_pulse(pulse.start, pulse.width_cycles, pulse.period_cycles);
        }
        let outputs = board.take_output_pulses().into_iter();
        self.state.set_output_pulses(
            outputs.map(|pulses| pulses.last().map(|pulse| (pulse.start, pulse.width_cycles))),
        );
        self.state.set_light(now, board.light());
        for watched in &mut self.watched {
            for (at, text) in watched.take(now) {
                self.state.report(at, Event::Pin(text));
            }
        }
        for (at, text) in self.i2c.take_transactions() {
            self.state.report(at, Event::I2c(text));
        }
        let missing = self.i2c.missing(now).into_iter();
        missing.for_each(|address| self.state.add_hint(now, nobody_at(address)));
        self.state.i2c = self.i2c.written();
        self.state.pins = self.watched.iter().map(Watched::text).collect();
        for violation in board.take_violations() {
            if self.is_chip_disturbed {
                let text = format!("after a fault of the chip: {violation}");
                self.state.report(violation.at, Event::Fault(text));
            } else {
                self.state.add_mistake(violation.at, violation.to_string());
            }
        }
        let unmodelled = board.avr().unmodelled_after(self.unmodelled_seen);
        self.unmodelled_seen += unmodelled.len();
        for feature in unmodelled {
            self.state.add_unmodelled(feature.at, feature.text);
        }
        if let Some(address) = board.avr().erased_flash_entered() {
            let text = format!(
                "the processor ran into erased flash at {address:#06x}: no program is there. What \
                 it does until its next reset is not reported"
            );
            self.state.add_hint(now, text);
        }
        let jumps = board.avr().jumps_after(self.jumps_seen);
        self.jumps_seen += jumps.len();
        for at in jumps {
            self.state.add_jump(at, findings::after_overrun(board.avr()));
        }
        let resets = board.avr().resets_after(self.resets_seen);
        self.resets_seen += resets.len();
        for reset in resets {
            self.state.add_reset(reset.at, format!("{:?}", reset.cause));
        }
        if let Some(text) = findings::crash(board.avr()) {
            self.state.set_crash(now, text);
        }
        self.state.memory.stack = board.avr().deepest_stack().map(u32::from);
        if now < self.next_flash_at {
            return;
        }
        self.next_flash_at = now + FLASH_PERIOD;
        if let Some(end) = self.application_end {
            let programmed = board.avr().flash()[..end].iter().rposition(|byte| *byte != ERASED);
            self.state.memory.flash = programmed.map_or(0, |last| last as u32 + 1);
        }
    }

    /// Reports the mistakes and crashes of the further boards, and drops their other output, which
    /// would pile up.
    fn collect_from_others(&mut self) {
        let now = self.state.now;
        for (index, number) in self.others.iter().enumerate() {
            let name = format!("node{}", index + 2);
            let board = self.bench.board(*number);
            let serial = board.avr_mut().serial_take();
            for link in &mut self.links {
                link.serial_output(*number, &serial, board.avr().serial_sent_rate());
            }
            board.take_servo_pulses();
            board.take_output_pulses();
            board.chip().borrow_mut().take_frame_log();
            for violation in board.take_violations() {
                self.state.add_mistake(violation.at, format!("{name}: {violation}"));
            }
            if let Some(text) = findings::crash(board.avr()) {
                self.state.set_crash(now, format!("{name}: {text}"));
            }
        }
    }

    fn collect_from_chip(&mut self) {
        let now = self.state.now;
        let chip = self.bench.board(self.node).chip();
        let mut chip = chip.borrow_mut();
        for entry in chip.take_frame_log() {
            self.state.frames_for_node += 1;
            match entry.fate {
                Fate::Cleared(at) => self.state.add_latency(at - entry.received_at),
                Fate::Lost => {
                    self.state.add_lost_frame(entry.received_at, entry.frame, lost_by(&entry));
                    let hint = findings::unwritten_filters(&chip, &entry);
                    hint.into_iter().for_each(|hint| self.state.add_hint(now, hint));
                }
            }
        }
        self.state.set_controller(Controller {
            mode: format!("{:?}", chip.mode()),
            tec: chip.tec(),
            rec: chip.rec(),
            error_state: chip.error_state(),
            overflows: u64::from(chip.rx_overflows()),
        });
    }

    fn collect_from_bus(&mut self) -> Result<()> {
        for (record, from) in self.bench.take_records() {
            let (port, station) = from.unzip();
            let station = station.as_deref();
            self.state.add_record(&record, port == Some(self.node_port), station);
            if let Some(script) = &mut self.script {
                script.record(&record, station)?;
            }
            for link in &mut self.links {
                link.record(&record, station)?;
            }
        }
        // Without this the babbler's queue of received frames would grow without bound.
        self.injector.babbler().borrow_mut().take_received();
        Ok(())
    }

    fn update_autopilot(&mut self) {
        let now = self.state.now;
        if let Some((autopilot, _)) = &mut self.autopilot {
            for (at, text) in autopilot.take_events() {
                self.state.report(at, Event::Node(text));
            }
        }
        self.state.autopilot = self.autopilot.as_ref().map(|(autopilot, _)| AutopilotState {
            node_id: autopilot.settings().node_id.get(),
            deflection: autopilot.deflection(now),
            moves_all: autopilot.settings().moves == Moves::All,
            motors: autopilot.settings().motors,
            is_sweeping: autopilot.is_sweeping(),
            is_silent: autopilot.is_silent(),
            is_armed: autopilot.is_armed(),
            dialect: autopilot.settings().dialect,
            profile: autopilot.settings().profile.to_string(),
            command_type: autopilot.settings().command_type.to_string(),
            commands_sent: autopilot.commands_sent(),
        });
    }
}

/// Reads the bootloader from `hex`, or the one that `make boot` has built for the board. Returns it
/// with the start of its section.
fn bootloader(hex: Option<&Path>, wiring: &Wiring) -> Result<(Firmware, usize)> {
    let path =
        hex.map_or_else(|| bench::bootloader(wiring), |hex| Ok(hex.to_owned())).or_usage()?;
    let loader = Firmware::read_hex(&path).or_usage()?;
    let start = loader.boot_section(wiring.chip).map_err(|error| {
        // Debian's compiler makes it too long for its section.
        let is_optiboot = path.ends_with("optiboot_atmega328.hex");
        let advice = if is_optiboot { "; scripts/optiboot compiles one that fits" } else { "" };
        anyhow!("the bootloader {}: {error:#}{advice}", path.display())
    });
    Ok((loader, start.or_usage()?))
}

/// The program of the command line or of `make`. If it is for another chip or CAN board than
/// `--board` and `--shield` name, the one that `make firmware` has built for those.
fn firmware(args: &Args) -> Result<(PathBuf, Firmware)> {
    let path = args.elf.clone().map_or_else(node_elf, Ok)?;
    let firmware = Firmware::read(&path).or_usage();
    let names_board = args.wires.board.is_some() || args.wires.shield.is_some();
    if args.elf.is_some() || !names_board {
        return Ok((path, firmware?));
    }
    let of = match &firmware {
        Ok(firmware) => Wiring::of_program(firmware)?,
        Err(_) => Wiring::default(),
    };
    let wanted = args.wires.apply(of.clone()).or_usage()?;
    if firmware.is_ok() && (wanted.chip, &wanted.shield) == (of.chip, &of.shield) {
        return Ok((path, firmware?));
    }
    let path = firmware_like(&wanted).or_usage()?;
    let firmware = Firmware::read(&path).or_usage()?;
    Ok((path, firmware))
}

fn nobody_at(address: u8) -> String {
    format!(
        "nobody acknowledges {address:#04X} on the two-wire bus: --i2c {address:#04X} puts a \
         device there"
    )
}

/// Why the MCP2515 lost a frame.
fn lost_by(lost: &LoggedFrame) -> &'static str {
    match (lost.buffer, lost.other_is_full) {
        (_, true) => "both receive buffers were full",
        (0, false) => "RXB0 was full, and its bit BUKT lets nothing go on to RXB1, which was empty",
        _ => "RXB1 was full, and no filter of RXB0, which was empty, passes the frame",
    }
}

#[cfg(test)]
mod tests {
    use super::super::traffic::Hidden;
    use super::*;
    use bench::avr::Chip;
    use bench::dronecan::Dialect;
    use clap::Parser;

    /// `rjmp .`: an endless loop.
    const IDLE: [u8; 2] = [0xFF, 0xCF];

    fn scene(program: &[u8], options: &str) -> Scene {
        let firmware = Firmware { flash: vec![(0, program.to_vec())], ..Firmware::default() };
        let line = format!("sim {options}");
        let args = Args::try_parse_from(line.split_whitespace()).unwrap();
        Scene::boot(&firmware, &args).unwrap()
    }

    fn autopilot(scene: &Scene) -> &AutopilotState {
        scene.state().autopilot.as_ref().unwrap()
    }

    fn events(scene: &mut Scene) -> Vec<(Cycles, Event)> {
        scene.state_mut().take_events()
    }

    #[test]
    fn the_autopilot_sends_on_the_bus() {
        let mut scene = scene(&IDLE, "");
        scene.advance(F_CPU_HZ / 2).unwrap();
        assert_eq!(scene.state().bus.frames, 26);
        assert_eq!(scene.state().bus.unacknowledged, 0);
        let line = scene.state().traffic.last().unwrap();
        assert_eq!((line.who.as_str(), line.name.as_str()), ("1", "ArrayCommand"));
        assert_eq!(scene.state().status, None);
    }

    #[test]
    fn faults_happen_at_their_time_in_any_order_and_end_when_repeated() {
        let mut scene =
            scene(&IDLE, "--inject silence@30ms --inject babble@10ms --inject babble@20ms");
        scene.advance(F_CPU_HZ / 20).unwrap();
        let faults: Vec<_> = events(&mut scene)
            .into_iter()
            .filter_map(|(at, event)| match event {
                Event::Fault(text) => Some((at * 1000 / F_CPU_HZ, text)),
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

    /// Each fault alone: it begins, ends, and stops nothing else.
    #[test]
    fn every_fault_can_be_begun_and_ended() {
        for fault in crate::fault::ALL {
            let mut scene = scene(&IDLE, "");
            scene.inject(fault);
            assert_eq!(scene.state().active_faults.contains(&fault), fault.lasts(), "{fault}");
            scene.advance(F_CPU_HZ / 200).unwrap();
            scene.inject(fault);
            scene.advance(F_CPU_HZ / 100).unwrap();
            assert_eq!(scene.state().active_faults, [], "{fault}");
            assert_eq!(scene.state().mistakes.total(), 0, "{fault}");
        }
    }

    /// The list of active faults must not name one that is no longer in force.
    #[test]
    fn a_fault_stays_in_force_when_another_of_its_kind_ends() {
        let errors_after = |options: &str| {
            let mut scene = scene(&IDLE, options);
            scene.advance(F_CPU_HZ / 100).unwrap();
            let before = scene.state().bus.error_frames;
            scene.advance(F_CPU_HZ).unwrap();
            (scene.state().active_faults.clone(), scene.state().bus.error_frames - before)
        };
        let (active, errors) =
            errors_after("--inject error-storm@0s --inject error-rate@1ms --inject error-rate@2ms");
        assert_eq!(active, [Fault::ErrorStorm]);
        assert!(errors > 5, "{errors}");
        let (active, errors) = errors_after("--inject error-storm@0s --inject error-storm@1ms");
        assert_eq!((active, errors), (vec![], 0));
    }

    #[test]
    fn a_node_of_another_rate_destroys_the_frames_of_others() {
        let mut scene = scene(&IDLE, "--inject wrong-rate@1ms --inject wrong-rate@50ms");
        scene.advance(F_CPU_HZ / 20).unwrap();
        let errors = scene.state().bus.error_frames;
        assert!(errors > 5, "{errors}");
        scene.advance(F_CPU_HZ / 5).unwrap();
        assert!(scene.state().bus.error_frames - errors < 5);
    }

    #[test]
    fn without_ack_there_are_error_frames() {
        let mut scene = scene(&IDLE, "--inject no-ack@0s");
        scene.advance(F_CPU_HZ / 100).unwrap();
        assert!(scene.state().bus.error_frames > 0);
        assert_eq!(scene.state().active_faults, [Fault::NoAck]);
    }

    #[test]
    fn keys_change_the_speed_of_a_shaft_that_the_program_counts() {
        let mut scene = scene(&IDLE, "");
        scene.spin(1);
        assert_eq!(scene.state().shaft_rpm, 0);
        scene.state.wiring.rpm = scene.state.wiring.light;
        let mut speeds = Vec::new();
        for steps in [1, 1, -1, -1, -1, 1] {
            scene.spin(steps);
            speeds.push(scene.state().shaft_rpm);
        }
        assert_eq!(speeds, [600, 1200, 600, 0, 0, 600]);
    }

    #[test]
    fn keys_control_the_autopilot() {
        let mut scene = scene(&IDLE, "--hold 0.5");
        scene.nudge(0.25);
        assert_eq!(autopilot(&scene).deflection, 0.75);
        scene.toggle_sweep();
        assert!(autopilot(&scene).is_sweeping);
        scene.toggle_sweep();
        assert!(!autopilot(&scene).is_sweeping);
        assert!((autopilot(&scene).deflection - 0.75).abs() < 1e-9);
        scene.next_command_type();
        assert_eq!(autopilot(&scene).command_type, "position");
        scene.warm(-1.0);
        assert_eq!(scene.state().sensor_c, 24.0);
    }

    /// The uptime of the new autopilot begins at 0, and it holds the deflection of the old one.
    #[test]
    fn an_autopilot_of_the_other_dialect_replaces_the_first_and_is_replaced_by_it() {
        let mut scene =
            scene(&IDLE, "--autopilot ardupilot --hold 0.5 --inject other-dialect@1500ms");
        scene.advance(F_CPU_HZ * 3 / 2).unwrap();
        assert_eq!(autopilot(&scene).dialect, Dialect::Draft);
        scene.state_mut().take_events();
        scene.advance(3 * F_CPU_HZ).unwrap();
        let traffic = |scene: &mut Scene| {
            let line = |(at, event)| match event {
                Event::Traffic(line) => Some((at, line.who, line.text)),
                _ => None,
            };
            events(scene).into_iter().filter_map(line).collect::<Vec<_>>()
        };
        let lines = traffic(&mut scene);
        assert!(
            lines.iter().all(|(_, who, text)| who == "10" && text.starts_with("draft.")),
            "{lines:?}"
        );
        assert_eq!(lines[0].2, "draft.NodeStatus OK up 0 s vendor 0x0000");
        assert_eq!(lines[1].2, "draft.ArrayCommand id 1 +0.50");
        assert_eq!(lines.iter().filter(|(_, _, text)| text.contains("NodeStatus")).count(), 2);
        scene.inject(Fault::OtherDialect);
        assert_eq!(
            (autopilot(&scene).dialect, autopilot(&scene).profile.as_str()),
            (Dialect::V0, "ArduPilot")
        );
        scene.advance(4 * F_CPU_HZ).unwrap();
        let lines = traffic(&mut scene);
        assert!(lines.iter().any(|(_, _, text)| text.starts_with("ArmingStatus")), "{lines:?}");
        assert!(!lines.iter().any(|(_, _, text)| text.starts_with("draft.")), "{lines:?}");
        assert_eq!(scene.state().bus.unacknowledged, 0);
    }

    /// When a blocked bus is free again, the autopilot must not send a burst of old commands.
    #[test]
    fn the_autopilot_drops_commands_that_it_could_not_send() {
        let mut scene = scene(&IDLE, "--inject stuck-dominant@0s --inject stuck-dominant@1s");
        for slice in 1..=120 {
            scene.advance(slice * F_CPU_HZ / 100).unwrap();
        }
        let frames = scene.state().bus.frames;
        assert!((10..=16).contains(&frames), "{frames} frames in 0.2 s");
    }

    #[test]
    fn a_program_that_leaves_the_flash_has_crashed() {
        let mut scene = scene(&[0x00, 0x00], "");
        scene.advance(F_CPU_HZ / 10).unwrap();
        scene.advance(F_CPU_HZ / 5).unwrap();
        let crash = scene.state().crash.clone().unwrap();
        assert!(crash.contains("left the flash"), "{crash}");
        let crashes =
            events(&mut scene).into_iter().filter(|(_, event)| matches!(event, Event::Crash(_)));
        assert_eq!(crashes.count(), 1);
    }

    /// As a bootloader does that starts a program that is not there.
    #[test]
    fn what_runs_behind_erased_flash_is_one_hint_and_no_mistake() {
        // `sts 0x3000, r0`, beyond the RAM, for ever.
        let code = [&[ERASED; 0x100][..], &[0x00, 0x92, 0x00, 0x30, 0xFD, 0xCF]].concat();
        let mut scene = scene(&code, "");
        scene.advance(F_CPU_HZ / 10).unwrap();
        scene.advance(F_CPU_HZ / 5).unwrap();
        assert_eq!((scene.state().mistakes.total(), scene.state().crash.clone()), (0, None));
        let hints = events(&mut scene).into_iter().filter_map(|(_, event)| match event {
            Event::Hint(text) => Some(text),
            _ => None,
        });
        let about_flash = hints.filter(|text| text.contains("erased flash at 0x0000"));
        assert_eq!(about_flash.count(), 1);
    }

    #[test]
    fn the_board_is_announced_first_and_has_the_limits_of_its_chip() {
        let program = vec![(0, IDLE.to_vec())];
        let section = b"board=uno\nshield=module\nmcu=atmega328p\ncs=D10\nint=D2\ncrystal_mhz=8\n\
              servo=D9\nsensor=A0\n";
        let firmware = Firmware {
            flash: program.clone(),
            board: Some(section.to_vec()),
            ..Firmware::default()
        };
        let wiring = Wiring::of_program(&firmware).unwrap();
        let args = |line: &str| Args::try_parse_from(line.split(' ')).unwrap();
        let mut scene = Scene::boot(&firmware, &args("sim")).unwrap();
        let text = format!("{wiring}; bus 500 kbit/s");
        assert_eq!(events(&mut scene)[0], (0, Event::Board(text)));
        assert_eq!(scene.state().memory.limits, Some(Budget::of(Chip::Atmega328p)));
        assert!(scene.state().knows_vendor_code);
        // Options replace what the program says.
        let scene = Scene::boot(&firmware, &args("sim --shield sparkfun")).unwrap();
        assert_eq!((scene.state().wiring.crystal_mhz, scene.state().bus.bit_rate), (16, 1_000_000));
        let scene = Scene::boot(&firmware, &args("sim --bit-rate 1000000")).unwrap();
        assert_eq!(scene.state().bus.bit_rate, 1_000_000, "the bus can be too fast for the board");
        // A program without the section `.board` is not of this project, and has no limits.
        let firmware = Firmware { flash: program, ..Firmware::default() };
        let scene = Scene::boot(&firmware, &args("sim --mcu atmega328p")).unwrap();
        assert_eq!(
            (scene.state().memory.limits, scene.state().wiring.chip),
            (None, Chip::Atmega328p)
        );
        assert!(!scene.state().knows_vendor_code);
    }

    #[test]
    fn a_pressed_reset_button_is_reported_with_its_cause() {
        let mut scene = scene(&IDLE, "--inject reset@5ms");
        scene.advance(F_CPU_HZ / 100).unwrap();
        let is_reported = events(&mut scene).into_iter().any(|(at, event)| {
            matches!(event, Event::Reset(text) if text.contains("External"))
                && at / (F_CPU_HZ / 1000) == 5
        });
        assert!(is_reported);
    }

    #[test]
    fn the_same_options_give_the_same_run() {
        let run = || {
            let mut scene = scene(&IDLE, "--inject error-rate@10ms");
            scene.advance(F_CPU_HZ / 5).unwrap();
            events(&mut scene)
        };
        assert_eq!(run(), run());
    }

    #[test]
    fn a_script_changes_the_inputs_of_the_circuit() {
        let scratch = crate::links::scratch::Scratch::new();
        let path = scratch.path("x.script");
        std::fs::write(&path, "(0.01) pwr-voltage 2520\n(0.02) pwr-current 0\n").unwrap();
        let options = format!("--pwr-voltage 1260 --pwr-current 330 --script {}", path.display());
        let mut scene = scene(&IDLE, &options);
        let mut inputs = Vec::new();
        for ms in [5, 15, 25] {
            scene.advance(ms * F_CPU_HZ / 1000).unwrap();
            inputs.push(scene.state().circuit_inputs_mv);
        }
        assert_eq!(inputs, [[1260, 330], [2520, 330], [2520, 0]]);
    }

    #[test]
    fn a_battery_that_is_discharged_lowers_the_voltage_and_not_the_current() {
        let options = "--pwr-voltage 1000 --pwr-current 330 --pwr-discharge 0.01";
        let mut scene = scene(&IDLE, options);
        let mut inputs = Vec::new();
        for ms in [300, 600, 700] {
            scene.advance(ms * F_CPU_HZ / 1000).unwrap();
            inputs.push(scene.state().circuit_inputs_mv);
        }
        assert_eq!(inputs, [[896, 330], [714, 330], [714, 330]]);
    }

    #[test]
    fn without_autopilot_the_bus_is_silent_and_keys_do_nothing() {
        let mut scene = scene(&IDLE, "--no-autopilot --inject silence@1ms");
        scene.nudge(0.5);
        scene.toggle_sweep();
        scene.next_command_type();
        scene.advance(F_CPU_HZ / 10).unwrap();
        assert_eq!(scene.state().bus.frames, 0);
        assert_eq!(scene.state().autopilot, None);
    }

    #[test]
    fn further_boards_are_announced_and_watched() {
        let mut scene = scene(&[0x00, 0x00], "--nodes 2");
        assert!(
            matches!(&events(&mut scene)[1].1, Event::Link(text) if text.contains("node2 to node3"))
        );
        scene.advance(F_CPU_HZ / 5).unwrap();
        assert_eq!(scene.bench.boards().len(), 3);
        assert!(scene.state().crash.is_some());
    }

    /// The EEPROM holds the node ID and the unique ID, which must differ between boards.
    #[test]
    fn each_board_has_an_eeprom_file_of_its_own() {
        let scratch = crate::links::scratch::Scratch::new();
        let path = scratch.path("eeprom");
        let options = format!("--nodes 2 --eeprom {}", path.display());
        let mut first = scene(&IDLE, &options);
        for (number, board) in first.bench.boards().iter_mut().enumerate() {
            board.avr_mut().set_eeprom(&[number as u8 + 1]);
        }
        first.finish().unwrap();
        for (name, byte) in [("eeprom", 1), ("eeprom.1", 2), ("eeprom.2", 3)] {
            assert_eq!(std::fs::read(scratch.path(name)).unwrap()[0], byte, "{name}");
        }
        let mut second = scene(&IDLE, &options);
        let bytes: Vec<u8> =
            second.bench.boards().iter().map(|board| board.avr().eeprom()[0]).collect();
        assert_eq!(bytes, [1, 2, 3]);
    }

    #[test]
    fn the_light_is_reported_when_it_changes() {
        let mut state = State::new(1_000_000);
        for brightness in [0.0, 0.5, 0.5, 0.502, 0.0] {
            state.set_light(7, brightness);
        }
        let events: Vec<_> = state.take_events().into_iter().map(|(_, event)| event).collect();
        assert_eq!(events, [Event::Light(50), Event::Light(0)]);
    }

    #[test]
    fn all_actuators_and_motors_are_commanded_on_request() {
        let mut scene = scene(&IDLE, "--autopilot px4 --actuator all --motors 4 --hold 1");
        scene.advance(F_CPU_HZ / 50).unwrap();
        assert!(autopilot(&scene).moves_all && autopilot(&scene).motors == 4);
        let lines = scene.state().traffic.page(1000, None, &Hidden::new());
        let texts: Vec<&str> = lines.iter().map(|line| line.text.as_str()).collect();
        assert!(texts.contains(&"esc.RawCommand 8191, 8191, 8191, 8191"), "{texts:?}");
        assert!(texts.iter().any(
            |text| text.contains("id 0 unitless +1.00") && text.contains("id 7 unitless +1.00")
        ));
    }

    #[test]
    fn an_autopilot_like_ardupilot_can_be_disarmed() {
        let mut scene = scene(&IDLE, "--autopilot ardupilot --inject disarm@100ms");
        scene.advance(F_CPU_HZ / 2 + F_CPU_HZ / 20).unwrap();
        assert!(!autopilot(&scene).is_armed);
        let texts: Vec<String> = {
            let lines = scene.state().traffic.page(1000, None, &Hidden::new());
            lines.into_iter().map(|line| line.text.clone()).collect()
        };
        let arming: Vec<_> = texts.iter().filter(|text| text.starts_with("ArmingStatus")).collect();
        assert_eq!(arming, ["ArmingStatus armed", "ArmingStatus disarmed"]);
        assert!(texts.iter().any(|text| text.contains("id 15 unitless")), "{texts:?}");
    }
}
