//! The bench in plain lines, one event a line, for pipes, logs and scripts.
//!
//! ```text
//!      1.000000 bus     0.8 %, 51 frames/s: 1 ArrayCommand x50, 1 NodeStatus x1
//! ```
//! Simulated time in seconds, a word to filter by, the event. What comes often is summed up: traffic each second, servo
//! pulses each half second while they change, error frames above a few each second.

use super::pace::Measured;
use super::state::{News, State, TrafficLine};
use crate::time::{micros, seconds};
use bench::budget::Budget;
use bench::{Cycles, F_CPU_HZ};
use std::collections::BTreeMap;
use std::io::{self, Write};

const TRAFFIC_PERIOD: Cycles = F_CPU_HZ;
const SERVO_PERIOD: Cycles = F_CPU_HZ / 2;
/// Error frames printed one by one in each traffic period.
const ERROR_LINES_MAX: u32 = 5;
/// Lost frames printed one by one in each traffic period.
const LOST_LINES_MAX: u32 = 5;

/// Writes the lines.
pub struct Plain<W> {
    out: W,
    /// Each transfer gets its line.
    every_transfer: bool,
    next_traffic_at: Cycles,
    next_servo_at: Cycles,
    counts: BTreeMap<(String, String), u32>,
    error_lines: u32,
    lost_lines: u32,
    last_pulse: Option<Option<Cycles>>,
    /// Widths of the other outputs, and what the node said of its circuit, as they were printed last.
    last_outputs: Vec<Option<Cycles>>,
    last_circuit: String,
}

impl<W: Write> Plain<W> {
    /// Lines go to `out`.
    pub fn new(out: W, every_transfer: bool) -> Plain<W> {
        Plain {
            out,
            every_transfer,
            next_traffic_at: TRAFFIC_PERIOD,
            next_servo_at: 0,
            counts: BTreeMap::new(),
            error_lines: 0,
            lost_lines: 0,
            last_pulse: None,
            last_outputs: Vec::new(),
            last_circuit: String::new(),
        }
    }

    /// Prints what happened up to `state.now`.
    ///
    /// # Errors
    /// Those of the output, a broken pipe among them.
    pub fn step(&mut self, state: &mut State) -> io::Result<()> {
        for (at, news) in state.take_news() {
            self.news(at, news)?;
        }
        // The begin and the end of pulses are reported at once.
        let turned = self.last_pulse.is_none_or(|last| last.is_some() != state.servo.pulse.is_some());
        if turned || state.now >= self.next_servo_at {
            self.servo(state)?;
            self.outputs(state)?;
            self.circuit(state)?;
            self.next_servo_at = state.now + SERVO_PERIOD;
        }
        if state.now >= self.next_traffic_at {
            self.traffic(state)?;
            self.next_traffic_at += TRAFFIC_PERIOD;
        }
        self.out.flush()
    }

    fn line(&mut self, at: Cycles, topic: &str, text: &str) -> io::Result<()> {
        writeln!(self.out, "{:13.6} {topic:7} {text}", seconds(at))
    }

    fn news(&mut self, at: Cycles, news: News) -> io::Result<()> {
        match news {
            News::Serial(text) => self.line(at, "serial", &text),
            News::Status(node, text) => self.line(at, "status", &format!("node {node}: {text}")),
            News::Controller(text) => self.line(at, "mcp2515", &text),
            News::Board(text) => self.line(at, "board", &text),
            News::Reset(text) => self.line(at, "reset", &text),
            News::Fault(text) => self.line(at, "fault", &text),
            News::Link(text) => self.line(at, "link", &text),
            News::Node(text) => self.line(at, "node", &text),
            News::Light(percent) => self.line(at, "light", &format!("{percent} %")),
            News::Crash(text) => self.line(at, "CRASH", &text),
            News::Traffic(line) => self.transfer(at, line),
            News::ErrorFrame(text) => {
                self.error_lines += 1;
                match self.error_lines {
                    1..=ERROR_LINES_MAX => self.line(at, "error", &text),
                    _ => Ok(()),
                }
            }
            News::Violation(text) => self.line(at, "MISTAKE", &text),
            News::Hint(text) => self.line(at, "HINT", &text),
            News::Lost(text) => {
                self.lost_lines += 1;
                match self.lost_lines {
                    1..=LOST_LINES_MAX => self.line(at, "LOST", &text),
                    _ => Ok(()),
                }
            }
        }
    }

