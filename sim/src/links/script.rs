//! Plays a [script](bench::script) from a file.
//!
//! The script has its own station on the bus. It sends each frame at its time, or later if the bus
//! is busy. A log has the frames of all nodes: remove those of a node that takes part again (`grep
//! -v`), or two stations send the same identifier.

use super::Link;
use anyhow::{Context, Result, anyhow};
use bench::can::SoftNode;
use bench::{Bench, Cycles, F_CPU_HZ};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::rc::Rc;

pub use bench::script::{Action, BenchEvent, RPM_MAX, millivolts, parse, rpm};

/// Most bytes of a recording: hours of a full bus.
const LONGEST: u64 = 1 << 30;

/// A script, with the events that are not due yet and the station that sends its frames.
pub struct Script {
    path: PathBuf,
    station: Option<Rc<RefCell<SoftNode>>>,
    /// Times of all frames, in order.
    frame_times: Vec<Cycles>,
    events: VecDeque<(Cycles, BenchEvent)>,
    events_total: usize,
    /// Error frames of a log.
    error_frames: usize,
    /// Empty lines and comments.
    blank_lines: usize,
    hint: Option<String>,
}

impl Script {
    /// Reads the file, and adds a station to the bus if there are frames to send.
    ///
    /// # Errors
    /// If the file cannot be read, or has an invalid line; the message names the line.
    pub fn open(path: &Path, bench: &mut Bench) -> Result<Script> {
        let bytes = sim_base::read_file(path, LONGEST)
            .with_context(|| format!("--script: cannot read {}", path.display()))?;
        let text = bench::script::text(bytes)
            .map_err(|error| anyhow!("--script: {}: {error}", path.display()))?;
        let lines = parse(&text)
            .map_err(|(line, error)| anyhow!("--script: {}:{line}: {error}", path.display()))?;
        let mut script = Script {
            path: path.to_owned(),
            station: None,
            frame_times: Vec::new(),
            events: VecDeque::new(),
            events_total: 0,
            error_frames: 0,
            blank_lines: text.lines().count() - lines.len(),
            hint: None,
        };
        for (at, action) in lines {
            match action {
                Action::Send(frame) => {
                    script.frame_times.push(at);
                    let station = script.station.get_or_insert_with(|| {
                        let station = Rc::new(RefCell::new(SoftNode::new(bench.bus().bit_rate())));
                        bench.attach("script", station.clone());
                        station
                    });
                    station.borrow_mut().send_at(at, frame);
                }
                Action::Do(event) => script.events.push_back((at, event)),
                Action::Skip => script.error_frames += 1,
            }
        }
        script.events_total = script.events.len();
        Ok(script)
    }

    /// Time of the next event, at which the bench must stop; `None` after the last.
    pub fn next_event_at(&self) -> Option<Cycles> {
        self.events.front().map(|(at, _)| *at)
    }

    /// Removes and returns the events that are due at `until` or before, in order.
    pub fn take_events(&mut self, until: Cycles) -> Vec<(Cycles, BenchEvent)> {
        let due = self.events.partition_point(|(at, _)| *at <= until);
        self.events.drain(..due).collect()
    }

    /// Number of frames that are not sent yet.
    pub fn frames_left(&self) -> usize {
        self.station.as_ref().map_or(0, |station| station.borrow().queued())
    }

    fn frames_sent(&self) -> usize {
        self.frame_times.len() - self.frames_left()
    }

    /// Why a run that ended at `now` played nothing of the file, with each class of its lines;
    /// `None` if it sent a frame or had an event.
    fn why_nothing_was_played(&self, now: Cycles) -> Option<String> {
        if self.frames_sent() > 0 || self.events.len() < self.events_total {
            return None;
        }
        let (frames, events) = (self.frame_times.len(), self.events_total);
        let due = self.frame_times.partition_point(|at| *at < now);
        let mut reasons = Vec::new();
        if due > 0 {
            reasons.push(format!("{due} frames were due, and the bus took none of them"));
        }
        if let Some(first) = self.frame_times.get(due) {
            let (late, first, end) = (frames - due, seconds(*first), seconds(now));
            reasons.push(format!(
                "{late} frames come after the end of the run at {end:.3} s, \
                 the first at {first:.3} s"
            ));
        }
        if let Some((first, _)) = self.events.front() {
            let first = seconds(*first);
            reasons.push(format!("{events} events come after it, the first at {first:.3} s"));
        }
        if self.error_frames > 0 {
            reasons.push(format!(
                "{} lines are error frames, which no station sends",
                self.error_frames
            ));
        }
        if self.blank_lines > 0 {
            reasons.push(format!("{} lines are empty or comments", self.blank_lines));
        }
        if reasons.is_empty() {
            reasons.push(String::from("the file is empty"));
        }
        Some(format!("the script {} sent nothing: {}", self.path.display(), reasons.join("; ")))
    }
}

