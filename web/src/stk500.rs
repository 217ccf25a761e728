//! Uploads a program through the bootloader of an Arduino, by STK500 version 1 (Atmel application
//! note AVR061) as far as ATmegaBOOT, Optiboot and the loader of `boot/` speak it.
//!
//! Bytes in, bytes out, and the time in milliseconds as an argument: whoever has the port sends
//! what [`Session::take_output`] returns, hands over what arrives, and calls again after
//! [`Session::wait_ms`] at the latest. The board has to be reset before the session begins.
//!
//! The order of the pages leaves no mixture of two programs that runs, whenever the upload ends:
//!
//! 1. The first page, with the vectors and the header, gets a program that does nothing.
//! 2. The other pages are written, and then read back and compared.
//! 3. The first page is written last, and read back.
//!
//! Arduino's own bootloaders start whatever the first page has; the loader of `boot/` starts
//! nothing with such a header. A bootloader erases a page before it writes it: if the supply fails
//! in the moment between, for the first page, the chip runs into the second one, of the old program
//! before step 2 and of the new one after it.

#![forbid(unsafe_code)]

use std::collections::BTreeSet;
use std::fmt;

use bench::avr::Chip;
use bench::boards;

/// Bytes of a page of the flash of both chips.
pub const PAGE: usize = 128;
/// A jump to itself. The chip does nothing but this until it is reset, and all pins stay inputs.
const IDLE: [u8; 2] = [0xFF, 0xCF];
const ERASED: u8 = 0xFF;

/// Commands.
mod command {
    pub const GET_SYNC: u8 = b'0';
    pub const ENTER_PROGMODE: u8 = b'P';
    pub const LEAVE_PROGMODE: u8 = b'Q';
    pub const LOAD_ADDRESS: u8 = b'U';
    pub const PROG_PAGE: u8 = b'd';
    pub const READ_PAGE: u8 = b't';
    pub const READ_SIGN: u8 = b'u';
}
/// Memory of PROG_PAGE and READ_PAGE.
const FLASH: u8 = b'F';
/// End of a command.
const CRC_EOP: u8 = b' ';
/// Begin and end of an answer.
const INSYNC: u8 = 0x14;
const OK: u8 = 0x10;

/// Time from the reset to the first GET_SYNC. Arduino's fuses hold the chip for 65 ms; what the old
/// program has sent arrives meanwhile, too.
const START_MS: u64 = 150;
/// Time for an answer to GET_SYNC. A bootloader first blinks, Optiboot 4.4 for 375 ms, and its UART
/// keeps three bytes meanwhile: a second GET_SYNC in this time would be cut, and Optiboot leaves at
/// a command without its end.
const SYNC_MS: u64 = 500;
/// Tries until the board counts as silent.
const SYNC_TRIES: u32 = 5;
/// Late answers to earlier tries arrive in this time.
const SETTLE_MS: u64 = 100;
/// An answer to any other command. Pages take 9 ms to write, and 70 ms to read at 19,200 baud.
const ANSWER_MS: u64 = 3000;
/// The same after "Cancel".
const CANCEL_MS: u64 = 500;
/// The answer to LEAVE_PROGMODE may be cut off by the restart.
const LEAVE_MS: u64 = 200;

/// What is in the way of an upload.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Failure {
    /// Nothing has answered.
    Silence,
    /// Something has answered, but no bootloader.
    NoBootloader,
    /// The chip is not the one of the chosen board.
    OtherChip { signature: [u8; 3], wanted: Chip },
    /// The bootloader has stopped to answer.
    Stopped,
    /// The bootloader has answered something else than expected.
    OutOfStep { got: Vec<u8> },
    /// The flash has other bytes than those written.
    NotWritten { address: usize },
    /// The user has cancelled.
    Cancelled,
}

/// Titles of the boards with a chip, as in "Arduino Uno, Arduino Nano".
fn boards_with(chip: Chip) -> String {
    let of_chip = |name: &&str| boards::text(boards::entry("boards", name), "chip") == chip.name();
    let titles: Vec<&str> = boards::names("boards")
        .filter(of_chip)
        .map(|name| boards::text(boards::entry("boards", name), "title"))
        .collect();
    titles.join(", ")
}

