//! Runs a scene against the wall clock: as a live view on the terminal, or as plain lines.
//!
//! Both loops are the same: simulate a slice, show it, wait until real time has caught up. A signal, or the end of the
//! asked time, ends them between two slices. The terminal is restored however the program ends, by a panic too. A terminal that
//! is gone, because its window was closed, ends the live view like the key that quits.

use super::args::Args;
use super::keys::{self, Action};
use super::live;
use super::pace::{Measured, Pace, Speed};
use super::plain::Plain;
use super::scene::Scene;
use super::screen::Screen;
use anyhow::{Context, Result};
use bench::{Cycles, F_CPU_HZ};
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::fs::File;
use std::io::{self, IsTerminal, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// A slice in real time: short enough for keys and motion to feel immediate.
const SLICE_S: f64 = 0.01;
/// The same while clients on the wall clock may wait for an answer.
const SLICE_WITH_CLIENTS_S: f64 = 0.002;
/// The lag behind real time that the simulation makes up for: a few slices, so that a busy host does not bend the mean.
const LAG_MAX: Duration = Duration::from_millis(250);
/// The same while clients on the wall clock may be attached. To make up for a lag is to simulate faster than real time, and then little time of the
/// client's is much simulated time: it must stay below the 50 ms that a node waits for the next frame of a transfer.
const LAG_MAX_WITH_CLIENTS: Duration = Duration::from_millis(20);
/// Limits of a slice in simulated time.
const SLICE_MIN: Cycles = F_CPU_HZ / 10_000;
const SLICE_MAX: Cycles = F_CPU_HZ / 50;
/// Pictures for each real second: as many as a terminal over a network can take.
const PICTURE_PERIOD: Duration = Duration::from_millis(40);

/// Wall clock and pace of a run.
struct Clock {
    started: Instant,
    pace: Pace,
    slice: Cycles,
    end: Option<Cycles>,
}

impl Clock {
    fn new(args: &Args, scene: &Scene) -> Clock {
        let (slice_s, lag_max) =
            if scene.needs_real_time() { (SLICE_WITH_CLIENTS_S, LAG_MAX_WITH_CLIENTS) } else { (SLICE_S, LAG_MAX) };
        let slice = match args.speed {
            Speed::Factor(factor) => (factor * slice_s * F_CPU_HZ as f64) as Cycles,
            Speed::Max => SLICE_MAX,
        };
        Clock {
            started: Instant::now(),
            pace: Pace::new(args.speed, lag_max),
            slice: slice.clamp(SLICE_MIN, SLICE_MAX),
            end: args.duration,
        }
    }

    fn is_over(&self, scene: &Scene) -> bool {
        self.end.is_some_and(|end| scene.now() >= end)
    }

    /// Simulates a slice and says how long to wait after it.
    fn step(&mut self, scene: &mut Scene) -> Result<Duration> {
        let from = scene.now();
        let until = (from + self.slice).min(self.end.unwrap_or(Cycles::MAX));
        let before = self.started.elapsed();
        scene.advance(until)?;
        let after = self.started.elapsed();
        self.pace.worked(scene.now() - from, after - before, after);
        Ok(self.pace.wait(scene.now(), after))
    }

    fn measured(&self) -> Measured {
        self.pace.measured(self.started.elapsed())
    }

    fn average(&self) -> Measured {
        self.pace.average(self.started.elapsed())
    }
}

/// Runs with one line for each event on `out`, and the summary at the end.
///
/// # Errors
/// Those of the output, a broken pipe among them.
pub fn plain(scene: &mut Scene, args: &Args, stop: &AtomicBool, out: impl Write) -> Result<()> {
    let mut clock = Clock::new(args, scene);
    let mut view = Plain::new(out, args.traffic);
    while !clock.is_over(scene) && !stop.load(Ordering::Relaxed) {
        let wait = clock.step(scene)?;
        view.step(scene.state_mut())?;
        std::thread::sleep(wait);
    }
    scene.finish()?;
    view.step(scene.state_mut())?;
    view.summary(scene.state(), clock.average())?;
    Ok(())
}

/// Runs on the terminal until the user quits; the summary is left for the caller to print.
///
/// # Errors
/// Those of the terminal.
pub fn live(scene: &mut Scene, args: &Args, stop: &AtomicBool) -> Result<Measured> {
    // Also installs a panic hook that restores the terminal before the message is printed.
    let terminal = ratatui::try_init().context("cannot use this terminal: try --plain")?;
    let restored = Restored;
    let result = live_loop(terminal, scene, args, stop);
    drop(restored);
    result
}

/// Restores the terminal when it goes out of scope.
struct Restored;

impl Drop for Restored {
    fn drop(&mut self) {
        // A terminal that is gone cannot be restored, and nobody could read why.
        let _ = ratatui::try_restore();
    }
}

fn live_loop(mut terminal: DefaultTerminal, scene: &mut Scene, args: &Args, stop: &AtomicBool) -> Result<Measured> {
    let mut clock = Clock::new(args, scene);
    let keyboard = Keyboard::open().context("cannot read from this terminal: try --plain")?;
    let mut screen = Screen::default();
    let mut page = 0;
    let mut paused_at = Duration::ZERO;
    let mut next_picture = Instant::now();
    let mut next_slice = Instant::now();
    'run: loop {
        if clock.is_over(scene) || stop.load(Ordering::Relaxed) || keyboard.look(Duration::ZERO)? == Look::Gone {
            break;
        }
        if !screen.paused && Instant::now() >= next_slice {
            let wait = clock.step(scene)?;
            next_slice = Instant::now() + wait;
            scene.state_mut().take_news();
        }
        if screen.paused {
            // Clients go on, and would take silence for a broken adapter.
            scene.serve()?;
            scene.state_mut().take_news();
        }
        if Instant::now() >= next_picture {
            screen.speed = clock.measured();
            let drawn = terminal.draw(|frame| page = live::draw(frame, scene.state(), &screen));
            if drawn.is_err() && keyboard.look(Duration::ZERO)? == Look::Gone {
                break;
            }
            drawn.context("cannot draw on the terminal")?;
            next_picture = Instant::now() + PICTURE_PERIOD;
        }
        let next = if screen.paused { next_picture } else { next_slice.min(next_picture) };
        let mut wait = next.saturating_duration_since(Instant::now());
        loop {
            match keyboard.wait(wait)? {
                Look::Gone => break 'run,
                Look::Nothing => break,
                Look::Something => wait = Duration::ZERO,
            }
            let Event::Key(key) = event::read()? else {
                continue;
            };
            match keys::action(key, screen.popup) {
                None => {}
                Some(Action::Quit) => break 'run,
                Some(Action::TogglePause) => {
                    screen.paused = !screen.paused;
                    if screen.paused {
                        paused_at = clock.started.elapsed();
                    } else {
                        let now = clock.started.elapsed();
                        clock.pace.resume(scene.now(), now - paused_at, now);
                    }
                }
                Some(action) => act(action, scene, &mut screen, page),
            }
        }
    }
    scene.finish()?;
    Ok(clock.average())
}

