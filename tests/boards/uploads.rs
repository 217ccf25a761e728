//! Uploads through the serial port and the bootloader, cut at each page.

use bench::avr::{Firmware, ResetCause};
use bench::{firmware, node_elf};

use crate::support::update_bench::*;

const PAGE: usize = 128;

/// Commands and answers of STK500 version 1 (Atmel application note AVR061).
const GET_SYNC: u8 = 0x30;
const LOAD_ADDRESS: u8 = 0x55;
const PROG_PAGE: u8 = 0x64;
const LEAVE: u8 = 0x51;
const END: u8 = 0x20;
const ANSWER: [u8; 2] = [0x14, 0x10];

/// The flash of a program that no update has written: `default` where updates are of `remote`.
fn other_program() -> Vec<u8> {
    let elf = if elf() == node_elf().expect("a preset") { firmware("default") } else { node_elf() };
    let program = elf.and_then(|elf| Firmware::read(&elf)).unwrap_or_else(|e| panic!("{e:#}"));
    let mut flash: Vec<u8> = Vec::new();
    for (address, bytes) in program.flash {
        flash.resize(address, 0);
        flash.extend(bytes);
    }
    flash
}

impl UpdateBench {
    /// Sends a command, and waits for its answer.
    #[track_caller]
    fn command(&mut self, command: &[u8]) {
        let avr = self.bench.board(0).avr_mut();
        avr.serial_take();
        avr.serial_send(&[command, &[END]].concat());
        let mut answer: Vec<u8> = Vec::new();
        let end = self.now_ms() + 200;
        while answer.len() < ANSWER.len() {
            assert!(self.now_ms() < end, "no answer to {:#04X}, only {answer:?}", command[0]);
            self.step();
            answer.extend(self.bench.board(0).avr_mut().serial_take().iter().map(|(_, byte)| byte));
        }
        assert_eq!(answer, ANSWER, "{:#04X}", command[0]);
    }

    /// Begins an upload as avrdude does: it opens the port, which resets the chip.
    #[track_caller]
    fn begin_upload(&mut self) {
        self.bench.board(0).reset(ResetCause::External);
        self.bench.board(0).take_violations();
        self.run_ms(1);
        self.command(&[GET_SYNC]);
    }

    #[track_caller]
    fn upload_page(&mut self, address: usize, page: &[u8]) {
        let [low, high] = (address as u16 / 2).to_le_bytes();
        self.command(&[LOAD_ADDRESS, low, high]);
        self.command(&[&[PROG_PAGE, 0, PAGE as u8, b'F'], page].concat());
    }

    /// Switches the power off and on. Returns true if a program starts then.
    fn starts_after_power_cut(&mut self) -> bool {
        self.cut_power();
        self.bench.board(0).take_servo_pulses();
        let flash_len = board().chip.flash_bytes();
        // The check of a program takes 5.6 ms for 1,000 bytes.
        let end = self.now_ms() + flash_len as u64 / 128;
        let boot_section = flash_len as u32 - 2048;
        while self.now_ms() < end {
            self.step();
            if self.bench.board(0).avr().pc() < boot_section {
                // It reads why the chip was reset.
                self.run_ms(1);
                return true;
            }
        }
        assert_eq!(self.bench.board(0).take_servo_pulses().len(), 0);
        false
    }
}

/// Uploads `new` to a board with `old`, and cuts the power in each page: before it, when it is
/// erased, and in the middle of its write. Returns the number of cuts after which nothing started.
fn cut_at_each_page(old: &[u8], new: &[u8]) -> usize {
    let mut bench = UpdateBench::with(&[(0, old.to_vec())], &[], board().fastest_bit_rate());
    let padded = |program: &[u8]| {
        let mut pages = program.to_vec();
        pages.resize(program.len().next_multiple_of(PAGE), 0xFF);
        pages
    };
    let new_pages = padded(new);
    let mut waits = 0;
    for (number, page) in new_pages.chunks(PAGE).enumerate() {
        let address = number * PAGE;
        let before = bench.flash(address + PAGE)[address..].to_vec();
        let half = [&page[..PAGE / 2], &[0xFF; PAGE / 2]].concat();
        for state in [&before[..], &[0xFF; PAGE], &half] {
            bench.bench.board(0).avr_mut().load_flash(address, state);
            let starts = bench.starts_after_power_cut();
            let is_whole = [old, new].iter().any(|program| bench.flash(program.len()) == **program);
            assert_eq!(starts, is_whole, "cut at page {number} of {}", new_pages.len() / PAGE);
            waits += usize::from(!starts);
        }
        bench.begin_upload();
        bench.upload_page(address, page);
    }
    bench.command(&[LEAVE]);
    bench.wait_for_program(3000);
    assert!(bench.flash(new.len()) == new, "the program in flash is the new one");
    waits
}

#[test]
#[ignore = "takes long: the next test cuts at each page, too"]
fn an_upload_that_is_cut_at_any_page_never_runs_a_mixture() {
    let (one, other) = (file(), other_program());
    for (old, new) in [(&one, &other), (&other, &one)] {
        let waits = cut_at_each_page(old, new);
        println!("{} to {} bytes: {waits} cuts left no program", old.len(), new.len());
        assert!(waits >= 3 * (new.len() / PAGE - 1), "{waits}");
    }
}

/// The versions have the same length, and differ in one byte of two pages and in the header.
#[test]
#[ignore = "takes long: make test-all"]
fn an_upload_of_nearly_the_same_program_never_runs_a_mixture() {
    let old = file();
    let mut new = old.clone();
    // Letters of names, which are no code.
    let places = ["TEMP_RATE", "FS_PWM"].map(|name| {
        let name = name.as_bytes();
        old.windows(name.len()).position(|bytes| bytes == name).expect("the name of a parameter")
    });
    assert_ne!(places[0] / PAGE, places[1] / PAGE);
    for at in places {
        new[at] ^= 1;
    }
    cut_at_each_page(&old, &with_crc(new));
}

/// avrdude has ended or its cable is out: the watchdog ends the session.
#[test]
fn after_a_cut_upload_the_bootloader_waits_and_the_next_upload_starts() {
    let mut bench = UpdateBench::with_program();
    bench.wait_for_program(1500);
    let new = other_program();
    bench.begin_upload();
    for (number, page) in new.chunks(PAGE).take(20).enumerate() {
        bench.upload_page(number * PAGE, page);
    }
    bench.run_ms(1500);
    assert_eq!(bench.next_mode(), MAINTENANCE);
    let info = bench.call(GET_NODE_INFO, &[]);
    assert_eq!(info[7..22], [0; 15], "version and CRC of no program");
    bench.begin_upload();
    for (number, page) in new.chunks(PAGE).enumerate() {
        let mut page = page.to_vec();
        page.resize(PAGE, 0xFF);
        bench.upload_page(number * PAGE, &page);
    }
    bench.command(&[LEAVE]);
    bench.wait_for_program(3000);
}
