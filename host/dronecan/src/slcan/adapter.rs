//! The client's side of an SLCAN adapter, without I/O: bytes from its port in, frames out; frames
//! in, bytes for its port out. Its user owns the port and the clock.
//!
//! The channel is closed, gets its bit rate, and is opened. Each command waits for its answer, or
//! for half a second: some adapters never answer, and work nevertheless.
//!
//! Some adapters return each frame that they have sent. Such an echo is not a frame of another
//! node: it is counted and dropped.

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use super::{Replies, Reply, line, rate_digit};
use crate::Frame;

/// Timeout for each answer of an adapter.
const TIMEOUT: Duration = Duration::from_millis(500);
/// Answers to the commands that close the channel arrive within this time of each other.
const NEXT_ANSWER: Duration = Duration::from_millis(30);
/// A received frame that is the same as one sent in this time is its echo.
const ECHO_WITHIN: Duration = Duration::from_secs(2);
/// Maximum number of sent frames that are compared with the received ones.
const SENT_MAX: usize = 1000;
/// While this many bytes wait for the port, no frame is accepted.
const OUT_MAX: usize = 1024;

/// Lines that are not SLCAN before the channel is open, and no adapter: the first one can be the
/// rest of a line from the session before.
const GARBAGE_LINES: u64 = 2;

/// Ends an incomplete line, and a session.
const CLOSE: &[u8] = b"\rC\r";

/// The bit of [`Adapter::flags`] for errors on the bus.
pub const BUS_ERROR: u8 = 1 << 7;

/// Why an adapter cannot be opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// SLCAN has no command for this bit rate.
    NoSuchRate(u32),
    /// The adapter rejected this bit rate, or to be opened with it.
    Rejected(u32),
    /// The adapter rejected to listen only. Its channel is closed.
    CannotListen,
    /// What answers is no adapter.
    Garbage,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Refusal::NoSuchRate(rate) => write!(
                f,
                "SLCAN has no {rate} bit/s: 10, 20, 50, 100, 125, 250, 500, 800 or 1000 thousand"
            ),
            Refusal::Rejected(rate) => {
                write!(f, "the adapter rejects {rate} bit/s; does the bus have another rate?")
            }
            Refusal::CannotListen => f.write_str("the adapter cannot listen only"),
            Refusal::Garbage => {
                f.write_str("this is not an SLCAN adapter, or its port has another baud rate")
            }
        }
    }
}

impl std::error::Error for Refusal {}

/// What an adapter does on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// It sends, and acknowledges the frames of others.
    Normal,
    /// It drives no bit. A node that is alone with it repeats its first frame, because nobody
    /// acknowledges it.
    ListenOnly,
}

/// The last command sent to an adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Closing,
    Rate,
    Stamping,
    Opening,
    Open,
}

/// An SLCAN adapter that is being opened, or is open.
pub struct Adapter {
    bit_rate: u32,
    channel: Channel,
    wants_stamps: bool,
    state: State,
    deadline: Duration,
    replies: Replies,
    /// Bytes that the port has not accepted yet.
    out: Vec<u8>,
    /// The frames that the adapter may return, with the time when they were sent.
    sent: VecDeque<(Duration, Frame)>,
    /// The answer to [`Adapter::ask_flags`].
    pub flags: Option<u8>,
    /// Number of frames that came back from the adapter.
    pub echoed: u64,
    /// Number of lines that are not SLCAN.
    pub invalid: u64,
    /// The same before the channel is open. A byte that no adapter sends counts for all.
    garbage: u64,
    /// The last command was rejected.
    is_refused: bool,
}

impl Adapter {
    /// Begins to open an adapter.
    pub fn new(bit_rate: u32, channel: Channel, now: Duration) -> Adapter {
        Adapter {
            bit_rate,
            channel,
            wants_stamps: false,
            state: State::Closing,
            deadline: now + TIMEOUT,
            replies: Replies::default(),
            out: CLOSE.to_vec(),
            sent: VecDeque::new(),
            flags: None,
            echoed: 0,
            invalid: 0,
            garbage: 0,
            is_refused: false,
        }
    }

    /// Requests time stamps when the channel is opened. Some adapters have none.
    pub fn request_stamps(&mut self) {
        self.wants_stamps = true;
    }

    /// True if the channel is open.
    pub fn is_open(&self) -> bool {
        self.state == State::Open
    }

    /// The time stamp of the last frame in microseconds, if the adapter adds them: the time of the
    /// minute, or another that begins at 0 now and then.
    pub fn stamp_us(&self) -> Option<u64> {
        self.replies.stamp_us
    }

