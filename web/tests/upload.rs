//! Uploads of `stk500` through the bootloaders of Arduino and of this project on a simulated chip,
//! whole and cut.

use std::path::PathBuf;
use std::process::Command;
use std::sync::LazyLock;

use bench::avr::{Avr, Chip, Firmware, ResetCause, State};
use bench::wiring::Wiring;
use bench::{Cycles, F_CPU_HZ, firmware_for};
use dronecan_wire::crc;
use web::program_file;
use web::stk500::{Failure, Flash, PAGE, Session};

const MS: Cycles = F_CPU_HZ / 1000;
/// ATmegaBOOT starts the program when it has waited for an upload.
const ATMEGABOOT_MS: u64 = 2000;
/// Optiboot starts it at once after a power-on, our loader after a look at its CRC.
const AT_ONCE_MS: u64 = 200;
/// Debian's arduino-core-avr.
const BOOTLOADERS: &str = "/usr/share/arduino/hardware/arduino/avr/bootloaders";

fn arduino(file: &str) -> Firmware {
    let path = PathBuf::from(BOOTLOADERS).join(file);
    assert!(path.exists(), "{} is missing: make setup-test installs it", path.display());
    Firmware::read_hex(&path).expect("a bootloader")
}

/// Optiboot of the Uno.
static OPTIBOOT: LazyLock<Firmware> = LazyLock::new(|| {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../scripts/optiboot");
    let done = Command::new(script).output().expect("a script");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let path = PathBuf::from(String::from_utf8_lossy(&done.stdout).trim_end());
    Firmware::read_hex(&path).expect("a bootloader")
});

/// A chip with a bootloader, and its serial port.
struct Target {
    avr: Avr,
    boot: usize,
}

impl Target {
    fn new(chip: Chip, loader: &Firmware, program: &[u8]) -> Target {
        let mut avr = Avr::programmed(chip, &Firmware::default()).expect("an empty chip");
        avr.load_flash(0, program);
        avr.install_bootloader(loader).expect("a bootloader for the chip");
        avr.reset(ResetCause::PowerOn);
        let boot = loader.boot_section(chip).expect("a boot section");
        let mut target = Target { avr, boot };
        // Bootloaders tell this reset from that of the serial port.
        target.run_ms(10);
        target
    }

    fn now_ms(&self) -> u64 {
        self.avr.now() / MS
    }

    fn run_ms(&mut self, ms: u64) {
        let state = self.avr.run_until(self.avr.now() + ms * MS);
        assert_eq!(state, State::Running);
    }

    /// Runs a session, after a reset, until it ends or `bytes` have been sent. Returns the session
    /// and the bytes that were sent.
    fn run(&mut self, begin: impl Fn(u64) -> Session, bytes: usize) -> (Session, usize) {
        self.avr.serial_discard();
        self.avr.reset(ResetCause::External);
        self.avr.serial_take();
        let mut session = begin(self.now_ms());
        let mut sent = 0;
        while !session.is_ended() && sent < bytes {
            let mut output = session.take_output();
            output.truncate(bytes - sent);
            sent += output.len();
            self.avr.serial_send(&output);
            self.run_ms(1);
            let answer: Vec<u8> = self.avr.serial_take().iter().map(|(_, byte)| *byte).collect();
            session.receive(&answer, self.now_ms());
        }
        // What was sent before a cut still arrives.
        self.run_ms(30);
        self.avr.serial_discard();
        (session, sent)
    }

    fn has(&self, program: &[u8]) -> bool {
        self.avr.flash().starts_with(program)
    }

    /// Switches the power off and on, and waits. True if the chip is then in its bootloader or in
    /// the jump to itself.
    fn does_nothing(&mut self, wait_ms: u64) -> bool {
        self.avr.reset(ResetCause::PowerOn);
        self.run_ms(wait_ms);
        (0..20).all(|_| {
            self.avr.run_until(self.avr.now() + 997);
            let pc = self.avr.pc() as usize;
            pc == 0 || pc >= self.boot
        })
    }
}

fn upload(chip: Chip, program: &[u8]) -> impl Fn(u64) -> Session {
    move |now| Session::upload(chip, program, now)
}

/// The program of a board as the page has it.
fn program(board: &str, preset: &str) -> Vec<u8> {
    let elf = firmware_for(board, "seeed", preset).expect("the firmware");
    let file = std::fs::read(elf.with_extension("bin")).expect("the file of the firmware");
    program_file::read(&file, board, "seeed").expect("a program for the board")
}

/// Uploads a program of this project to a chip with a bootloader, and checks that it runs.
#[track_caller]
fn whole(board: &str, preset: &str, loader: &Firmware) {
    let wiring = Wiring::of(board, "seeed").expect("a board");
    let program = program(board, preset);
    let mut target = Target::new(wiring.chip, loader, &[]);
    let begin = target.now_ms();
    let (session, _) = target.run(upload(wiring.chip, &program), usize::MAX);
    println!("{board} {preset}: {} bytes in {} ms", program.len(), target.now_ms() - begin);
    assert_eq!((session.failure(), session.flash()), (None, Flash::New));
    assert!(target.has(&program));
    assert!(!target.does_nothing(ATMEGABOOT_MS), "the program runs");
}