/// Simulated time in seconds.
fn seconds(at: Cycles) -> f64 {
    at as f64 / F_CPU_HZ as f64
}

impl Link for Script {
    fn serve(&mut self, _bench: &mut Bench) -> Result<()> {
        if let Some(station) = &self.station {
            // Without this the station's queue of received frames would grow without bound.
            station.borrow_mut().take_received();
        }
        Ok(())
    }

    fn finish(&mut self, bench: &mut Bench) -> Result<()> {
        self.hint = self.why_nothing_was_played(bench.now());
        Ok(())
    }

    fn take_hint(&mut self) -> Option<String> {
        self.hint.take()
    }

    fn status(&self) -> String {
        let (sent, frames) = (self.frames_sent(), self.frame_times.len());
        let first = match self.frame_times.first() {
            Some(first) if sent == 0 => format!(", the first at {:.3} s", seconds(*first)),
            _ => String::new(),
        };
        let events = self.events.len();
        format!(
            "script {}: {sent} of {frames} frames sent{first}, {events} events to come",
            self.path.display()
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::Fault;
    use crate::links::scratch::Scratch;

    const S: Cycles = F_CPU_HZ;

    #[test]
    fn the_error_of_a_missing_or_invalid_script_names_the_file() {
        let directory = Scratch::new();
        let mut bench = Bench::new(1_000_000);
        let mut message =
            |path: &Path| format!("{:#}", Script::open(path, &mut bench).err().unwrap());
        let path = directory.path("x.script");
        assert!(message(&path).starts_with(&format!("--script: cannot read {}: ", path.display())));
        std::fs::write(&path, "(1) button press\n(2) jump\n").unwrap();
        assert!(message(&path).starts_with(&format!("--script: {}:2: expected ", path.display())));
    }

    #[test]
    fn events_are_taken_when_they_are_due() {
        let directory = Scratch::new();
        let path = directory.path("x.script");
        std::fs::write(&path, "(0.001) button press\n(0.002) fault cable\n").unwrap();
        let mut script = Script::open(&path, &mut Bench::new(1_000_000)).unwrap();
        assert_eq!(script.next_event_at(), Some(S / 1000));
        assert_eq!(script.take_events(S / 1000 - 1), []);
        assert_eq!(script.take_events(S / 1000), [(S / 1000, BenchEvent::Button(true))]);
        assert_eq!(script.take_events(S), [(S / 500, BenchEvent::Fault(Fault::Cable))]);
        assert_eq!(script.next_event_at(), None);
    }

    /// The hint after a run of 10 ms with a script of this text.
    fn hint(text: &str) -> Option<String> {
        let directory = Scratch::new();
        let path = directory.path("x.log");
        std::fs::write(&path, text).unwrap();
        let mut bench = Bench::new(1_000_000);
        let mut script = Script::open(&path, &mut bench).unwrap();
        bench.run_for_ms(10);
        script.take_events(bench.now());
        script.finish(&mut bench).unwrap();
        let hint = script.take_hint()?;
        let (_, reasons) = hint.split_once("x.log sent nothing: ").expect("the file's name");
        Some(reasons.to_owned())
    }

    #[test]
    fn a_file_that_sends_nothing_says_so_with_the_reason_for_each_class_of_lines() {
        let late = "2 frames come after the end of the run at 0.010 s, the first at 12345.679 s";
        let text = "(12345.678901) can0 123# R\n(12346.0) can0 124# R\n";
        assert_eq!(hint(text).as_deref(), Some(late));
        let text = "# x\n\n(0) can0 20000008#00\n(7) temperature 60\n";
        let expected = "1 events come after it, the first at 7.000 s; \
                        1 lines are error frames, which no station sends; \
                        2 lines are empty or comments";
        assert_eq!(hint(text).as_deref(), Some(expected));
        assert_eq!(hint("").as_deref(), Some("the file is empty"));
        // No other station acknowledges.
        let alone = "1 frames were due, and the bus took none of them";
        assert_eq!(hint("(0.001) can0 123#").as_deref(), Some(alone));
        assert_eq!(hint("(0.001) temperature 60\n(99) can0 123#"), None);
    }
}