/// What there is to read from the terminal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Look {
    Nothing,
    Something,
    /// The other end is closed.
    Gone,
}

/// The terminal that crossterm reads from. Crossterm 0.29 does not return from a terminal that is gone
/// (event/source/unix/mio.rs reads on for ever), so each look at it comes before crossterm's.
struct Keyboard(OwnedFd);

impl Keyboard {
    /// Opens what crossterm opens: standard input, or the controlling terminal if that is something else.
    fn open() -> io::Result<Keyboard> {
        let input = io::stdin();
        let terminal =
            if input.is_terminal() { input.as_fd().try_clone_to_owned()? } else { File::open("/dev/tty")?.into() };
        Ok(Keyboard(terminal))
    }

    /// Waits for a key, or another event of the terminal.
    fn wait(&self, wait: Duration) -> io::Result<Look> {
        if self.look(Duration::ZERO)? == Look::Gone {
            return Ok(Look::Gone);
        }
        let has_event = || event::poll(Duration::ZERO).or_else(interrupted);
        // Crossterm may hold events that it has read before.
        if has_event()? {
            return Ok(Look::Something);
        }
        Ok(match self.look(wait)? {
            // Half of an escape sequence is no event.
            Look::Something if !has_event()? => Look::Nothing,
            look => look,
        })
    }

    /// Waits until there is something to read, or no terminal any more.
    fn look(&self, wait: Duration) -> io::Result<Look> {
        let mut terminal = [PollFd::new(&self.0, PollFlags::IN)];
        let wait = Timespec::try_from(wait).map_err(io::Error::other)?;
        match poll(&mut terminal, Some(&wait)) {
            Ok(0) => Ok(Look::Nothing),
            Ok(_) if terminal[0].revents().intersects(PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL) => {
                Ok(Look::Gone)
            }
            Ok(_) => Ok(Look::Something),
            // A signal: the loop sees its flag.
            Err(rustix::io::Errno::INTR) => Ok(Look::Nothing),
            Err(error) => Err(error.into()),
        }
    }
}