/// Baud rates of the bootloaders of all boards, as in "19200, 57600 and 115200".
fn baud_rates() -> String {
    let rate = |name| boards::number(boards::entry("boards", name), "upload_baud");
    let rates: BTreeSet<u32> = boards::names("boards").map(rate).collect();
    let rates: Vec<String> = rates.iter().map(u32::to_string).collect();
    match rates.split_last() {
        Some((last, others @ [_, ..])) => format!("{} and {last}", others.join(", ")),
        _ => rates.concat(),
    }
}

/// Chip and boards of a signature, in words.
pub fn describe_signature(signature: [u8; 3]) -> String {
    if let Some(chip) = Chip::ALL.into_iter().find(|chip| chip.signature() == signature) {
        return format!("an {chip} ({})", boards_with(chip));
    }
    // Signatures of avrdude.conf.
    let name = match signature {
        [0x1E, 0x93, 0x07] => "ATmega8 (Arduino NG)",
        [0x1E, 0x94, 0x0B] => "ATmega168P",
        [0x1E, 0x95, 0x14] => "ATmega328 without P",
        [0x1E, 0x95, 0x16] => "ATmega328PB",
        [0x1E, 0x95, 0x87] => "ATmega32U4 (Arduino Leonardo, Micro)",
        [0x1E, 0x97, 0x03] => "ATmega1280 (Arduino Mega)",
        [0x1E, 0x98, 0x01] => "ATmega2560 (Arduino Mega 2560)",
        [a, b, c] => return format!("another chip, with the signature {a:02X}{b:02X}{c:02X}"),
    };
    format!("an {name}")
}

/// What happened, and what to do.
impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Failure::Silence => f.write_str(
                "Nothing answers. Is this the board's port, and the board the one that is chosen? \
                 A Pro Mini or an adapter without DTR: press the reset button and choose Flash at \
                 the same moment. Wires at D0 and D1 have to be off.",
            ),
            Failure::NoBootloader => write!(
                f,
                "Something answers, but no bootloader at {} baud. Is it the board's port? Press \
                 \"Another port\" if not. Else flash again, and press the board's reset button \
                 once as the bar begins. Is it an Arduino of the list? Else the board has no \
                 bootloader, and a programmer burns it: \
                 https://docs.arduino.cc/built-in-examples/arduino-isp/",
                baud_rates()
            ),
            Failure::OtherChip { signature, wanted } => write!(
                f,
                "The board has {}, and the program is for an {wanted} ({}). Choose the board that \
                 it is.",
                describe_signature(*signature),
                boards_with(*wanted)
            ),
            Failure::Stopped => f.write_str(
                "The board has stopped to answer: it was reset, or the cable or its supply is \
                 loose. Flash again.",
            ),
            Failure::OutOfStep { got } => {
                f.write_str("The bootloader has answered something unexpected (")?;
                for byte in got.iter().take(8) {
                    write!(f, "{byte:02X}")?;
                }
                f.write_str("): bytes were lost or disturbed. Flash again, with a shorter cable.")
            }
            Failure::NotWritten { address } => write!(
                f,
                "The flash has other bytes at {address:#06X} than those that were written: bytes \
                 were disturbed, or the flash is worn or locked. Flash again."
            ),
            Failure::Cancelled => f.write_str("Cancelled."),
        }
    }
}

/// What the flash has at the end of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flash {
    /// Nothing was written.
    Unchanged,
    /// The first page is being written: it may have the old program, the new one, or neither.
    Doubtful,
    /// A program that does nothing, in the place of the old one.
    Idle,
    /// The new program, complete and read back.
    New,
}

/// A command that waits for its answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Start,
    Sync { tries: u32 },
    Settle { tries: u32 },
    Confirm { tries: u32 },
    Signature,
    Enter,
    Address { job: usize },
    Page { job: usize },
    Leave,
    Ended,
}

/// What is done with a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Action {
    Write,
    Compare,
}

/// What a user wants to see of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    Connecting,
    Writing,
    Comparing,
    Ended,
}

