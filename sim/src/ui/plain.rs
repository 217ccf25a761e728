//! The plain view: one line for each event, for pipes, logs and scripts.
//!
//! ```text
//!      1.000000 bus     0.8 %, 51 frames/s: 1 ArrayCommand x50, 1 NodeStatus x1
//! ```
//! A line has the simulated time in seconds, a word to filter by, and the event. Frequent events
//! are summed up: traffic each second, servo pulses each half second while they change, error
//! frames after the first three, lost frames above five a second.

use super::escs::Throttle;
use super::pace::Measured;
use super::state::{Event, State};
use super::traffic::{ERROR_FRAME, TrafficLine};
use crate::time::{micros, seconds};
use bench::budget::Budget;
use bench::dronecan::text::visible;
use bench::i2c;
use bench::{Cycles, F_CPU_HZ};
use std::collections::BTreeMap;
use std::io::{self, Write};

const TRAFFIC_PERIOD: Cycles = F_CPU_HZ;
const SERVO_PERIOD: Cycles = F_CPU_HZ / 2;
/// Error frames printed one by one; then each traffic period has their number, until one has none.
const ERROR_LINES_MAX: u32 = 3;
/// Transactions on the two-wire bus printed one by one in each traffic period.
const I2C_LINES_MAX: u32 = 20;
/// Lost frames printed one by one in each traffic period.
const LOST_LINES_MAX: u32 = 5;

/// Writer of the lines.
pub struct Plain<W> {
    out: W,
    /// True: print each transfer, too. False: only count them each second.
    every_transfer: bool,
    next_traffic_at: Cycles,
    next_servo_at: Cycles,
    counts: BTreeMap<(String, String), u32>,
    /// Error frames of this period, and those printed one by one since a period without any.
    error_frames: u32,
    error_lines: u32,
    lost_lines: u32,
    i2c_lines: u32,
    /// Pulse width, widths of the further outputs, and measurements, as they were printed last.
    last_pulse: Option<Option<Cycles>>,
    last_outputs: Vec<Option<Cycles>>,
    last_measured: [String; 3],
}

impl<W: Write> Plain<W> {
    /// A view that writes to `out`, and prints every transfer if `every_transfer` is true.
    pub fn new(out: W, every_transfer: bool) -> Plain<W> {
        Plain {
            out,
            every_transfer,
            next_traffic_at: TRAFFIC_PERIOD,
            next_servo_at: 0,
            counts: BTreeMap::new(),
            error_frames: 0,
            error_lines: 0,
            lost_lines: 0,
            i2c_lines: 0,
            last_pulse: None,
            last_outputs: Vec::new(),
            last_measured: Default::default(),
        }
    }

    /// Prints the events up to `state.now`.
    ///
    /// # Errors
    /// If `out` fails, for example with a broken pipe.
    pub fn step(&mut self, state: &mut State) -> io::Result<()> {
        for (at, event) in state.take_events() {
            self.print_event(at, event)?;
        }
        // The first pulse and the end of pulses are printed at once.
        let has_begun_or_ended =
            self.last_pulse.is_none_or(|last| last.is_some() != state.servo.pulse.is_some());
        if has_begun_or_ended || state.now >= self.next_servo_at {
            self.print_servo(state)?;
            self.print_outputs(state)?;
            self.print_measured(state)?;
            self.next_servo_at = state.now + SERVO_PERIOD;
        }
        if state.now >= self.next_traffic_at {
            self.print_traffic(state)?;
            self.next_traffic_at += TRAFFIC_PERIOD;
        }
        self.out.flush()
    }

    fn line(&mut self, at: Cycles, topic: &str, text: &str) -> io::Result<()> {
        writeln!(self.out, "{:13.6} {topic:7} {}", seconds(at), visible(text))
    }

