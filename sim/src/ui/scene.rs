//! The scene: the bench, the autopilot on its bus, and the [`State`] of both. Advancing a scene
//! lets simulated time pass.
//!
//! A scene uses no terminal and no wall clock, so a test can run it, too.
//!
//! At least three stations share the bus: the node, the autopilot, and a babbler. The babbler
//! acknowledges all frames, as a bus analyser does, until the fault `babble` makes it send. So the
//! autopilot still gets its ACKs when the node's cable is pulled. Further boards and links can add
//! stations. The scene serves the links at least each simulated millisecond.

use super::discharge::Discharge;
use super::findings::Findings;
use super::state::{Event, State};
use crate::fault::{Fault, Injection};
use crate::links::Link;
use crate::links::script::{BenchEvent, RPM_MAX, Script};
use crate::pins::Watched;
use anyhow::Result;
use bench::autopilot::{Autopilot, Settings};
use bench::board::Board;
use bench::can::PortId;
use bench::dronecan::text::visible;
use bench::i2c;
use bench::inject::{Injector, Target};
use bench::pins::Setting;
use bench::{Bench, Cycles, F_CPU_HZ};
use std::collections::VecDeque;

mod boot;
mod collect;

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
}

#[cfg(test)]
mod tests {
    use super::super::args::Args;
    use super::super::state::AutopilotState;
    use super::super::traffic::Hidden;
    use super::*;
    use bench::avr::{Chip, Firmware};
    use bench::budget::Budget;
    use bench::dronecan::Dialect;
    use bench::wiring::Wiring;
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

    /// A scene after some milliseconds.
    fn after(ms: u64, program: &[u8], options: &str) -> Scene {
        let mut scene = scene(program, options);
        advance(&mut scene, ms);
        scene
    }

    fn advance(scene: &mut Scene, to_ms: u64) {
        scene.advance(to_ms * F_CPU_HZ / 1000).unwrap();
    }

    /// Texts of the traffic so far.
    fn texts(scene: &Scene) -> Vec<&str> {
        let lines = scene.state().traffic.page(1000, None, &Hidden::new());
        lines.into_iter().map(|line| line.text.as_str()).collect()
    }

    #[test]
    fn the_autopilot_sends_on_the_bus() {
        let scene = after(500, &IDLE, "");
        assert_eq!((scene.state().bus.frames, scene.state().bus.unacknowledged), (26, 0));
        let line = scene.state().traffic.last().unwrap();
        assert_eq!((line.who.as_str(), line.name.as_str()), ("1", "ArrayCommand"));
        assert_eq!(scene.state().status, None);
    }

    #[test]
    fn faults_happen_at_their_time_in_any_order_and_end_when_repeated() {
        let mut scene =
            after(50, &IDLE, "--inject silence@30ms --inject babble@10ms --inject babble@20ms");
        let faults = events(&mut scene).into_iter().filter_map(|(at, event)| match event {
            Event::Fault(text) => Some((at * 1000 / F_CPU_HZ, text)),
            _ => None,
        });
        let faults: Vec<_> = faults.collect();
        for ((at, text), (expected, begin)) in
            faults.iter().zip([(10, "babble on"), (20, "babble off"), (30, "silence on")])
        {
            assert!(*at == expected && text.starts_with(begin), "{faults:?}");
        }
        assert_eq!((faults.len(), &scene.state().active_faults[..]), (3, &[Fault::Silence][..]));
        assert!(scene.state().bus.load_percent(scene.now()) > 10.0);
    }

    /// Each fault alone: it begins, ends, and stops nothing else.
    #[test]
    fn every_fault_can_be_begun_and_ended() {
        for fault in crate::fault::ALL {
            let mut scene = scene(&IDLE, "");
            scene.inject(fault);
            assert_eq!(scene.state().active_faults.contains(&fault), fault.lasts(), "{fault}");
            advance(&mut scene, 5);
            scene.inject(fault);
            advance(&mut scene, 10);
            assert_eq!(scene.state().active_faults, [], "{fault}");
            assert_eq!(scene.state().mistakes.total(), 0, "{fault}");
        }
    }