/// One session with a bootloader: an upload, or only a look at the chip.
pub struct Session {
    chip: Chip,
    /// Whole pages; empty for a look at the chip.
    program: Vec<u8>,
    step: Step,
    output: Vec<u8>,
    input: Vec<u8>,
    /// True if anything has arrived.
    heard: bool,
    deadline: u64,
    signature: Option<[u8; 3]>,
    flash: Flash,
    is_cancelled: bool,
    failure: Option<Failure>,
}

impl Session {
    /// Begins an upload to a board that was reset now. `program` begins at address 0, and fits
    /// [`capacity`].
    pub fn upload(chip: Chip, program: &[u8], now: u64) -> Session {
        let mut pages = program.to_vec();
        pages.resize(program.len().next_multiple_of(PAGE), ERASED);
        Session::begin(chip, pages, now)
    }

    /// Asks a board that was reset now for its chip.
    pub fn identify(now: u64) -> Session {
        Session::begin(Chip::default(), Vec::new(), now)
    }

    fn begin(chip: Chip, program: Vec<u8>, now: u64) -> Session {
        Session {
            chip,
            program,
            step: Step::Start,
            output: Vec::new(),
            input: Vec::new(),
            heard: false,
            deadline: now + START_MS,
            signature: None,
            flash: Flash::Unchanged,
            is_cancelled: false,
            failure: None,
        }
    }