    /// What the adapter does on the bus once its channel is open.
    pub fn channel(&self) -> Channel {
        self.channel
    }

    /// When to call [`Adapter::poll`]; `None` if the channel is open.
    pub fn deadline(&self) -> Option<Duration> {
        (!self.is_open()).then_some(self.deadline)
    }

    /// Handles bytes from the port. Adds the frames of other nodes to `frames`.
    ///
    /// # Errors
    /// If the adapter cannot be opened.
    pub fn receive(
        &mut self,
        bytes: &[u8],
        now: Duration,
        frames: &mut Vec<Frame>,
    ) -> Result<(), Refusal> {
        for byte in bytes {
            if !self.is_open() && !matches!(byte, 0x07 | b'\r' | b'\n' | b' '..=b'~') {
                self.garbage = GARBAGE_LINES;
            }
            match self.replies.push(*byte) {
                Some(Reply::Received(frame)) if self.is_open() => {
                    if self.is_echo(&frame, now) {
                        self.echoed += 1;
                    } else {
                        frames.push(frame);
                    }
                }
                Some(Reply::Invalid) if self.is_open() => self.invalid += 1,
                Some(Reply::Invalid) => self.garbage += 1,
                Some(Reply::Flags(flags)) => self.flags = Some(flags),
                Some(Reply::Done) => self.step(now, true)?,
                Some(Reply::Refused) => self.step(now, false)?,
                _ => {}
            }
        }
        Ok(())
    }

    /// Goes on if an answer has not arrived in time.
    ///
    /// # Errors
    /// If the adapter cannot be opened.
    pub fn poll(&mut self, now: Duration) -> Result<(), Refusal> {
        match self.deadline() {
            Some(deadline) if now >= deadline => self.step(now, true),
            _ => Ok(()),
        }
    }

    /// Queues the bytes of a frame. Returns false if there is no room now, or if the channel only
    /// listens.
    pub fn send(&mut self, frame: &Frame, now: Duration) -> bool {
        let can_send = self.is_open() && self.channel == Channel::Normal;
        if !can_send || self.out.len() > OUT_MAX {
            return false;
        }
        self.out.extend(line(frame, None));
        self.sent.push_back((now, *frame));
        self.sent.drain(..self.sent.len().saturating_sub(SENT_MAX));
        true
    }

    /// Asks for the flags of the open channel since the last time, [`Adapter::flags`]. Some
    /// adapters have none.
    pub fn ask_flags(&mut self) {
        self.flags = None;
        self.out.extend(b"F\r");
    }

    /// The bytes that wait for the port.
    pub fn output(&self) -> &[u8] {
        &self.out
    }

    /// Removes the first `count` bytes of [`Adapter::output`], which the port has accepted.
    pub fn written(&mut self, count: usize) {
        self.out.drain(..count);
    }

    /// True if the frame is one that was sent. The next one that is the same is another echo.
    fn is_echo(&mut self, frame: &Frame, now: Duration) -> bool {
        while self.sent.front().is_some_and(|(at, _)| now > *at + ECHO_WITHIN) {
            self.sent.pop_front();
        }
        let at = self.sent.iter().position(|(_, sent)| sent == frame);
        at.and_then(|at| self.sent.remove(at)).is_some()
    }

    /// Sends the next command that opens the adapter, after an answer or a timeout.
    fn step(&mut self, now: Duration, done: bool) -> Result<(), Refusal> {
        self.is_refused |= !done;
        match self.state {
            // Some adapters answer the empty line before the command, some do not: waits for the
            // other answers, so that none counts as the answer to the next command.
            State::Closing if now < self.deadline => {
                self.deadline = self.deadline.min(now + NEXT_ANSWER);
            }
            State::Closing => {
                let digit = rate_digit(self.bit_rate).ok_or(Refusal::NoSuchRate(self.bit_rate))?;
                self.command(State::Rate, &format!("S{digit}\r"), now);
            }
            State::Rate | State::Stamping | State::Opening if self.garbage >= GARBAGE_LINES => {
                return Err(Refusal::Garbage);
            }
            // The bell may be a byte of garbage, of which more follows.
            State::Rate | State::Opening if self.is_refused && now < self.deadline => {}
            State::Opening if self.is_refused && self.channel == Channel::ListenOnly => {
                return Err(Refusal::CannotListen);
            }
            State::Rate | State::Opening if self.is_refused => {
                return Err(Refusal::Rejected(self.bit_rate));
            }
            State::Rate if self.wants_stamps => self.command(State::Stamping, "Z1\r", now),
            State::Rate | State::Stamping => {
                let command = match self.channel {
                    Channel::Normal => "O\r",
                    Channel::ListenOnly => "L\r",
                };
                self.command(State::Opening, command, now);
            }
            State::Opening => self.state = State::Open,
            State::Open => {}
        }
        Ok(())
    }