    fn print_event(&mut self, at: Cycles, event: Event) -> io::Result<()> {
        match event {
            Event::Serial(text) => self.line(at, "serial", &text),
            Event::Status(node, text) => self.line(at, "status", &format!("node {node}: {text}")),
            Event::Controller(text) => self.line(at, "mcp2515", &text),
            Event::Board(text) => self.line(at, "board", &text),
            Event::Reset(text) => self.line(at, "reset", &text),
            Event::Fault(text) => self.line(at, "fault", &text),
            Event::Link(text) => self.line(at, "link", &text),
            Event::Node(text) => self.line(at, "node", &text),
            Event::Light(percent) => self.line(at, "light", &format!("{percent} %")),
            Event::Pin(text) => self.line(at, "pin", &text),
            Event::I2c(text) => {
                self.i2c_lines += 1;
                match self.i2c_lines {
                    1..=I2C_LINES_MAX => self.line(at, "i2c", &text),
                    _ => Ok(()),
                }
            }
            Event::Crash(text) => self.line(at, "CRASH", &text),
            Event::Traffic(line) => self.print_transfer(at, line),
            Event::ErrorFrame(text) => {
                self.error_frames += 1;
                if self.error_lines == ERROR_LINES_MAX {
                    return Ok(());
                }
                self.error_lines += 1;
                self.line(at, "error", &text)
            }
            Event::Mistake(text) => self.line(at, "MISTAKE", &text),
            Event::Hint(text) => self.line(at, "HINT", &text),
            Event::Lost(text) => {
                self.lost_lines += 1;
                match self.lost_lines {
                    1..=LOST_LINES_MAX => self.line(at, "LOST", &text),
                    _ => Ok(()),
                }
            }
        }
    }

    fn print_transfer(&mut self, at: Cycles, line: TrafficLine) -> io::Result<()> {
        // An error frame has a line of its own.
        if self.every_transfer && line.name != ERROR_FRAME {
            self.line(at, "frame", &line.to_string())?;
        }
        *self.counts.entry((line.who, line.name)).or_default() += 1;
        Ok(())
    }

    fn print_servo(&mut self, state: &State) -> io::Result<()> {
        let pulse = state.servo.pulse;
        if self.last_pulse == Some(pulse) {
            return Ok(());
        }
        self.last_pulse = Some(pulse);
        let mut words = state.servo.words();
        if let Some(Throttle { percent, is_oneshot125 }) = state.throttle() {
            let kind = if is_oneshot125 { " of OneShot125" } else { "" };
            words.insert(0, format!("throttle {percent:.1} %{kind}"));
        }
        let text = if words.is_empty() { String::from("no pulse") } else { words.join(", ") };
        self.line(state.now, state.moved(), &text)
    }

    fn print_outputs(&mut self, state: &State) -> io::Result<()> {
        let widths = state.output_widths();
        if widths == self.last_outputs {
            return Ok(());
        }
        let throttle_of = |(output, width): (usize, &Option<Cycles>)| {
            width.and_then(|width| state.throttle_of(output, width))
        };
        let has_motors = (2..).zip(&widths).any(|output| throttle_of(output).is_some());
        let cell = |(output, width): (usize, &Option<Cycles>)| {
            let Some(cycles) = *width else { return String::from("-") };
            match throttle_of((output, width)) {
                Some(throttle) => format!("{:.1} %", throttle.percent),
                None if has_motors => format!("{:.1} us", micros(cycles)),
                None => format!("{:.1}", micros(cycles)),
            }
        };
        let texts = (2..).zip(&widths).map(cell).collect::<Vec<_>>();
        let (texts, unit) =
            if has_motors { (texts.join(", "), "") } else { (texts.join(" "), " us") };
        let text = match widths.len() {
            0 => String::from("no pulse but that of output 1"),
            1 => format!("2: {texts}{unit}"),
            count => format!("2 to {}: {texts}{unit}", count + 1),
        };
        self.last_outputs = widths;
        self.line(state.now, "outputs", &text)
    }

    fn print_measured(&mut self, state: &State) -> io::Result<()> {
        for (index, (topic, text)) in state.measured.printed().into_iter().enumerate() {
            if text != self.last_measured[index] {
                self.line(state.now, topic, &text)?;
                self.last_measured[index] = text;
            }
        }
        Ok(())
    }