    /// The list of active faults must not name one that is no longer in force.
    #[test]
    fn faults_of_the_bus_make_error_frames_while_one_of_them_is_in_force() {
        let rate = "--inject error-rate@1ms --inject error-rate@2ms";
        for (options, active, from_ms, errors) in [
            (
                &format!("--inject error-storm@0s {rate}")[..],
                &[Fault::ErrorStorm][..],
                10,
                6..u64::MAX,
            ),
            ("--inject error-storm@0s --inject error-storm@1ms", &[], 10, 0..1),
            ("--inject no-ack@0s", &[Fault::NoAck], 0, 1..u64::MAX),
            ("--inject wrong-rate@1ms", &[Fault::WrongRate], 0, 6..u64::MAX),
            ("--inject wrong-rate@1ms --inject wrong-rate@50ms", &[], 50, 0..5),
        ] {
            let mut scene = after(from_ms, &IDLE, options);
            let before = scene.state().bus.error_frames;
            advance(&mut scene, from_ms + 1000);
            assert_eq!(scene.state().active_faults, active, "{options}");
            let seen = scene.state().bus.error_frames - before;
            assert!(errors.contains(&seen), "{options}: {seen} error frames, not {errors:?}");
        }
    }

    #[test]
    fn keys_change_the_speed_of_a_shaft_that_the_program_counts() {
        let mut scene = scene(&IDLE, "");
        scene.spin(1);
        assert_eq!(scene.state().shaft_rpm, 0);
        scene.state.wiring.rpm = scene.state.wiring.light;
        let speeds = [1, 1, -1, -1, -1, 1].map(|steps| {
            scene.spin(steps);
            scene.state().shaft_rpm
        });
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
        let options = "--autopilot ardupilot --hold 0.5 --inject other-dialect@1500ms";
        let mut scene = after(1500, &IDLE, options);
        assert_eq!(autopilot(&scene).dialect, Dialect::Draft);
        scene.state_mut().take_events();
        let traffic = |scene: &mut Scene, to_ms| {
            advance(scene, to_ms);
            let line = |(_, event)| match event {
                Event::Traffic(line) => Some((line.who, line.text)),
                _ => None,
            };
            events(scene).into_iter().filter_map(line).collect::<Vec<_>>()
        };
        let lines = traffic(&mut scene, 3000);
        let is_draft = |(who, text): &(String, String)| who == "10" && text.starts_with("draft.");
        assert!(lines.iter().all(is_draft), "{lines:?}");
        assert_eq!(lines[0].1, "draft.NodeStatus OK up 0 s vendor 0x0000");
        assert_eq!(lines[1].1, "draft.ArrayCommand id 1 +0.50");
        assert_eq!(lines.iter().filter(|(_, text)| text.contains("NodeStatus")).count(), 2);
        scene.inject(Fault::OtherDialect);
        let AutopilotState { dialect, profile, .. } = autopilot(&scene);
        assert_eq!((*dialect, profile.as_str()), (Dialect::V0, "ArduPilot"));
        let lines = traffic(&mut scene, 4000);
        assert!(lines.iter().any(|(_, text)| text.starts_with("ArmingStatus")), "{lines:?}");
        assert!(!lines.iter().any(is_draft), "{lines:?}");
        assert_eq!(scene.state().bus.unacknowledged, 0);
    }

    /// When a blocked bus is free again, the autopilot must not send a burst of old commands.
    #[test]
    fn the_autopilot_drops_commands_that_it_could_not_send() {
        let mut scene = scene(&IDLE, "--inject stuck-dominant@0s --inject stuck-dominant@1s");
        (1..=120).for_each(|slice| advance(&mut scene, slice * 10));
        let frames = scene.state().bus.frames;
        assert!((10..=16).contains(&frames), "{frames} frames in 0.2 s");
    }

