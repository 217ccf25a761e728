//! The questions on the terminal, and the keys that answer them.

use std::io::{IsTerminal as _, Write as _, stdin};
use std::time::Duration;

use node_tools::check::desk::Answer;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::termios::{LocalModes, OptionalActions, Termios, tcgetattr, tcsetattr};

/// A question that waits for its answer.
struct Asked {
    /// The end of something to do.
    until: Option<Duration>,
    /// The seconds that were shown last.
    shown: Option<u64>,
}

/// Standard input and output.
pub struct Keys {
    asked: Option<Asked>,
    is_at_end: bool,
    is_terminal: bool,
    /// The settings of the terminal before this program.
    before: Option<Termios>,
}

impl Keys {
    /// On a terminal a key needs no Enter from now on.
    pub fn new() -> Keys {
        let before = if stdin().is_terminal() { tcgetattr(stdin()).ok() } else { None };
        if let Some(before) = &before {
            let mut settings = before.clone();
            settings.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
            let _ = tcsetattr(stdin(), OptionalActions::Now, &settings);
        }
        let is_terminal = before.is_some() && std::io::stdout().is_terminal();
        Keys { asked: None, is_at_end: false, is_terminal, before }
    }

    /// Prints a line.
    pub fn line(&self, text: &str) {
        if self.is_terminal && self.asked.is_some() {
            print!("\r\x1b[K");
        }
        println!("{text}");
    }

    /// Asks a question, or for something to do in so many seconds.
    pub fn ask(&mut self, text: &str, seconds: Option<u64>, now: Duration) {
        let keys = if seconds.is_some() { "s skips it" } else { "y or n" };
        let until = seconds.map(|seconds| now + Duration::from_secs(seconds));
        println!("{text} [{keys}]");
        self.asked = Some(Asked { until, shown: None });
    }

    /// The question has ended.
    pub fn withdraw(&mut self) {
        if self.asked.take().is_some() && self.is_terminal {
            print!("\r\x1b[K");
        }
    }

    /// True if a key would be an answer.
    pub fn wants_input(&self) -> bool {
        self.asked.is_some() && !self.is_at_end
    }

    /// Shows the countdown. Returns the answer if a key was pressed. At the end of the input all
    /// is skipped.
    pub fn answer(&mut self, now: Duration) -> Option<Answer> {
        let asked = self.asked.as_mut()?;
        if let Some(until) = asked.until
            && self.is_terminal
        {
            let left = until.saturating_sub(now).as_secs();
            if asked.shown != Some(left) {
                asked.shown = Some(left);
                print!("\r\x1b[K{left} s");
                let _ = std::io::stdout().flush();
            }
        }
        let answer = if self.is_at_end { Some(Answer::Skip) } else { self.key() };
        if let Some(answer) = answer {
            self.withdraw();
            println!("{}", format!("{answer:?}").to_lowercase());
        }
        answer
    }

    fn key(&mut self) -> Option<Answer> {
        let stdin = stdin();
        let none = Timespec { tv_sec: 0, tv_nsec: 0 };
        while let Ok(1) = poll(&mut [PollFd::new(&stdin, PollFlags::IN)], Some(&none)) {
            let mut key = [0];
            match rustix::io::read(&stdin, &mut key) {
                Ok(1) => {
                    if let Some(answer) = answer_of(key[0]) {
                        return Some(answer);
                    }
                }
                _ => {
                    self.is_at_end = true;
                    return Some(Answer::Skip);
                }
            }
        }
        None
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            let _ = tcsetattr(stdin(), OptionalActions::Now, before);
        }
    }
}

/// The answer that a key is.
fn answer_of(key: u8) -> Option<Answer> {
    match key {
        b'y' | b'Y' => Some(Answer::Yes),
        b'n' | b'N' => Some(Answer::No),
        b's' | b'S' | b' ' => Some(Answer::Skip),
        _ => None,
    }
}