    fn command(&mut self, state: State, command: &str, now: Duration) {
        self.state = state;
        self.is_refused = false;
        self.deadline = now + TIMEOUT;
        self.out.extend(command.bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds)
    }

    fn written(adapter: &mut Adapter) -> String {
        let bytes = adapter.output().to_vec();
        adapter.written(bytes.len());
        String::from_utf8(bytes).unwrap()
    }

    fn open() -> Adapter {
        let mut adapter = Adapter::new(1_000_000, Channel::Normal, ms(0));
        for at in [500, 1000, 1500] {
            adapter.poll(ms(at)).unwrap();
        }
        assert!(adapter.is_open());
        written(&mut adapter);
        adapter
    }

    #[test]
    fn an_adapter_that_answers_is_opened_at_its_rate() {
        let mut adapter = Adapter::new(500_000, Channel::Normal, ms(0));
        let mut frames = Vec::new();
        assert_eq!(written(&mut adapter), "\rC\r");
        adapter.receive(b"\r\x07", ms(1), &mut frames).unwrap();
        adapter.poll(ms(30)).unwrap();
        assert_eq!(written(&mut adapter), "");
        adapter.poll(ms(31)).unwrap();
        assert_eq!(written(&mut adapter), "S6\r");
        adapter.receive(b"\r", ms(32), &mut frames).unwrap();
        assert_eq!(written(&mut adapter), "O\r");
        // What comes before the channel is open is from the session before.
        adapter.receive(b"t1230\r\r", ms(33), &mut frames).unwrap();
        assert_eq!((adapter.is_open(), adapter.deadline(), frames.len()), (true, None, 0));
        adapter.receive(b"t1230\rt12\r", ms(34), &mut frames).unwrap();
        assert_eq!((frames, adapter.invalid), (vec![Frame::standard(0x123, &[])], 1));
    }

    #[test]
    fn an_adapter_that_never_answers_is_opened_after_its_timeouts() {
        let mut adapter = Adapter::new(1_000_000, Channel::Normal, ms(0));
        assert_eq!(adapter.deadline(), Some(ms(500)));
        for (at, commands) in [(499, "\rC\r"), (500, "S8\r"), (1000, "O\r"), (1500, "")] {
            adapter.poll(ms(at)).unwrap();
            assert_eq!(written(&mut adapter), commands, "{at}");
        }
        assert!(adapter.is_open());
    }

    #[test]
    fn time_stamps_are_requested_before_the_channel_is_opened_and_may_be_refused() {
        let mut adapter = Adapter::new(1_000_000, Channel::Normal, ms(0));
        adapter.request_stamps();
        for (at, commands) in [(500, "\rC\rS8\r"), (1000, "Z1\r")] {
            adapter.poll(ms(at)).unwrap();
            assert_eq!(written(&mut adapter), commands, "{at}");
        }
        adapter.receive(b"\x07", ms(1001), &mut Vec::new()).unwrap();
        assert_eq!(written(&mut adapter), "O\r");
        adapter.receive(b"\r", ms(1002), &mut Vec::new()).unwrap();
        assert!(adapter.is_open());
    }

    #[test]
    fn the_flags_of_an_adapter_are_those_since_the_last_time() {
        let mut adapter = open();
        adapter.ask_flags();
        assert_eq!((written(&mut adapter), adapter.flags), ("F\r".into(), None));
        adapter.receive(b"F80\r", ms(2000), &mut Vec::new()).unwrap();
        assert_eq!(adapter.flags, Some(BUS_ERROR));
    }

    #[test]
    fn an_adapter_that_only_listens_sends_no_frame() {
        let mut adapter = Adapter::new(1_000_000, Channel::ListenOnly, ms(0));
        for (at, commands) in [(500, "\rC\rS8\r"), (1000, "L\r"), (1500, "")] {
            adapter.poll(ms(at)).unwrap();
            assert_eq!(written(&mut adapter), commands, "{at}");
        }
        assert!(adapter.is_open() && !adapter.send(&Frame::standard(1, &[]), ms(1500)));
        assert_eq!(written(&mut adapter), "");
    }