#[test]
fn a_program_is_uploaded_through_the_diecimilas_bootloader() {
    whole("diecimila", "default", &arduino("atmega/ATmegaBOOT_168_diecimila.hex"));
}

#[test]
fn a_program_is_uploaded_through_the_old_nanos_bootloader() {
    whole("uno", "full", &arduino("atmega/ATmegaBOOT_168_atmega328.hex"));
}

#[test]
fn a_program_is_uploaded_through_optiboot() {
    whole("uno", "full", &OPTIBOOT);
}

#[test]
fn a_program_is_uploaded_through_our_loader() {
    let path = bench::bootloader(&Wiring::of("uno", "seeed").expect("a board"))
        .expect("make boot built it");
    whole("uno", "full", &Firmware::read_hex(&path).expect("a bootloader"));
}

#[test]
fn another_chip_is_refused_and_not_written() {
    let old = [0; 4 * PAGE];
    let loader = arduino("atmega/ATmegaBOOT_168_diecimila.hex");
    let mut target = Target::new(Chip::Atmega168, &loader, &old);
    let (session, _) = target.run(upload(Chip::Atmega328p, &[1; 300]), usize::MAX);
    let signature = Chip::Atmega168.signature();
    let wanted = Chip::Atmega328p;
    assert_eq!(session.failure(), Some(&Failure::OtherChip { signature, wanted }));
    assert!(target.has(&old) && session.flash() == Flash::Unchanged);
}

/// A program that clears MCUSR and then repeats an instruction, with the header that our loader
/// checks (docs/update.md). It runs whatever page it begins in.
fn repeated(instruction: u16) -> Vec<u8> {
    const PAGES: usize = 10;
    let mut program = instruction.to_le_bytes().repeat(PAGES * PAGE / 2);
    // EOR r1, r1; OUT MCUSR, r1; and a jump over the header, to the second page.
    for (word, opcode) in [0x2411_u16, 0xBE14, 0xC03D].into_iter().enumerate() {
        program[2 * word..][..2].copy_from_slice(&opcode.to_le_bytes());
    }
    // Hardware version, version of the program, length.
    let [low, high] = (program.len() as u16).to_le_bytes();
    program[0x68..0x6E].copy_from_slice(&[2, 0, 2, 0, low, high]);
    // A jump back over 30 instructions, and what makes the CRC of all 0: the CRC of the rest.
    let end = program.len() - 4;
    program[end..end + 2].copy_from_slice(&0xCFE0_u16.to_le_bytes());
    let crc = program[..end + 2].iter().fold(0xFFFF, |crc, byte| crc::step(crc, *byte));
    program[end + 2..].copy_from_slice(&crc.to_be_bytes());
    program
}

/// Cuts an upload at each of 21 points, and then uploads again. After a power-on the bootloader
/// starts a program within `start_ms`.
#[track_caller]
fn cut(loader: &Firmware, start_ms: u64) {
    const CUTS: usize = 21;
    let chip = Chip::Atmega328p;
    // NOP and INC r24.
    let (old, new) = (repeated(0x0000), repeated(0x9583));
    let (_, all) = Target::new(chip, loader, &old).run(upload(chip, &new), usize::MAX);
    let mut idle = 0;
    for number in 0..CUTS {
        let mut target = Target::new(chip, loader, &old);
        let bytes = all * (2 * number + 1) / (2 * CUTS);
        target.run(upload(chip, &new), bytes);
        let is_idle = target.does_nothing(start_ms);
        idle += usize::from(is_idle);
        // Optiboot erases the first page before it has its bytes.
        let flash = target.avr.flash();
        let erased = flash[..PAGE] == [0xFF; PAGE];
        let is_whole = |program: &[u8]| {
            flash[PAGE..].starts_with(&program[PAGE..])
                && (erased || flash.starts_with(&program[..PAGE]))
        };
        assert!(
            is_idle || is_whole(&old) || is_whole(&new),
            "a mixture runs after a cut at byte {bytes} of {all}: {:02X?}",
            &flash[..PAGE + 4]
        );
        let (session, _) = target.run(upload(chip, &new), usize::MAX);
        assert_eq!((session.failure(), session.flash()), (None, Flash::New));
        assert!(target.has(&new) && !target.does_nothing(start_ms));
    }
    println!("{idle} of {CUTS} cuts left a board that does nothing");
    assert!(idle > CUTS / 2, "{idle}");
}

#[test]
fn no_mixture_runs_after_a_cut_with_the_old_nanos_bootloader() {
    cut(&arduino("atmega/ATmegaBOOT_168_atmega328.hex"), ATMEGABOOT_MS);
}

#[test]
fn no_mixture_runs_after_a_cut_with_our_loader() {
    let path = bench::bootloader(&Wiring::of("uno", "seeed").expect("a board"));
    let loader = Firmware::read_hex(&path.expect("make boot built it")).expect("a bootloader");
    cut(&loader, AT_ONCE_MS);
}

#[test]
fn no_mixture_runs_after_a_cut_with_optiboot() {
    cut(&OPTIBOOT, AT_ONCE_MS);
}