    #[test]
    fn a_program_that_leaves_the_flash_has_crashed() {
        let mut scene = after(100, &[0x00, 0x00], "");
        advance(&mut scene, 200);
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
        let mut scene = after(100, &code, "");
        advance(&mut scene, 200);
        assert_eq!((scene.state().mistakes.total(), scene.state().crash.clone()), (0, None));
        let hints = events(&mut scene).into_iter().filter(|(_, event)| {
            matches!(event, Event::Hint(text) if text.contains("erased flash at 0x0000"))
        });
        assert_eq!(hints.count(), 1);
    }

    #[test]
    fn the_board_is_announced_first_and_has_the_limits_of_its_chip() {
        let program = vec![(0, IDLE.to_vec())];
        let section = b"board=uno\nshield=module\nmcu=atmega328p\ncs=D10\nint=D2\ncrystal_mhz=8\n\
              servo=D9\nsensor=A0\n";
        let board = Some(section.to_vec());
        let firmware = Firmware { flash: program.clone(), board, ..Firmware::default() };
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
        assert_eq!(scene.state().wiring.chip, Chip::Atmega328p);
        assert!(scene.state().memory.limits.is_none() && !scene.state().knows_vendor_code);
    }

    #[test]
    fn a_pressed_reset_button_is_reported_with_its_cause() {
        let mut scene = after(10, &IDLE, "--inject reset@5ms");
        let is_reported = events(&mut scene).into_iter().any(|(at, event)| {
            matches!(event, Event::Reset(text) if text.contains("External"))
                && at / (F_CPU_HZ / 1000) == 5
        });
        assert!(is_reported);
    }

    #[test]
    fn the_same_options_give_the_same_run() {
        let run = || events(&mut after(200, &IDLE, "--inject error-rate@10ms"));
        assert_eq!(run(), run());
    }

    #[test]
    fn a_script_and_a_discharged_battery_change_the_inputs_of_the_circuit() {
        let scratch = crate::links::scratch::Scratch::new();
        let path = scratch.path("x.script");
        std::fs::write(&path, "(0.01) pwr-voltage 2520\n(0.02) pwr-current 0\n").unwrap();
        let script = format!("--pwr-voltage 1260 --script {}", path.display());
        for (options, times_ms, expected) in [
            (&script[..], [5, 15, 25], [[1260, 330], [2520, 330], [2520, 0]]),
            (
                "--pwr-voltage 1000 --pwr-discharge 0.01",
                [300, 600, 700],
                [[896, 330], [714, 330], [714, 330]],
            ),
        ] {
            let mut scene = scene(&IDLE, &format!("--pwr-current 330 {options}"));
            let inputs = times_ms.map(|ms| {
                advance(&mut scene, ms);
                scene.state().circuit_inputs_mv
            });
            assert_eq!(inputs, expected, "{options}");
        }
    }

    #[test]
    fn further_boards_are_announced_and_watched() {
        let mut scene = scene(&[0x00, 0x00], "--nodes 2");
        let announced = events(&mut scene).swap_remove(1).1;
        assert!(matches!(&announced, Event::Link(text) if text.contains("node2 to node3")));
        advance(&mut scene, 200);
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
        let options = "--autopilot px4 --actuator all --motors 4 --hold 1";
        let scene = after(20, &IDLE, options);
        assert!(autopilot(&scene).moves_all && autopilot(&scene).motors == 4);
        let texts = texts(&scene);
        assert!(texts.contains(&"esc.RawCommand 8191, 8191, 8191, 8191"), "{texts:?}");
        let mut commands = texts.iter().filter(|text| text.contains("id 0 unitless +1.00"));
        assert!(commands.any(|text| text.contains("id 7 unitless +1.00")), "{texts:?}");
    }

    #[test]
    fn an_autopilot_like_ardupilot_can_be_disarmed() {
        let scene = after(550, &IDLE, "--autopilot ardupilot --inject disarm@100ms");
        assert!(!autopilot(&scene).is_armed);
        let texts = texts(&scene);
        let arming: Vec<_> = texts.iter().filter(|text| text.starts_with("ArmingStatus")).collect();
        assert_eq!(arming, [&"ArmingStatus armed", &"ArmingStatus disarmed"]);
        assert!(texts.iter().any(|text| text.contains("id 15 unitless")), "{texts:?}");
    }
}