    #[test]
    fn a_rate_that_the_adapter_rejects_is_an_error() {
        let mut adapter = Adapter::new(125_000, Channel::Normal, ms(0));
        adapter.poll(ms(500)).unwrap();
        adapter.receive(b"\x07", ms(501), &mut Vec::new()).unwrap();
        assert_eq!(adapter.poll(ms(1000)), Err(Refusal::Rejected(125_000)));
        let mut adapter = Adapter::new(123, Channel::Normal, ms(0));
        assert_eq!(adapter.poll(ms(500)), Err(Refusal::NoSuchRate(123)));
    }

    #[test]
    fn an_adapter_that_cannot_listen_only_is_no_wrong_rate() {
        let mut adapter = Adapter::new(125_000, Channel::ListenOnly, ms(0));
        adapter.poll(ms(500)).unwrap();
        adapter.receive(b"\r", ms(501), &mut Vec::new()).unwrap();
        adapter.receive(b"\x07", ms(502), &mut Vec::new()).unwrap();
        assert_eq!(adapter.poll(ms(1001)), Err(Refusal::CannotListen));
    }

    /// A GPS, an adapter at another baud rate, a program that prints; each has the bytes of answers
    /// among its own.
    #[test]
    fn what_speaks_another_language_is_no_adapter() {
        let others: [&[u8]; 3] =
            [b"$GPGGA,1\r\n$GPGSA,A\r\n", b"\xFE\x07\xF8\x07", b"ok\r\x07$x\r\x07\x07"];
        for other in others {
            let mut adapter = Adapter::new(1_000_000, Channel::ListenOnly, ms(0));
            let mut now = 0;
            let refusal = loop {
                now += 100;
                assert!(now < 5000, "{}", other.escape_ascii());
                let result = adapter.receive(other, ms(now), &mut Vec::new());
                if let Err(refusal) = result.and_then(|()| adapter.poll(ms(now))) {
                    break refusal;
                }
            };
            assert_eq!(refusal, Refusal::Garbage, "{}", other.escape_ascii());
        }
        // A bell is an answer, unless garbage follows.
        for (more, expected) in
            [(&b""[..], Refusal::Rejected(1_000_000)), (b"\xFF\xFE\r", Refusal::Garbage)]
        {
            let mut adapter = Adapter::new(1_000_000, Channel::ListenOnly, ms(0));
            adapter.poll(ms(500)).unwrap();
            adapter.receive(b"\x07\r", ms(501), &mut Vec::new()).unwrap();
            let refusal = adapter.receive(more, ms(502), &mut Vec::new());
            let refusal = refusal.and_then(|()| adapter.poll(ms(999)));
            assert_eq!(refusal.and_then(|()| adapter.poll(ms(1000))), Err(expected));
        }
        // The end of a line from the session before.
        let mut adapter = Adapter::new(1_000_000, Channel::ListenOnly, ms(0));
        adapter.receive(b"00C0\r\x07", ms(1), &mut Vec::new()).unwrap();
        adapter.poll(ms(31)).unwrap();
        adapter.receive(b"\r\r", ms(32), &mut Vec::new()).unwrap();
        assert!(adapter.is_open());
    }

    #[test]
    fn the_time_stamp_of_the_last_frame_is_kept() {
        let mut adapter = open();
        for (line, stamp) in [
            (&b"t1230\r"[..], None),
            (b"t123003E8\r", Some(1_000_000)),
            (b"\r", Some(1_000_000)),
            (b"t1230000003E8\r", Some(1000)),
        ] {
            adapter.receive(line, ms(2000), &mut Vec::new()).unwrap();
            assert_eq!(adapter.stamp_us(), stamp);
        }
    }

    #[test]
    fn a_frame_that_comes_back_within_two_seconds_is_an_echo_once() {
        let frame = Frame::extended(0x1404_562A, &[1, 2]);
        let mut adapter = open();
        assert!(adapter.send(&frame, ms(2000)));
        let mut frames = Vec::new();
        let bytes = line(&frame, Some(7));
        adapter.receive(&bytes, ms(2010), &mut frames).unwrap();
        assert_eq!((frames.len(), adapter.echoed), (0, 1));
        adapter.receive(&bytes, ms(2020), &mut frames).unwrap();
        assert!(adapter.send(&frame, ms(3000)));
        adapter.receive(&bytes, ms(5001), &mut frames).unwrap();
        assert_eq!((frames, adapter.echoed), (vec![frame, frame], 1));
    }

    #[test]
    fn a_port_that_accepts_nothing_gets_no_more_than_a_kilobyte_of_frames() {
        let mut adapter = open();
        let frame = Frame::extended(1, &[0; 8]);
        let accepted = (0..1000).filter(|_| adapter.send(&frame, ms(2000))).count();
        assert_eq!((accepted, adapter.output().len()), (38, 38 * 27));
    }
}
