//! Runs a scene against the wall clock: as a live view on the terminal, or as plain lines.
//!
//! Both loops simulate a slice, show it, and wait for real time. They end between two slices, at a
//! signal or at the end of the time of `--for`. The live view restores the terminal however the
//! program ends, also by a panic. When the terminal's window is closed, the live view ends as with
//! the key `q`.

use super::args::Args;
use super::keys::{self, Action};
use super::live;
use super::pace::{Measured, Pace, Speed};
use super::plain::Plain;
use super::scene::Scene;
use super::screen::Screen;
use crate::links::pty::is_hung_up;
use anyhow::{Context, Result};
use bench::{Cycles, F_CPU_HZ};
use ratatui::DefaultTerminal;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::event::{self, Event};
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::{Clear, ClearType, EnterAlternateScreen, enable_raw_mode};
use rustix::process::{Signal, kill_current_process_group};
use std::fs::File;
use std::io::{self, IsTerminal, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// Length of a slice in real time: short enough that keys and motion show no delay.
const SLICE_S: f64 = 0.01;
/// Length of a slice if clients that use the wall clock can wait for an answer.
const SLICE_WITH_CLIENTS_S: f64 = 0.002;
/// Largest lag behind real time for which the simulation compensates: a few slices, so that a busy
/// host keeps the mean speed.
const LAG_MAX: Duration = Duration::from_millis(250);
/// The same limit if clients can use the wall clock. To compensate, the simulation runs faster than
/// real time, and a client's short delay is a long one in simulated time. It must stay below the 50
/// ms that a node waits for the next frame of a list.
const LAG_MAX_WITH_CLIENTS: Duration = Duration::from_millis(20);
/// Factor by which simulated time slows down while a client has a limited time to answer.
const TIME_FOR_CLIENTS: u32 = 10;
/// Shortest and longest slice in simulated time.
const SLICE_MIN: Cycles = F_CPU_HZ / 10_000;
const SLICE_MAX: Cycles = F_CPU_HZ / 50;
/// Real time between two pictures: 25 a second, which a terminal over a network can show.
const PICTURE_PERIOD: Duration = Duration::from_millis(40);
/// Keys that can wait for the end of a slice: more than anybody types in that time.
const KEYS_MAX: usize = 64;

/// Wall clock and pace of a run.
struct Clock {
    started: Instant,
    pace: Pace,
    slice: Cycles,
    end: Option<Cycles>,
}

impl Clock {
    fn new(args: &Args, scene: &Scene) -> Clock {
        let (slice_s, lag_max) = if scene.needs_real_time() {
            (SLICE_WITH_CLIENTS_S, LAG_MAX_WITH_CLIENTS)
        } else {
            (SLICE_S, LAG_MAX)
        };
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

    /// Simulates a slice. Returns the real time to wait after it.
    fn step(&mut self, scene: &mut Scene) -> Result<Duration> {
        let from = scene.now();
        let times = if scene.gives_time() { TIME_FOR_CLIENTS } else { 1 };
        let slice = self.slice / Cycles::from(times);
        let until = (from + slice).min(self.end.unwrap_or(Cycles::MAX));
        let before = self.started.elapsed();
        scene.advance(until)?;
        let after = self.started.elapsed();
        self.pace.stretch(scene.now() - from, times);
        self.pace.add_slice(scene.now() - from, after - before, after);
        Ok(self.pace.wait(scene.now(), after))
    }

    fn measured(&self) -> Measured {
        self.pace.measured(self.started.elapsed())
    }

    fn average(&self) -> Measured {
        self.pace.average(self.started.elapsed())
    }
}

/// Runs the scene, and prints one line for each event and the summary on `out`.
///
/// # Errors
/// If a link cannot go on, or `out` fails, for example with a broken pipe.
pub fn plain(scene: &mut Scene, args: &Args, stop: &AtomicBool, out: impl Write) -> Result<()> {
    let mut clock = Clock::new(args, scene);
    let mut view = Plain::new(out, args.traffic);
    let simulated = print_events(scene, &mut clock, &mut view, stop);
    // After an error, too: the other links can still write their files.
    simulated.and(scene.finish())?;
    view.step(scene.state_mut())?;
    view.print_summary(scene.state(), clock.average())?;
    Ok(())
}

/// Simulates until the end of the run or `stop`, and prints a line for each event.
fn print_events(
    scene: &mut Scene,
    clock: &mut Clock,
    view: &mut Plain<impl Write>,
    stop: &AtomicBool,
) -> Result<()> {
    while !clock.is_over(scene) && !stop.load(Ordering::Relaxed) {
        let wait = clock.step(scene)?;
        view.step(scene.state_mut())?;
        thread::sleep(wait);
    }
    Ok(())
}

/// Runs the scene as a live view until the user quits. Returns the speed for the summary, which the
/// caller prints.
///
/// # Errors
/// If a link cannot go on, or the terminal fails.
pub fn live(scene: &mut Scene, args: &Args, stop: &AtomicBool) -> Result<Measured> {
    // Also installs a panic hook that restores the terminal before the message is printed.
    let mut terminal = ratatui::try_init().context("cannot use this terminal: try --plain")?;
    let restored = Restored;
    let speed = live_loop(&mut terminal, scene, args, stop);
    if terminal.show_cursor().is_err() {
        // Dropped, it would print the error, and panic on a closed terminal.
        std::mem::forget(terminal);
    }
    drop(restored);
    // After an error, too: the other links can still write their files.
    let finished = scene.finish();
    speed.and_then(|speed| finished.map(|()| speed))
}

/// Restores the terminal when it goes out of scope.
struct Restored;

impl Drop for Restored {
    fn drop(&mut self) {
        // This fails if the terminal is closed; then there is nowhere to print the error.
        let _ = ratatui::try_restore();
    }
}

fn live_loop(
    terminal: &mut DefaultTerminal,
    scene: &mut Scene,
    args: &Args,
    stop: &AtomicBool,
) -> Result<Measured> {
    let mut clock = Clock::new(args, scene);
    let keyboard = Keyboard::open().context("cannot read from this terminal: try --plain")?;
    let mut screen = Screen::default();
    let mut page = 0;
    let mut paused_at = Duration::ZERO;
    let mut next_picture = Instant::now();
    let mut next_slice = Instant::now();
    'run: loop {
        if clock.is_over(scene) || stop.load(Ordering::Relaxed) || keyboard.is_closed() {
            break;
        }
        if !screen.is_paused && Instant::now() >= next_slice {
            let wait = clock.step(scene)?;
            next_slice = Instant::now() + wait;
            scene.state_mut().take_events();
        }
        if screen.is_paused {
            // Clients still send commands; without an answer they would report a broken adapter.
            scene.serve()?;
            scene.state_mut().take_events();
        }
        if Instant::now() >= next_picture {
            screen.speed = clock.measured();
            let drawn = terminal.draw(|frame| page = live::draw(frame, scene.state(), &screen));
            if drawn.is_err() && keyboard.is_closed() {
                break;
            }
            drawn.context("cannot draw on the terminal")?;
            next_picture = Instant::now() + PICTURE_PERIOD;
        }
        let next = if screen.is_paused { next_picture } else { next_slice.min(next_picture) };
        let mut wait = next.saturating_duration_since(Instant::now());
        while let Some(event) = keyboard.wait(wait)? {
            wait = Duration::ZERO;
            let Event::Key(key) = event else {
                continue;
            };
            match keys::action(key, screen.popup) {
                None => {}
                Some(Action::Quit) => break 'run,
                Some(Action::Suspend) => {
                    let before = clock.started.elapsed();
                    suspend(terminal)?;
                    // The end of a pause counts all the time since its beginning.
                    if !screen.is_paused {
                        let now = clock.started.elapsed();
                        clock.pace.resume(scene.now(), now - before, now);
                    }
                    next_slice = Instant::now();
                    next_picture = next_slice;
                }
                Some(Action::TogglePause) => {
                    screen.is_paused = !screen.is_paused;
                    if screen.is_paused {
                        paused_at = clock.started.elapsed();
                    } else {
                        let now = clock.started.elapsed();
                        clock.pace.resume(scene.now(), now - paused_at, now);
                    }
                }
                Some(action) => apply(action, scene, &mut screen, page),
            }
        }
    }
    Ok(clock.average())
}

/// Stops this program and the rest of its job, such as `make sim`, until the shell continues them.
/// Meanwhile the terminal is as it was before.
fn suspend(terminal: &mut DefaultTerminal) -> Result<()> {
    terminal.show_cursor().context("cannot draw on the terminal")?;
    ratatui::try_restore().context("cannot restore the terminal")?;
    // Linux delivers the signal to the main thread, this one, before the call returns. Without a
    // shell that could continue the job, Linux ignores it.
    kill_current_process_group(Signal::TSTP).context("cannot stop")?;
    // The program goes on here.
    enable_raw_mode().context("cannot use this terminal")?;
    execute!(io::stdout(), EnterAlternateScreen, Clear(ClearType::All))
        .context("cannot draw on the terminal")?;
    // A new one draws every cell. `Terminal::clear` would ask the terminal for its cursor, and wait
    // for the answer.
    *terminal = DefaultTerminal::new(CrosstermBackend::new(io::stdout()))
        .context("cannot use this terminal")?;
    Ok(())
}

/// The terminal that crossterm reads from, and the events that it has read.
///
/// Crossterm 0.29 never returns from a read of a closed terminal (event/source/unix/mio.rs). So a
/// thread reads, which the end of the program ends, and nobody waits for it.
struct Keyboard {
    terminal: OwnedFd,
    events: Receiver<io::Result<Event>>,
}

impl Keyboard {
    /// Opens the same terminal as crossterm: standard input if it is a terminal, else the
    /// controlling terminal.
    fn open() -> io::Result<Keyboard> {
        let input = io::stdin();
        let terminal = if input.is_terminal() {
            input.as_fd().try_clone_to_owned()?
        } else {
            File::open("/dev/tty")?.into()
        };
        let (sender, events) = sync_channel(KEYS_MAX);
        thread::spawn(move || while sender.send(event::read()).is_ok() {});
        Ok(Keyboard { terminal, events })
    }

    fn is_closed(&self) -> bool {
        is_hung_up(&self.terminal)
    }

    /// Waits for a key or another event of the terminal, at most for `wait`.
    fn wait(&self, wait: Duration) -> io::Result<Option<Event>> {
        match self.events.recv_timeout(wait) {
            Ok(Err(_)) if self.is_closed() => Ok(None),
            Ok(event) => event.map(Some),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(io::ErrorKind::UnexpectedEof.into()),
        }
    }
}

/// Applies the action of a key to the bench or to the screen, on which `page` lines of traffic fit.
fn apply(action: Action, scene: &mut Scene, screen: &mut Screen, page: usize) {
    match action {
        Action::Nudge(hundredths) => scene.nudge(f64::from(hundredths) / 100.0),
        Action::ToggleSweep => scene.toggle_sweep(),
        Action::Warm(degrees) => scene.warm(f64::from(degrees)),
        Action::Spin(steps) => scene.spin(steps),
        Action::NextCommandType => scene.next_command_type(),
        Action::Inject(fault) => scene.inject(fault),
        Action::End(fault) => scene.end(fault),
        Action::EndAll => scene.end_all(),
        Action::Acknowledge => {
            let hints = scene.state().notices().count();
            screen.acknowledged = (screen.acknowledged + 1).min(hints);
        }
        action => screen.apply(action, &scene.state().traffic, page),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::Fault;
    use bench::avr::Firmware;
    use clap::Parser;
    use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

    /// Runs a scene with a program that does nothing to its end, and prints it on `out`.
    fn print(options: &str, out: impl Write) -> Result<()> {
        let line = format!("sim --speed max {options}");
        let args = Args::try_parse_from(line.split_whitespace()).unwrap();
        let firmware = Firmware { flash: vec![(0, vec![0xFF, 0xCF])], ..Firmware::default() };
        let mut scene = Scene::boot(&firmware, &args)?;
        plain(&mut scene, &args, &AtomicBool::new(false), out)
    }

    /// Presses keys of the live view, `^` for Esc, and returns the faults that are on.
    fn faults_after(keys: &str) -> Vec<Fault> {
        let firmware = Firmware { flash: vec![(0, vec![0xFF, 0xCF])], ..Firmware::default() };
        let args = Args::try_parse_from(["sim", "--inject", "error-storm@0s"]).unwrap();
        let mut scene = Scene::boot(&firmware, &args).unwrap();
        let mut screen = Screen::default();
        scene.advance(F_CPU_HZ / 1000).unwrap();
        for key in keys.chars() {
            let code = if key == '^' { KeyCode::Esc } else { KeyCode::Char(key) };
            if let Some(action) =
                keys::action(KeyEvent::new(code, KeyModifiers::NONE), screen.popup)
            {
                apply(action, &mut scene, &mut screen, 5);
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
    fn a_plain_run_ends_at_the_time_of_the_option_with_the_summary() {
        let mut out = Vec::new();
        print("--for 100ms --traffic", &mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        assert!(text.contains("servo   no pulse"), "{text}");
        assert!(text.contains("1 NodeStatus OK OPERATIONAL up 0 s"), "{text}");
        assert!(text.contains("simulated       0.100 s"), "{text}");
        assert!(text.contains("bus             6 frames, 0 error frames"), "{text}");
    }

    /// `sim | head` must end when `head` has its lines.
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
        let error = print("", Closed).unwrap_err();
        let cause = error.downcast_ref::<io::Error>().unwrap();
        assert_eq!(cause.kind(), io::ErrorKind::BrokenPipe);
    }
}