/// Does what a key asks of the bench or of the screen, on which `page` lines of traffic fit.
fn act(action: Action, scene: &mut Scene, screen: &mut Screen, page: usize) {
    match action {
        Action::Nudge(hundredths) => scene.nudge(f64::from(hundredths) / 100.0),
        Action::ToggleSweep => scene.toggle_sweep(),
        Action::Warm(degrees) => scene.warm(f64::from(degrees)),
        Action::NextCommandType => scene.next_command_type(),
        Action::Inject(fault) => scene.inject(fault),
        Action::End(fault) => scene.end(fault),
        Action::EndAll => scene.end_all(),
        action => screen.apply(action, &scene.state().traffic, page),
    }
}

/// A signal while waiting for a key is not an error: the loop sees its flag.
fn interrupted(error: io::Error) -> io::Result<bool> {
    match error.kind() {
        io::ErrorKind::Interrupted => Ok(false),
        _ => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::Fault;
    use bench::avr::Firmware;
    use clap::Parser;
    use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

    /// A scene with a program that does nothing, run to its end; gives what was printed.
    fn printed(options: &str, out: impl Write) -> Result<()> {
        let line = format!("sim --speed max {options}");
        let args = Args::try_parse_from(line.split_whitespace()).unwrap();
        let firmware = Firmware { flash: vec![(0, vec![0xFF, 0xCF])], ..Firmware::default() };
        let mut scene = Scene::boot(&firmware, &args)?;
        plain(&mut scene, &args, &AtomicBool::new(false), out)
    }

    /// Presses keys of the live view, `^` for Esc, and gives the faults that are on.
    fn faults_after(keys: &str) -> Vec<Fault> {
        let firmware = Firmware { flash: vec![(0, vec![0xFF, 0xCF])], ..Firmware::default() };
        let args = Args::try_parse_from(["sim", "--inject", "error-storm@0s"]).unwrap();
        let mut scene = Scene::boot(&firmware, &args).unwrap();
        let mut screen = Screen::default();
        scene.advance(F_CPU_HZ / 1000).unwrap();
        for key in keys.chars() {
            let code = if key == '^' { KeyCode::Esc } else { KeyCode::Char(key) };
            if let Some(action) = keys::action(KeyEvent::new(code, KeyModifiers::NONE), screen.popup) {
                act(action, &mut scene, &mut screen, 5);
            }
            scene.advance(scene.now() + F_CPU_HZ / 1000).unwrap();
        }
        scene.state().active_faults.clone()
    }

    #[test]
    fn a_fault_ends_by_the_key_that_began_it() {
        let [storm, stuck] = [Fault::ErrorStorm, Fault::StuckDominant];
        assert_eq!(faults_after("5"), [storm], "a digit begins nothing outside the list");
        assert_eq!(faults_after("f5"), [storm, stuck]);
        for keys in ["f55", "f5f5", "f5^5", "f5^f5", "f5/5", "f5h5"] {
            assert_eq!(faults_after(keys), [storm], "{keys}");
        }
        for (key, fault) in [("c", Fault::Cable), ("a", Fault::Silence), ("d", Fault::Disarm)] {
            assert_eq!(faults_after(key), [storm, fault]);
            assert_eq!(faults_after(&key.repeat(2)), [storm], "{key}");
        }
        for digit in '1'..='9' {
            assert_eq!(faults_after(&format!("f{digit}{digit}")), [storm], "{digit}");
        }
    }

    #[test]
    fn one_key_ends_every_fault() {
        assert_eq!(faults_after("f5^cad").len(), 5);
        assert_eq!(faults_after("f5^cadx"), [], "the error storm has no key of its own");
        assert_eq!(faults_after("xx"), []);
    }

    #[test]
    fn a_plain_run_ends_at_the_asked_time_with_the_summary() {
        let mut out = Vec::new();
        printed("--for 100ms --traffic", &mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        assert!(text.contains("servo   no pulse"), "{text}");
        assert!(text.contains("1 NodeStatus OK OPERATIONAL up 0 s"), "{text}");
        assert!(text.contains("simulated       0.100 s"), "{text}");
        assert!(text.contains("bus             6 frames, 0 error frames"), "{text}");
    }

    /// `sim | head` must end, not go on in silence.
    #[test]
    fn a_closed_pipe_ends_the_run() {
        struct Closed;
        impl Write for Closed {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(io::ErrorKind::BrokenPipe.into())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let error = printed("", Closed).unwrap_err();
        let cause = error.downcast_ref::<io::Error>().unwrap();
        assert_eq!(cause.kind(), io::ErrorKind::BrokenPipe);
    }
}