    fn print_traffic(&mut self, state: &State) -> io::Result<()> {
        let counts = std::mem::take(&mut self.counts);
        let each: Vec<_> =
            counts.iter().map(|((who, name), count)| format!("{who} {name} x{count}")).collect();
        let text = format!(
            "{:.1} %, {} frames/s: {}",
            state.bus.load_percent(state.now),
            state.bus.frames_per_second(),
            if each.is_empty() { String::from("silence") } else { each.join(", ") },
        );
        self.line(state.now, "bus", &text)?;
        match std::mem::take(&mut self.error_frames) {
            0 => self.error_lines = 0,
            ..=ERROR_LINES_MAX if self.error_lines < ERROR_LINES_MAX => {}
            count => self.line(state.now, "error", &format!("{count} error frames"))?,
        }
        let hidden = self.i2c_lines.saturating_sub(I2C_LINES_MAX);
        if hidden > 0 {
            self.line(state.now, "i2c", &format!("{hidden} further transactions"))?;
        }
        self.i2c_lines = 0;
        let hidden = self.lost_lines.saturating_sub(LOST_LINES_MAX);
        if hidden > 0 {
            self.line(state.now, "LOST", &format!("{hidden} further frames"))?;
        }
        self.lost_lines = 0;
        Ok(())
    }

    /// Prints the summary of a run.
    ///
    /// # Errors
    /// If `out` fails.
    pub fn print_summary(&mut self, state: &State, speed: Measured) -> io::Result<()> {
        write!(self.out, "{}", summary(state, speed))?;
        self.out.flush()
    }
}