    /// Bytes to send now.
    pub fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.output)
    }

    /// Time until the next call of [`Session::receive`] at the latest, with or without bytes.
    pub fn wait_ms(&self, now: u64) -> u64 {
        self.deadline.saturating_sub(now)
    }

    /// Takes bytes that have arrived, and goes on as far as they allow.
    pub fn receive(&mut self, bytes: &[u8], now: u64) {
        self.heard |= !bytes.is_empty();
        if self.step != Step::Ended {
            self.input.extend(bytes);
            self.advance(now);
        }
    }

    /// Ends the session as soon as the present command is answered: a reset in the middle of a page
    /// would leave it erased. When only the first page is left, the upload is completed.
    pub fn cancel(&mut self, now: u64) {
        match self.step {
            Step::Start | Step::Sync { .. } | Step::Settle { .. } | Step::Confirm { .. } => {
                self.fail(Failure::Cancelled);
            }
            Step::Address { job } | Step::Page { job } if job + 2 >= self.jobs() => {}
            Step::Leave | Step::Ended => {}
            _ => {
                self.is_cancelled = true;
                self.deadline = self.deadline.min(now + CANCEL_MS);
            }
        }
    }

    pub fn is_ended(&self) -> bool {
        self.step == Step::Ended
    }

    /// What was in the way, at the end.
    pub fn failure(&self) -> Option<&Failure> {
        self.failure.as_ref()
    }

    /// What the flash has, at the end.
    pub fn flash(&self) -> Flash {
        self.flash
    }

    /// The signature of the chip, as soon as it is known.
    pub fn signature(&self) -> Option<[u8; 3]> {
        self.signature
    }

    /// The chip of that signature, if it is one of ours.
    pub fn chip_found(&self) -> Option<Chip> {
        Chip::ALL.into_iter().find(|chip| Some(chip.signature()) == self.signature)
    }

    pub fn phase(&self) -> Phase {
        match self.step {
            Step::Address { job } | Step::Page { job } => match self.job(job).0 {
                Action::Write => Phase::Writing,
                Action::Compare => Phase::Comparing,
            },
            Step::Leave => Phase::Comparing,
            Step::Ended => Phase::Ended,
            _ => Phase::Connecting,
        }
    }

    /// Pages that are done, and all: each is written and compared.
    pub fn progress(&self) -> (usize, usize) {
        let done = match self.step {
            Step::Address { job } | Step::Page { job } => job,
            Step::Leave | Step::Ended => self.jobs(),
            _ => 0,
        };
        (done, self.jobs())
    }

    fn pages(&self) -> usize {
        self.program.len() / PAGE
    }

    /// Each page is written and compared, and the first one twice.
    fn jobs(&self) -> usize {
        if self.program.is_empty() { 0 } else { 2 * self.pages() + 2 }
    }

    /// What is done, and to which page, in the order that the module's documentation has.
    fn job(&self, number: usize) -> (Action, usize) {
        let others = self.pages() - 1;
        match number {
            0 => (Action::Write, 0),
            1 => (Action::Compare, 0),
            _ if number < 2 + others => (Action::Write, number - 1),
            _ if number < 2 + 2 * others => (Action::Compare, number - 1 - others),
            _ if number == 2 + 2 * others => (Action::Write, 0),
            _ => (Action::Compare, 0),
        }
    }

    /// The bytes that the page of a job has then.
    fn bytes_of(&self, job: usize) -> Vec<u8> {
        if job < 2 {
            let mut page = vec![ERASED; PAGE];
            page[..IDLE.len()].copy_from_slice(&IDLE);
            return page;
        }
        let start = self.job(job).1 * PAGE;
        self.program[start..start + PAGE].to_vec()
    }

    fn send(&mut self, command: u8, parameters: &[u8], step: Step, now: u64) {
        self.input.clear();
        self.output.push(command);
        self.output.extend(parameters);
        self.output.push(CRC_EOP);
        self.step = step;
        self.deadline = now + ANSWER_MS;
    }

    fn sync(&mut self, tries: u32, now: u64) {
        if tries == SYNC_TRIES {
            let failure = if self.heard { Failure::NoBootloader } else { Failure::Silence };
            self.fail(failure);
            return;
        }
        self.send(command::GET_SYNC, &[], Step::Sync { tries: tries + 1 }, now);
        self.deadline = now + SYNC_MS;
    }

    fn fail(&mut self, failure: Failure) {
        self.failure = Some(failure);
        self.end();
    }

    fn end(&mut self) {
        self.step = Step::Ended;
        self.output.clear();
        self.input.clear();
    }

    fn advance(&mut self, now: u64) {
        match self.step {
            Step::Start => {
                self.input.clear();
                if now >= self.deadline {
                    self.sync(0, now);
                }
            }
            Step::Sync { tries } => {
                // The old program's lines may come first.
                if self.input.ends_with(&[INSYNC, OK]) {
                    self.step = Step::Settle { tries };
                    self.deadline = now + SETTLE_MS;
                } else if now >= self.deadline {
                    self.sync(tries, now);
                } else {
                    let old = self.input.len().saturating_sub(1);
                    self.input.drain(..old);
                }
            }
            Step::Settle { tries } => {
                self.input.clear();
                if now >= self.deadline {
                    self.send(command::GET_SYNC, &[], Step::Confirm { tries }, now);
                    self.deadline = now + SYNC_MS;
                }
            }
            Step::Confirm { tries } => {
                if self.input == [INSYNC, OK] {
                    self.send(command::READ_SIGN, &[], Step::Signature, now);
                } else if self.input.len() >= 2 || now >= self.deadline {
                    self.sync(tries, now);
                }
            }
            Step::Leave if self.input.len() >= 2 || now >= self.deadline => self.end(),
            Step::Leave | Step::Ended => {}
            _ => self.expect(now),
        }
    }

    /// Waits for the whole answer of a command.
    fn expect(&mut self, now: u64) {
        let parameters = match self.step {
            Step::Signature => 3,
            Step::Page { job } if self.job(job).0 == Action::Compare => PAGE,
            _ => 0,
        };
        let whole = self.input.len() == parameters + 2;
        let is_wrong = self.input.first().is_some_and(|first| *first != INSYNC)
            || self.input.len() > parameters + 2
            || whole && self.input.last() != Some(&OK);
        if is_wrong {
            let got = std::mem::take(&mut self.input);
            self.fail(Failure::OutOfStep { got });
        } else if whole {
            let answer = self.input[1..=parameters].to_vec();
            self.answered(&answer, now);
        } else if now >= self.deadline {
            self.fail(if self.is_cancelled { Failure::Cancelled } else { Failure::Stopped });
        }
    }

    fn answered(&mut self, answer: &[u8], now: u64) {
        if self.is_cancelled {
            self.fail(Failure::Cancelled);
            return;
        }
        match self.step {
            Step::Signature => {
                let signature = [answer[0], answer[1], answer[2]];
                self.signature = Some(signature);
                if self.program.is_empty() {
                    self.leave(now);
                } else if signature == self.chip.signature() {
                    self.send(command::ENTER_PROGMODE, &[], Step::Enter, now);
                } else {
                    self.fail(Failure::OtherChip { signature, wanted: self.chip });
                }
            }
            Step::Enter => self.load_address(0, now),
            Step::Address { job } => self.page(job, now),
            Step::Page { job } => {
                let (action, page) = self.job(job);
                let expected = self.bytes_of(job);
                if action == Action::Compare && answer != expected {
                    let first = answer.iter().zip(&expected).position(|(a, b)| a != b);
                    let address = page * PAGE + first.unwrap_or_default();
                    self.fail(Failure::NotWritten { address });
                    return;
                }
                match job {
                    1 => self.flash = Flash::Idle,
                    _ if job + 1 == self.jobs() => self.flash = Flash::New,
                    _ => {}
                }
                if job + 1 < self.jobs() {
                    self.load_address(job + 1, now);
                } else {
                    self.leave(now);
                }
            }
            _ => self.end(),
        }
    }

    fn leave(&mut self, now: u64) {
        self.send(command::LEAVE_PROGMODE, &[], Step::Leave, now);
        self.deadline = now + LEAVE_MS;
    }

    fn load_address(&mut self, job: usize, now: u64) {
        // The address counts words.
        let words = (self.job(job).1 * PAGE / 2) as u16;
        self.send(command::LOAD_ADDRESS, &words.to_le_bytes(), Step::Address { job }, now);
    }

    fn page(&mut self, job: usize, now: u64) {
        // The length has its most significant byte first.
        let [high, low] = (PAGE as u16).to_be_bytes();
        let mut parameters = vec![high, low, FLASH];
        let command = match self.job(job).0 {
            Action::Write => {
                if self.job(job).1 == 0 {
                    self.flash = Flash::Doubtful;
                }
                parameters.extend(self.bytes_of(job));
                command::PROG_PAGE
            }
            Action::Compare => command::READ_PAGE,
        };
        self.send(command, &parameters, Step::Page { job }, now);
    }
}