    fn transfer(&mut self, at: Cycles, line: TrafficLine) -> io::Result<()> {
        if self.every_transfer {
            let text = format!("{:>4} {}", line.who, line.text);
            self.line(at, "frame", &text)?;
        }
        *self.counts.entry((line.who, line.name)).or_default() += 1;
        Ok(())
    }

    fn servo(&mut self, state: &State) -> io::Result<()> {
        let pulse = state.servo.pulse;
        if self.last_pulse == Some(pulse) {
            return Ok(());
        }
        let text = match pulse {
            Some(width) => match state.servo.period {
                Some(period) => format!("pulse {:.1} us, period {:.3} ms", micros(width), micros(period) / 1e3),
                None => format!("pulse {:.1} us", micros(width)),
            },
            None => String::from("no pulse"),
        };
        self.last_pulse = Some(pulse);
        self.line(state.now, "servo", &text)
    }

    fn outputs(&mut self, state: &State) -> io::Result<()> {
        let widths = state.output_widths();
        if widths == self.last_outputs {
            return Ok(());
        }
        let width = |width: &Option<Cycles>| width.map_or(String::from("-"), |width| format!("{:.1}", micros(width)));
        let texts = widths.iter().map(width).collect::<Vec<_>>().join(" ");
        let text = match widths.len() {
            0 => String::from("no pulse but the servo's"),
            1 => format!("2: {texts} us"),
            count => format!("2 to {}: {texts} us", count + 1),
        };
        self.last_outputs = widths;
        self.line(state.now, "outputs", &text)
    }

    fn circuit(&mut self, state: &State) -> io::Result<()> {
        let text = state.circuit.map_or(String::new(), |circuit| circuit.to_string());
        if text == self.last_circuit {
            return Ok(());
        }
        self.last_circuit = text.clone();
        self.line(state.now, "power", &text)
    }

    fn traffic(&mut self, state: &State) -> io::Result<()> {
        let counts = std::mem::take(&mut self.counts);
        let each: Vec<_> = counts.iter().map(|((who, name), count)| format!("{who} {name} x{count}")).collect();
        let text = format!(
            "{:.1} %, {} frames/s: {}",
            state.bus.load_percent(state.now),
            state.bus.frames_per_second(),
            if each.is_empty() { String::from("silence") } else { each.join(", ") },
        );
        self.line(state.now, "bus", &text)?;
        let hidden = self.error_lines.saturating_sub(ERROR_LINES_MAX);
        if hidden > 0 {
            self.line(state.now, "error", &format!("{hidden} further error frames"))?;
        }
        self.error_lines = 0;
        let hidden = self.lost_lines.saturating_sub(LOST_LINES_MAX);
        if hidden > 0 {
            self.line(state.now, "LOST", &format!("{hidden} further frames"))?;
        }
        self.lost_lines = 0;
        Ok(())
    }

    /// Prints the end of a run.
    ///
    /// # Errors
    /// Those of the output.
    pub fn summary(&mut self, state: &State, speed: Measured) -> io::Result<()> {
        write!(self.out, "{}", summary(state, speed))?;
        self.out.flush()
    }
}