/// The summary of a run: its figures, mistakes, hints and links, a line each.
pub fn summary(state: &State, speed: Measured) -> String {
    let memory = &state.memory;
    let mut text = String::from("---\n");
    let mut line = |name: &str, value: String| text += &format!("{name:16}{}\n", visible(&value));
    line("simulated", format!("{:.3} s", seconds(state.now)));
    line("speed", format!("{:.2} of real time ({:.2} at most)", speed.factor, speed.capacity));
    line(
        "bus",
        format!(
            "{} frames, {} error frames, {} not acknowledged",
            state.bus.frames, state.bus.error_frames, state.bus.unacknowledged
        ),
    );
    line(
        "node",
        format!(
            "{} frames lost, {} driver mistakes",
            state.controller.overflows,
            state.mistakes.total()
        ),
    );
    let per_frame = |count| state.per_node_frame(count);
    if let (Some(bytes), Some(selects)) = (per_frame(state.spi.bytes), per_frame(state.spi.selects))
    {
        let (received, sent) = (state.frames_for_node, state.frames_of_node);
        line(
            "SPI",
            format!(
                "{bytes:.1} bytes in {selects:.1} chip selects a frame, for {received} frames \
                 received and {sent} sent"
            ),
        );
    }
    if let Some(worst) = state.latency.worst {
        line("served within", format!("{:.1} us of the end of a frame", micros(worst)));
    }
    line(
        state.moved(),
        match &state.autopilot {
            Some(autopilot) => {
                format!("{} pulses for {} commands", state.servo.count, autopilot.commands_sent)
            }
            None => format!("{} pulses", state.servo.count),
        },
    );
    let of = |limit: fn(Budget) -> u32| {
        memory.limit(limit).map_or(String::new(), |limit| format!(" of {limit}"))
    };
    line("flash", format!("{}{} B", memory.flash, of(|limits| limits.flash)));
    if let Some(statics) = memory.statics {
        line("statics", format!("{statics}{} B", of(|limits| limits.statics)));
    }
    if let (Some(stack), Some(sp)) = (memory.stack, state.lowest_sp()) {
        let ram = state.wiring.chip.ram_bytes() as u32;
        let limit = memory.limit(|limits| limits.statics_and_stack).unwrap_or(ram);
        let with_statics = memory.statics.map_or(String::new(), |statics| {
            format!(", with statics {} of {limit} B", statics + stack)
        });
        line("stack", format!("{stack} B, SP {sp:#06x} at its lowest{with_statics}"));
    }
    for (address, register, values) in &state.i2c {
        line("i2c", i2c::text(*address, *register, values));
    }
    for mistake in state.mistakes.kinds() {
        line(
            "mistake",
            format!(
                "{} times, first at {:.6} s: {}",
                mistake.count,
                seconds(mistake.first_at),
                mistake.text
            ),
        );
    }
    for hint in &state.hints {
        line("hint", hint.clone());
    }
    for link in &state.links {
        line("link", link.clone());
    }
    if let Some(crash) = &state.crash {
        line("CRASHED", crash.clone());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::escs::Escs;
    use super::super::state::Memory;
    use super::super::state::battery_info;
    use super::*;
    use bench::avr::Chip;
    use bench::can::Frame;
    use bench::dronecan::{CircuitStatus, NodeId, NodeStatus, Rpm};
    use half::f16;

    /// The lines that a plain view prints of `state`.
    fn printed(state: &mut State, every_transfer: bool) -> String {
        let mut out = Vec::new();
        Plain::new(&mut out, every_transfer).step(state).unwrap();
        String::from_utf8(out).unwrap()
    }

    fn command(at: Cycles) -> Event {
        let text = "ArrayCommand id 1 unitless +0.50";
        Event::Traffic(TrafficLine::sample(at, "ArrayCommand", text))
    }

    #[test]
    fn each_event_is_a_line_with_its_time() {
        let mut state = State::new(1_000_000);
        state.report(F_CPU_HZ / 2, Event::Serial(String::from("node 42 ready")));
        let node = NodeId::new(42).unwrap();
        state.report(F_CPU_HZ, Event::Status(node, NodeStatus::default().to_string()));
        state.add_mistake(F_CPU_HZ, String::from("SPI with CS high"));
        let text = printed(&mut state, false);
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(lines[0], "     0.500000 serial  node 42 ready");
        assert_eq!(lines[1], "     1.000000 status  node 42: OK OPERATIONAL up 0 s vendor 0x0000");
        assert_eq!(lines[2], "     1.000000 MISTAKE SPI with CS high");
        assert_eq!(lines[3], "     0.000000 servo   no pulse");
    }

    #[test]
    fn lines_and_summary_show_control_characters() {
        let mut state = State::new(1_000_000);
        state.report(0, Event::Link(String::from("script a\u{1b}[2Jb")));
        state.links.push(String::from("log to \u{9b}2J"));
        assert!(printed(&mut state, false).contains("link    script a\\x1b[2Jb\n"));
        let text = summary(&state, Measured::default());
        assert!(text.contains("link            log to \\x9b2J\n"), "{text}");
    }

    #[test]
    fn traffic_is_summed_up_each_second() {
        let mut state = State::new(1_000_000);
        for at in 0..50 {
            state.report(at, command(at));
        }
        state.advance_to(F_CPU_HZ);
        let text = printed(&mut state, false);
        assert!(
            text.contains("     1.000000 bus     0.0 %, 0 frames/s: 1 ArrayCommand x50\n"),
            "{text}"
        );
        assert!(!text.contains("+0.50"));
    }

    const MS: Cycles = F_CPU_HZ / 1000;

    /// The lines with one of `topics` that a plain view prints while `change` changes the state at
    /// each of `times`.
    fn lines(
        topics: &[&str],
        times: impl IntoIterator<Item = Cycles>,
        mut change: impl FnMut(&mut State, Cycles),
    ) -> Vec<String> {
        let mut state = State::new(1_000_000);
        let mut out = Vec::new();
        let mut plain = Plain::new(&mut out, false);
        for now in times {
            change(&mut state, now);
            state.advance_to(now);
            plain.step(&mut state).unwrap();
        }
        let text = String::from_utf8(out).unwrap();
        let lines = text.lines().map(|line| line.trim().to_owned());
        lines.filter(|line| topics.iter().any(|topic| line.contains(topic))).collect()
    }

    #[test]
    fn a_changing_pulse_is_printed_each_half_second_and_a_steady_one_once() {
        let starts = || (1..100).map(|number| number * 20 * MS);
        let changing = lines(&["servo   pulse"], starts(), |state, now| {
            state.add_pulse(now, 24_000 + now / (20 * MS), Some(20 * MS));
        });
        assert_eq!(changing.len(), 4, "{changing:?}");
        assert!(changing[0].ends_with("period 20.000 ms"), "{changing:?}");
        let steady = lines(&["servo"], starts(), |state, now| state.add_pulse(now, 24_000, None));
        assert_eq!(steady.len(), 1, "{steady:?}");
    }

    #[test]
    fn the_first_pulse_and_the_end_of_pulses_are_printed_at_once() {
        let printed = lines(&["servo"], (1..=300).map(|number| number * MS), |state, now| {
            if now == 100 * MS {
                state.add_pulse(now, 24_000, None);
            }
        });
        let expected = [
            "0.001000 servo   no pulse",
            "0.100000 servo   pulse 1500.0 us",
            "0.201000 servo   no pulse",
        ];
        assert_eq!(printed, expected);
    }

    #[test]
    fn motors_are_printed_with_their_throttle() {
        let (fast, slow) = (F_CPU_HZ / 400, 20 * MS);
        /// Pulses of output 1 and output 2 in us, period, outputs of --escs; lines.
        type Case = ([u64; 2], u64, &'static [u8], &'static str, &'static str);
        let of_oneshot = "motor   throttle 40.0 % of OneShot125, pulse 175.0 us, period 20.000 ms";
        let servo = "servo   pulse 1500.0 us, period 20.000 ms";
        let motor = "motor   throttle 25.0 %, pulse 1250.0 us, period 2.500 ms";
        let cases: [Case; 4] = [
            ([1250, 2000], fast, &[], motor, "outputs 2 to 3: 100.0 %, 100.0 %"),
            ([175, 125], slow, &[], of_oneshot, "outputs 2 to 3: 0.0 %, 0.0 %"),
            ([1500, 1100], slow, &[2], servo, "outputs 2 to 3: 10.0 %, 1100.0 us"),
            ([1500, 1100], slow, &[], servo, "outputs 2 to 3: 1100.0 1100.0 us"),
        ];
        for ([first, second], period, escs, first_line, others) in cases {
            let mut state = State::new(1_000_000);
            state.escs = Escs::new(escs);
            state.add_pulse(0, first * 16, Some(period));
            state.set_output_pulses([Some((0, second * 16)); 2]);
            let text = printed(&mut state, false);
            let seen: Vec<&str> = text.lines().map(|line| line[14..].trim()).collect();
            assert!(seen.contains(&first_line) && seen.contains(&others), "{others}: {text}");
        }
    }

    #[test]
    fn further_outputs_and_the_circuit_are_printed_each_half_second_while_they_change() {
        let times = (1..=150).map(|number| number * 20 * MS);
        let printed = lines(&["outputs", "power"], times, |state, now| {
            if now <= 2000 * MS {
                state.add_pulse(now, 24_000, None);
                let width = if now < 1200 * MS { 16_000 } else { 24_008 };
                state.set_output_pulses([Some((now, width)), None, Some((now, 24_000)), None]);
            }
            state.measured.circuit = (now > 600 * MS).then(|| CircuitStatus {
                circuit: 120,
                voltage: f16::from_f32(12.6),
                current: f16::from_f32(3.2),
                errors: 0,
            });
        });
        let expected = [
            "0.020000 outputs 2 to 4: 1000.0 - 1500.0 us",
            "1.020000 power   circuit 120 12.60 V 3.20 A",
            "1.520000 outputs 2 to 4: 1500.5 - 1500.0 us",
            "2.120000 outputs no pulse but that of output 1",
        ];
        assert_eq!(printed, expected);
    }

    #[test]
    fn the_battery_and_the_revolutions_are_printed_when_they_change() {
        let (charges, speeds) =
            ([80, 80, 79, 79], [(0, 6000.0), (0, 6000.0), (0, 61.75), (1, 0.0)]);
        let times = (1..=4).map(|second| second * F_CPU_HZ);
        let printed = lines(&["battery", "rpm"], times, |state, now| {
            let index = (now / F_CPU_HZ - 1) as usize;
            let (flags, rpm) = speeds[index];
            state.measured.battery = Some(battery_info(40.0, charges[index]));
            state.measured.rpm = Some(Rpm { sensor: 3, flags, rpm });
        });
        let expected = [
            "1.000000 power   battery 3 12.60 V 3.20 A 80 % 40.0 Wh",
            "1.000000 shaft   3 6000 rpm",
            "3.000000 power   battery 3 12.60 V 3.20 A 79 % 40.0 Wh",
            "3.000000 shaft   3 61.8 rpm",
            "4.000000 shaft   3 0 rpm UNHEALTHY",
        ];
        assert_eq!(printed, expected);
    }

    #[test]
    fn many_error_frames_lost_frames_and_mistakes_are_summed_up() {
        let mut state = State::new(1_000_000);
        for _ in 0..1000 {
            state.report(0, Event::ErrorFrame(String::from("error frame")));
            state.add_mistake(0, String::from("SPI with CS high"));
            state.add_lost_frame(0, Frame::standard(0x123, &[1]), "both receive buffers were full");
        }
        state.advance_to(F_CPU_HZ);
        let text = printed(&mut state, false);
        assert_eq!(text.matches("error   error frame").count(), 3, "{text}");
        assert!(text.contains("error   1000 error frames"), "{text}");
        assert!(
            text.contains("LOST    frame lost, both receive buffers were full: 123#01"),
            "{text}"
        );
        assert!(text.contains("LOST    995 further frames"), "{text}");
        assert_eq!(text.matches("MISTAKE").count(), 1);
        assert!(text.lines().count() < 20);
        let text = summary(&state, Measured::default());
        assert!(
            text.contains("mistake         1000 times, first at 0.000000 s: SPI with CS high"),
            "{text}"
        );
    }

    #[test]
    fn the_summary_has_every_figure() {
        let mut state = State::new(1_000_000);
        state.add_pulse(16, 24_000, None);
        state.memory.flash = 9_876;
        state.memory.statics = Some(312);
        state.memory.stack = Some(200);
        let limits = Budget::of(Chip::Atmega328p);
        state.memory.limits = Some(limits);
        state.add_latency(1600);
        state.add_mistake(0, String::from("x"));
        state.set_crash(0, String::from("jumped into nothing"));
        state.links.push(String::from("slcan /tmp/can: open"));
        state.advance_to(5 * F_CPU_HZ);
        let text = summary(&state, Measured { factor: 1.0, capacity: 7.5 });
        for expected in [
            "5.000 s",
            "7.50",
            "0 frames, 0 error frames",
            "1 driver mistakes",
            "100.0 us",
            "1 pulses",
            &format!("9876 of {}", limits.flash),
            &format!("312 of {}", limits.statics),
            &format!("512 of {}", limits.statics_and_stack),
            "jumped into nothing",
            "link            slcan /tmp/can: open",
        ] {
            assert!(text.contains(expected), "{expected} is missing in\n{text}");
        }
    }

    #[test]
    fn the_summary_leaves_out_limits_statics_and_a_stack_that_are_not_known() {
        let mut state = State::new(1_000_000);
        state.memory = Memory { flash: 9_876, statics: Some(312), ..Memory::default() };
        let text = summary(&state, Measured::default());
        let expected = "flash           9876 B\nstatics         312 B\n";
        assert!(text.contains(expected) && !text.contains("stack"), "{text}");
        state.memory.statics = None;
        state.memory.limits = Some(Budget::of(Chip::Atmega328p));
        let text = summary(&state, Measured::default());
        assert!(text.contains("flash           9876 of ") && !text.contains("statics"), "{text}");
    }
}