/// Bytes that a program may have: what is below a boot section of 2,048 bytes, as ATmegaBOOT and
/// the loader of `boot/` have it.
pub fn capacity(chip: Chip) -> usize {
    chip.flash_bytes() - 2048
}

/// What the flash has now, for the user.
impl fmt::Display for Flash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Flash::Unchanged => "The program of the board is as it was.",
            Flash::Doubtful => {
                "The first page of the program is not checked: switch the supply of servos and \
                 motors off, and flash again."
            }
            Flash::Idle => "The board has no program now, and does nothing until you flash it.",
            Flash::New => "The board has the new program, and it was read back.",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGES: usize = 3;
    /// Commands before the third page is written: two GET_SYNC, READ_SIGN, ENTER_PROGMODE, four for
    /// the first page, and an address.
    const BEFORE_A_PAGE: usize = 9;

    /// Answers as the bootloaders do with which `tests/upload.rs` has whole uploads and cut ones.
    struct Bootloader {
        flash: [[u8; PAGE]; PAGES],
        page: usize,
        /// Writes this byte of each page wrongly.
        worn: Option<usize>,
    }

    impl Bootloader {
        fn new() -> Bootloader {
            Bootloader { flash: [[ERASED; PAGE]; PAGES], page: 0, worn: None }
        }

        fn answer(&mut self, command: &[u8]) -> Vec<u8> {
            let mut answer = vec![INSYNC];
            match *command {
                [command::LOAD_ADDRESS, low, high, CRC_EOP] => {
                    self.page = 2 * usize::from(u16::from_le_bytes([low, high])) / PAGE;
                }
                [command::PROG_PAGE, _, _, FLASH, ref bytes @ .., CRC_EOP] => {
                    self.flash[self.page].copy_from_slice(bytes);
                    if let Some(worn) = self.worn.filter(|_| self.page > 0) {
                        self.flash[self.page][worn] ^= 1;
                    }
                }
                [command::READ_PAGE, ..] => answer.extend(self.flash[self.page]),
                [command::READ_SIGN, ..] => answer.extend(Chip::Atmega328p.signature()),
                _ => {}
            }
            answer.push(OK);
            answer
        }
    }

    /// Runs a session until it ends or this number of commands was answered.
    fn run(session: &mut Session, bootloader: &mut Bootloader, commands: usize) {
        let (mut now, mut answered) = (0, 0);
        while !session.is_ended() && answered < commands {
            let output = session.take_output();
            let mut answer = Vec::new();
            if !output.is_empty() {
                answer = bootloader.answer(&output);
                answered += 1;
            }
            now += if answer.is_empty() { session.wait_ms(now).max(1) } else { 1 };
            session.receive(&answer, now);
        }
    }

    /// A session that waits for the answer to the write of the third page.
    fn at_a_page() -> Session {
        let mut session = upload();
        run(&mut session, &mut Bootloader::new(), BEFORE_A_PAGE);
        session.take_output();
        session
    }

    fn upload() -> Session {
        Session::upload(Chip::Atmega328p, &[0x5A; PAGES * PAGE - 30], 0)
    }

    #[test]
    fn a_byte_that_was_not_written_is_found_before_the_program_can_start() {
        let mut bootloader = Bootloader { worn: Some(5), ..Bootloader::new() };
        let mut session = upload();
        run(&mut session, &mut bootloader, usize::MAX);
        assert_eq!(session.failure(), Some(&Failure::NotWritten { address: PAGE + 5 }));
        assert_eq!(session.flash(), Flash::Idle);
        assert!(bootloader.flash[0].starts_with(&IDLE));
    }

    #[test]
    fn cancel_waits_for_the_page_and_ends_then() {
        let mut session = at_a_page();
        session.cancel(0);
        assert!(!session.is_ended());
        session.receive(&[INSYNC, OK], 1);
        assert_eq!(session.failure(), Some(&Failure::Cancelled));
        assert_eq!(session.flash(), Flash::Idle);
    }

    /// Runs a session without a bootloader to its end. Returns it and the time.
    fn alone(answer: &[u8]) -> (Session, u64) {
        let (mut session, mut now) = (upload(), 0);
        while !session.is_ended() {
            session.take_output();
            now += session.wait_ms(now).max(1);
            session.receive(answer, now);
            assert!(now < 10_000);
        }
        (session, now)
    }

    #[test]
    fn silence_and_lines_of_a_program_are_told_apart() {
        let (session, now) = alone(&[]);
        assert_eq!(session.failure(), Some(&Failure::Silence));
        assert!(now > 2000, "{now} ms");
        assert_eq!(alone(b"temperature +20").0.failure(), Some(&Failure::NoBootloader));
    }

    #[test]
    fn lines_of_the_old_program_do_not_disturb_the_begin() {
        let mut session = upload();
        session.receive(b"DroneCAN servo node", 1);
        session.receive(&[INSYNC, OK], 2);
        assert!(session.take_output().is_empty(), "the board starts");
        session.receive(b"servo", START_MS);
        assert_eq!(session.take_output(), [command::GET_SYNC, CRC_EOP]);
        session.receive(b" node", START_MS + 1);
        session.receive(&[INSYNC], START_MS + 2);
        session.receive(&[OK], START_MS + 3);
        // The answer to an earlier try.
        session.receive(&[INSYNC, OK], START_MS + 50);
        run(&mut session, &mut Bootloader::new(), usize::MAX);
        assert_eq!(session.flash(), Flash::New);
    }

    #[test]
    fn a_board_that_stops_or_answers_nonsense_ends_the_session() {
        let mut session = at_a_page();
        session.receive(&[], ANSWER_MS + 10_000);
        assert_eq!(session.failure(), Some(&Failure::Stopped));
        for nonsense in [&[0x15][..], &[INSYNC, 0x11], &[INSYNC, OK, OK]] {
            let mut session = at_a_page();
            session.receive(nonsense, 1);
            assert!(matches!(session.failure(), Some(Failure::OutOfStep { .. })));
        }
    }
}