/// The figures of a run.
pub fn summary(state: &State, speed: Measured) -> String {
    let memory = &state.memory;
    let mut text = String::from("---\n");
    let mut line = |name: &str, value: String| text += &format!("{name:16}{value}\n");
    line("simulated", format!("{:.3} s", seconds(state.now)));
    line("speed", format!("{:.2} of real time ({:.2} at most)", speed.factor, speed.capacity));
    line(
        "bus",
        format!(
            "{} frames, {} error frames, {} not acknowledged",
            state.bus.frames, state.bus.error_frames, state.bus.unacknowledged
        ),
    );
    line("node", format!("{} frames lost, {} driver mistakes", state.controller.overflows, state.mistakes.total()));
    let per_frame = |count| state.per_node_frame(count);
    if let (Some(bytes), Some(selects)) = (per_frame(state.spi.bytes), per_frame(state.spi.selects)) {
        let (received, sent) = (state.frames_for_node, state.frames_of_node);
        line(
            "SPI",
            format!(
                "{bytes:.1} bytes in {selects:.1} chip selects a frame, for {received} frames received and {sent} sent"
            ),
        );
    }
    if let Some(worst) = state.latency.worst {
        line("served within", format!("{:.1} us of the end of a frame", micros(worst)));
    }
    line(
        "servo",
        match &state.autopilot {
            Some(autopilot) => format!("{} pulses for {} commands", state.servo.count, autopilot.commands_sent),
            None => format!("{} pulses", state.servo.count),
        },
    );
    let of = |limit: fn(Budget) -> u32| memory.limits.map_or(String::new(), |limits| format!(" of {}", limit(limits)));
    line("flash", format!("{}{} B", memory.flash, of(|limits| limits.flash)));
    if let Some(statics) = memory.statics {
        line("statics", format!("{statics}{} B", of(|limits| limits.statics)));
    }
    if let (Some(statics), Some(stack)) = (memory.statics, memory.stack) {
        line(
            "stack",
            format!("{stack} B, with statics {}{} B", statics + stack, of(|limits| limits.statics_and_stack)),
        );
    }
    for mistake in state.mistakes.kinds() {
        line(
            "mistake",
            format!("{} times, first at {:.6} s: {}", mistake.count, seconds(mistake.first_at), mistake.text),
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
    use super::super::state::Memory;
    use super::super::state::Origin;
    use super::*;
    use bench::avr::Chip;
    use bench::can::Frame;
    use bench::dronecan::{CircuitStatus, NodeId, NodeStatus};
    use half::f16;

    /// Runs `state` through a plain view and gives the lines.
    fn printed(state: &mut State, every_transfer: bool) -> String {
        let mut out = Vec::new();
        Plain::new(&mut out, every_transfer).step(state).unwrap();
        String::from_utf8(out).unwrap()
    }

    fn command(at: Cycles) -> News {
        News::Traffic(TrafficLine {
            at,
            origin: Origin::Other,
            who: String::from("1"),
            name: String::from("ArrayCommand"),
            text: String::from("ArrayCommand id 1 unitless +0.50"),
        })
    }

    #[test]
    fn each_event_is_a_line_with_its_time() {
        let mut state = State::new(1_000_000);
        state.tell(F_CPU_HZ / 2, News::Serial(String::from("node 42 ready")));
        let node = NodeId::new(42).unwrap();
        state.tell(F_CPU_HZ, News::Status(node, NodeStatus::default().to_string()));
        state.violation(F_CPU_HZ, String::from("SPI with CS high"));
        let text = printed(&mut state, false);
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(lines[0], "     0.500000 serial  node 42 ready");
        assert_eq!(lines[1], "     1.000000 status  node 42: OK OPERATIONAL up 0 s vendor 0x0000");
        assert_eq!(lines[2], "     1.000000 MISTAKE SPI with CS high");
        assert_eq!(lines[3], "     0.000000 servo   no pulse");
    }

    #[test]
    fn traffic_is_summed_up_each_second() {
        let mut state = State::new(1_000_000);
        for at in 0..50 {
            state.tell(at, command(at));
        }
        state.pass(F_CPU_HZ);
        let text = printed(&mut state, false);
        assert!(text.contains("     1.000000 bus     0.0 %, 0 frames/s: 1 ArrayCommand x50\n"), "{text}");
        assert!(!text.contains("+0.50"));
    }

    #[test]
    fn every_transfer_is_printed_when_asked() {
        let mut state = State::new(1_000_000);
        state.tell(0, command(0));
        let text = printed(&mut state, true);
        assert!(text.contains("frame      1 ArrayCommand id 1 unitless +0.50\n"), "{text}");
    }

    #[test]
    fn a_changing_pulse_is_printed_each_half_second() {
        let mut state = State::new(1_000_000);
        let mut out = Vec::new();
        let mut plain = Plain::new(&mut out, false);
        for number in 1..100 {
            let start = number * F_CPU_HZ / 50;
            state.pulse(start, 24_000 + number, Some(F_CPU_HZ / 50));
            state.pass(start);
            plain.step(&mut state).unwrap();
        }
        let text = String::from_utf8(out).unwrap();
        let pulses = text.lines().filter(|l| l.contains("servo   pulse")).count();
        assert_eq!(pulses, 4, "{text}");
        assert!(text.contains("period 20.000 ms"), "{text}");
    }

    #[test]
    fn the_other_outputs_and_the_circuit_are_printed_each_half_second_if_they_have_changed() {
        let mut state = State::new(1_000_000);
        let mut out = Vec::new();
        let mut plain = Plain::new(&mut out, false);
        for number in 1..=150 {
            let now = number * F_CPU_HZ / 50;
            if number <= 100 {
                state.pulse(now, 24_000, None);
                let width = if number < 60 { 16_000 } else { 24_008 };
                state.output_pulses([Some((now, width)), None, Some((now, 24_000)), None]);
            }
            state.circuit = (number > 30).then(|| CircuitStatus {
                circuit: 120,
                voltage: f16::from_f32(12.6),
                current: f16::from_f32(3.2),
                errors: 0,
            });
            state.pass(now);
            plain.step(&mut state).unwrap();
        }
        let text = String::from_utf8(out).unwrap();
        let lines: Vec<&str> =
            text.lines().filter(|line| line.contains("outputs") || line.contains("power")).map(str::trim).collect();
        let expected = [
            "0.020000 outputs 2 to 4: 1000.0 - 1500.0 us",
            "1.020000 power   circuit 120 12.60 V 3.20 A",
            "1.520000 outputs 2 to 4: 1500.5 - 1500.0 us",
            "2.120000 outputs no pulse but the servo's",
        ];
        assert_eq!(lines, expected);
    }

    #[test]
    fn a_steady_pulse_is_printed_once() {
        let mut state = State::new(1_000_000);
        let mut out = Vec::new();
        let mut plain = Plain::new(&mut out, false);
        for number in 1..200 {
            let start = number * F_CPU_HZ / 50;
            state.pulse(start, 24_000, None);
            state.pass(start);
            plain.step(&mut state).unwrap();
        }
        let text = String::from_utf8(out).unwrap();
        assert_eq!(text.lines().filter(|l| l.contains("servo")).count(), 1, "{text}");
    }

    #[test]
    fn the_first_pulse_and_the_end_of_pulses_are_printed_at_once() {
        let mut state = State::new(1_000_000);
        let mut out = Vec::new();
        let mut plain = Plain::new(&mut out, false);
        let ms = F_CPU_HZ / 1000;
        for now in (1..=300).map(|number| number * ms) {
            if now == 100 * ms {
                state.pulse(now, 24_000, None);
            }
            state.pass(now);
            plain.step(&mut state).unwrap();
        }
        let text = String::from_utf8(out).unwrap();
        assert!(text.contains("0.001000 servo   no pulse"), "{text}");
        assert!(text.contains("0.100000 servo   pulse 1500.0 us"), "{text}");
        assert!(text.contains("0.201000 servo   no pulse"), "{text}");
    }

    #[test]
    fn floods_of_errors_and_mistakes_are_cut() {
        let mut state = State::new(1_000_000);
        for _ in 0..1000 {
            state.tell(0, News::ErrorFrame(String::from("error frame")));
            state.violation(0, String::from("SPI with CS high"));
            state.lost(0, Frame::standard(0x123, &[1]));
        }
        state.pass(F_CPU_HZ);
        let text = printed(&mut state, false);
        assert!(text.contains("995 further error frames"), "{text}");
        assert!(text.contains("LOST    frame lost, both receive buffers were full: 123#01"), "{text}");
        assert!(text.contains("LOST    995 further frames"), "{text}");
        assert_eq!(text.matches("MISTAKE").count(), 1);
        assert!(text.lines().count() < 20);
        let text = summary(&state, Measured::default());
        assert!(text.contains("mistake         1000 times, first at 0.000000 s: SPI with CS high"), "{text}");
    }

    #[test]
    fn the_summary_has_every_figure() {
        let mut state = State::new(1_000_000);
        state.pulse(16, 24_000, None);
        state.memory.flash = 9_876;
        state.memory.statics = Some(312);
        state.memory.stack = Some(200);
        let limits = Budget::of(Chip::Atmega328p);
        state.memory.limits = Some(limits);
        state.served(1600);
        state.violation(0, String::from("x"));
        state.crashed(0, String::from("jumped into nothing"));
        state.links.push(String::from("slcan /tmp/can: open"));
        state.pass(5 * F_CPU_HZ);
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
    fn a_program_without_limits_has_none_in_the_summary() {
        let mut state = State::new(1_000_000);
        state.memory.flash = 9_876;
        state.memory.statics = Some(312);
        let text = summary(&state, Measured::default());
        assert!(text.contains("flash           9876 B\nstatics         312 B\n") && !text.contains("stack"), "{text}");
    }

    #[test]
    fn the_statics_of_an_unknown_program_are_not_in_the_summary() {
        let mut state = State::new(1_000_000);
        state.memory = Memory { flash: 9_876, limits: Some(Budget::of(Chip::Atmega328p)), ..Memory::default() };
        let text = summary(&state, Measured::default());
        assert!(text.contains("flash           9876 of ") && !text.contains("statics"), "{text}");
    }
}
