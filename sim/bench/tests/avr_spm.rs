//! Tests of self-programming with bootloaders. Each test has the steps of its bootloader in C.

use crate::avr::{
    MS, assert_no_violation, assert_one_violation, bootloader_for, byte, bytes, firmware_for,
    with_firmware,
};
use bench::avr::{Avr, Chip, Halt, PAGE_BYTES, PAGE_PROGRAMMING_CYCLES, ResetCause, Resume, State};

const SPMIE: u8 = 1 << 7;
const RWWSB: u8 = 1 << 6;
const PGWRT: u8 = 1 << 2;
const PGERS: u8 = 1 << 1;
const SELFPRGEN: u8 = 1 << 0;

/// Byte address of a page in the RWW section of both chips.
const PAGE: usize = 0x1000;
/// Value of the bytes of that page at the start of a test.
const OLD: u8 = 0x5A;

/// An ATmega168 with a bootloader of 2 KB that executes `steps`.
#[track_caller]
fn loader(steps: &str) -> Avr {
    loader_for(Chip::Atmega168, 0x3800, steps)
}

#[track_caller]
fn loader_for(chip: Chip, start: usize, steps: &str) -> Avr {
    let mut avr = bootloader_for(chip, start, "spm", &[&format!("STEPS={steps};")]);
    avr.load_flash(PAGE, &[OLD; PAGE_BYTES]);
    avr
}

/// Runs the bootloader to its end.
#[track_caller]
fn run(avr: &mut Avr) {
    avr.run_until(avr.now() + 50 * MS);
    assert_eq!(byte(avr, "done"), 1, "{:?} at {:#06x}", avr.state(), avr.pc());
}

/// The bytes that `steps` note.
#[track_caller]
fn notes(steps: &str) -> Vec<u8> {
    let mut avr = loader(steps);
    run(&mut avr);
    bytes(&avr, "notes")[..usize::from(byte(&avr, "noted"))].to_vec()
}

/// Runs until the flash is busy (true) or not (false). Returns the time.
#[track_caller]
fn run_until_busy(avr: &mut Avr, busy: bool) -> u64 {
    for _ in 0..100_000 {
        if avr.is_programming_flash() == busy {
            return avr.now();
        }
        avr.run_until(avr.now() + 1);
    }
    panic!("the flash does not become {}", if busy { "busy" } else { "ready" });
}

fn page(avr: &Avr, start: usize) -> Vec<u8> {
    avr.flash()[start..start + PAGE_BYTES].to_vec()
}

/// The contents of an erased page after `fill_all(first)` and a write.
fn filled(first: u16) -> Vec<u8> {
    (first..first + 64).flat_map(u16::to_le_bytes).collect()
}

#[test]
fn an_erase_and_a_write_change_one_page_and_no_other_flash() {
    for (chip, start) in
        [(Chip::Atmega168, 0x3800), (Chip::Atmega328p, 0x7800), (Chip::Atmega328p, 0x7000)]
    {
        let mut avr = loader_for(
            chip,
            start,
            "erase(0x1000); wait(); fill_all(0x1234); write(0x1000); wait()",
        );
        let mut expected = avr.flash().to_vec();
        expected[PAGE..PAGE + PAGE_BYTES].copy_from_slice(&filled(0x1234));
        run(&mut avr);
        assert!(avr.flash() == expected, "{chip}");
        assert_no_violation(&mut avr);
    }
}

#[test]
fn an_erase_and_a_write_take_4_5_ms_each_and_the_flash_changes_at_the_end() {
    assert_eq!(PAGE_PROGRAMMING_CYCLES, 72_000);
    let mut avr = loader("erase(0x1000); wait(); fill_all(1); write(0x1000); wait()");
    for (before, after) in
        [(vec![OLD; PAGE_BYTES], vec![0xFF; PAGE_BYTES]), (vec![0xFF; PAGE_BYTES], filled(1))]
    {
        let start = run_until_busy(&mut avr, true);
        assert_eq!(page(&avr, PAGE), before);
        avr.run_until(start + PAGE_PROGRAMMING_CYCLES - 10);
        assert_eq!(page(&avr, PAGE), before);
        let end = run_until_busy(&mut avr, false);
        assert!((end - start).abs_diff(PAGE_PROGRAMMING_CYCLES) < 8, "{}", end - start);
        assert_eq!(page(&avr, PAGE), after);
    }
}

#[test]
fn selfprgen_reads_1_while_the_flash_is_busy() {
    let steps = "erase(0x1000); note(SPMCSR); wait(); note(SPMCSR); write(0x1000); note(SPMCSR); \
                 wait(); note(SPMCSR)";
    assert_eq!(notes(steps), [RWWSB | PGERS | SELFPRGEN, RWWSB, RWWSB | PGWRT | SELFPRGEN, RWWSB]);
}

#[test]
fn rwwsb_stays_set_until_rwwsre_or_a_fill_of_the_page_buffer_clears_it() {
    assert_eq!(
        notes("erase(0x1000); wait(); note(SPMCSR); enable_rww(); note(SPMCSR)"),
        [RWWSB, 0]
    );
    assert_eq!(notes("erase(0x1000); wait(); note(SPMCSR); fill(0, 0); note(SPMCSR)"), [RWWSB, 0]);
    // RWWSRE has no effect while the page is erased.
    let early = "erase(0x1000); SPMCSR = _BV(RWWSRE) | _BV(SELFPRGEN); wait(); note(SPMCSR)";
    assert_eq!(notes(early), [RWWSB]);
}

#[test]
fn the_rww_section_reads_0xff_while_rwwsb_is_set() {
    let mut avr = loader(
        "erase(0x1000); note(load(0x2000)); wait(); note(load(0x2000)); enable_rww(); \
         note(load(0x2000))",
    );
    avr.load_flash(0x2000, &[0x11]);
    run(&mut avr);
    assert_eq!(bytes(&avr, "notes")[..3], [0xFF, 0xFF, 0x11]);
    let violations = avr.take_violations();
    assert_eq!(violations.len(), 2);
    assert!(violations[0].text.contains("LPM reads the RWW section"), "{violations:?}");
}

#[test]
fn the_nrww_section_can_be_read_while_the_rww_section_is_programmed() {
    let mut avr = loader("erase(0x1000); note(load(0x3F00)); wait()");
    avr.load_flash(0x3F00, &[0x22]);
    run(&mut avr);
    assert_eq!(byte(&avr, "notes"), 0x22);
    assert_no_violation(&mut avr);
}

#[test]
fn a_program_that_executes_the_rww_section_while_rwwsb_is_set_has_crashed() {
    let jump = "((void (*)(void))0)()";
    for (steps, crashes) in [
        (format!("erase(0x1000); {jump}"), true),
        (format!("erase(0x1000); wait(); {jump}"), true),
        (format!("erase(0x1000); wait(); enable_rww(); {jump}"), false),
    ] {
        let mut avr = loader(&steps);
        avr.load_flash(0, &[0xFF, 0xCF]); // rjmp .-2
        avr.run_until(10 * MS);
        if crashes {
            assert_eq!(avr.state(), State::Crashed(0), "{steps}");
            assert_one_violation(&mut avr, "executes the RWW section while RWWSB is set");
            avr.reset(ResetCause::External);
            assert_eq!(avr.state(), State::Running);
        } else {
            assert_eq!((avr.state(), avr.pc()), (State::Running, 0));
            assert_no_violation(&mut avr);
        }
    }
}

#[test]
fn an_erase_or_a_write_of_the_nrww_section_halts_the_cpu() {
    for (chip, start, page_start) in
        [(Chip::Atmega168, 0x3800, 0x3F00), (Chip::Atmega328p, 0x7800, 0x7000)]
    {
        let steps = format!(
            "erase({page_start}); note(SPMCSR); fill_all(7); write({page_start}); note(SPMCSR)"
        );
        let mut avr = loader_for(chip, start, &steps);
        for count in 0..2 {
            let start = run_until_busy(&mut avr, true);
            let pc = avr.pc();
            // Time still passes, and a run can end while the CPU is halted.
            avr.run_until(start + 40_000);
            assert_eq!((avr.now(), avr.pc(), byte(&avr, "noted")), (start + 40_000, pc, count));
            let end = run_until_busy(&mut avr, false);
            assert!((end - start).abs_diff(PAGE_PROGRAMMING_CYCLES) < 8, "{}", end - start);
        }
        run(&mut avr);
        assert_eq!(bytes(&avr, "notes")[..2], [0, 0], "neither SELFPRGEN nor RWWSB");
        assert_eq!(page(&avr, page_start), filled(7));
        assert_no_violation(&mut avr);
    }
}

#[test]
fn spm_outside_the_boot_section_does_nothing() {
    let mut avr = loader("fill_all(0x1234); erase(0x1000); wait()");
    let before = avr.flash().to_vec();
    // Sets BOOTSZ so that the boot section begins after this program.
    avr.set_boot_section(0x3C00);
    run(&mut avr);
    assert!(avr.flash() == before);
    let violations = avr.take_violations();
    assert_eq!(violations.len(), 65, "64 fills and an erase");
    assert!(
        violations
            .iter()
            .all(|violation| violation.text.contains("boot section, which begins at 0x3c00"))
    );
}

#[test]
fn spm_must_begin_within_four_cycles_after_the_write_of_spmcsr() {
    for (nops, erases) in [(0, true), (3, true), (4, false)] {
        let nops = "nop\\n\\t".repeat(nops);
        let mut avr = loader(&format!("erase_after(\"{nops}\", 0x1000); note(SPMCSR); wait()"));
        run(&mut avr);
        assert_eq!(avr.flash()[PAGE] == 0xFF, erases, "{nops}");
        if erases {
            assert_no_violation(&mut avr);
        } else {
            assert_eq!(byte(&avr, "notes"), 0, "SELFPRGEN and PGERS are cleared");
            assert_one_violation(
                &mut avr,
                "SPM without a command in SPMCSR in the four cycles before",
            );
        }
    }
}

/// What the page begins with then. The page at 0x2000 and the EEPROM stay as they were.
#[test]
fn a_mistake_with_the_flash_is_told_and_does_what_it_does_on_the_chip() {
    for (steps, text, expected) in [
        (
            "SPMCSR = _BV(PGERS) | _BV(PGWRT) | _BV(SELFPRGEN); note(SPMCSR)",
            "is not a command",
            [OLD, OLD, OLD],
        ),
        ("erase(0x1000); erase(0x2000); wait()", "SPM while the flash is programmed", [0xFF; 3]),
        (
            "erase(0x1000); wait(); fill(0, 0x0FF0); fill(0, 0x3C3C); write(0x1000); wait()",
            "word 0 of the page buffer is filled again",
            [0x30, 0x0C, 0xFF],
        ),
        (
            "fill_all(0xFF00); write(0x1000); wait()",
            "is written without an erase",
            [0x00, OLD, OLD & 0x01],
        ),
        (
            "erase(0x1000); write_eeprom(1); wait()",
            "an EEPROM write is started while the flash is programmed",
            [0xFF; 3],
        ),
    ] {
        let mut avr = loader(steps);
        avr.load_flash(0x2000, &[OLD]);
        run(&mut avr);
        assert_eq!(page(&avr, PAGE)[..3], expected, "{steps}");
        let unchanged = (byte(&avr, "notes"), avr.flash()[0x2000], avr.eeprom()[0]);
        assert_eq!(unchanged, (0, OLD, 0xFF), "{steps}");
        assert_one_violation(&mut avr, text);
    }
}

#[test]
fn the_page_buffer_is_empty_after_a_write_after_rwwsre_and_after_a_reset() {
    let written_again =
        "erase(0x1000); wait(); fill_all(1); write(0x2000); wait(); write(0x1000); wait()";
    let enabled = "erase(0x1000); wait(); fill_all(1); enable_rww(); write(0x1000); wait()";
    let reset = "if (MCUSR & _BV(PORF)) { MCUSR = 0; fill_all(1); for (;;) { } } erase(0x1000); \
                 wait(); write(0x1000); wait()";
    for steps in [written_again, enabled, reset] {
        let mut avr = loader(steps);
        avr.run_until(MS);
        if steps == reset {
            avr.reset(ResetCause::External);
        }
        run(&mut avr);
        assert_eq!(page(&avr, PAGE), [0xFF; PAGE_BYTES], "{steps}");
        assert_no_violation(&mut avr);
    }
}

/// The page after a reset in the middle of the erase or write with number `operation`. Checks that
/// SPMCSR is 0 then.
fn interrupted_page(steps: &str, operation: u32, cause: ResetCause, seed: u64) -> Vec<u8> {
    let mut avr = loader(&format!(
        "if (MCUSR != _BV(PORF)) {{ note(SPMCSR); done = 1; for (;;) {{ }} }} {steps}"
    ));
    avr.seed(seed);
    for _ in 1..operation {
        run_until_busy(&mut avr, true);
        run_until_busy(&mut avr, false);
    }
    let start = run_until_busy(&mut avr, true);
    avr.run_until(start + PAGE_PROGRAMMING_CYCLES / 2);
    avr.reset(cause);
    assert!(!avr.is_programming_flash());
    let half_programmed = page(&avr, PAGE);
    // After a loss of power the bootloader executes the steps again.
    if cause != ResetCause::PowerOn {
        run(&mut avr);
        assert_eq!((byte(&avr, "notes"), page(&avr, PAGE)), (0, half_programmed.clone()));
    }
    half_programmed
}

#[test]
fn a_reset_during_an_erase_leaves_old_erased_and_mixed_bytes() {
    for cause in [ResetCause::PowerOn, ResetCause::External, ResetCause::BrownOut] {
        let page = interrupted_page("erase(0x1000); wait()", 1, cause, 1);
        let count = |value| page.iter().filter(|byte| **byte == value).count();
        assert!(
            count(OLD) > 20 && count(0xFF) > 20 && count(OLD) + count(0xFF) < 118,
            "{cause:?}: {page:x?}"
        );
        // An erase only sets bits.
        assert!(page.iter().all(|byte| byte & OLD == OLD), "{cause:?}: {page:x?}");
    }
}

#[test]
fn a_reset_during_a_write_leaves_erased_new_and_mixed_bytes() {
    let page = interrupted_page(
        "erase(0x1000); wait(); fill_all(0x0000); write(0x1000); wait()",
        2,
        ResetCause::PowerOn,
        1,
    );
    let new = filled(0);
    let as_new = page.iter().zip(&new).filter(|(byte, new)| byte == new).count();
    let erased = page.iter().filter(|byte| **byte == 0xFF).count();
    assert!(as_new > 20 && erased > 20 && as_new + erased < 118, "{page:x?}");
    // A write only clears bits.
    assert!(page.iter().zip(&new).all(|(byte, new)| byte & new == *new), "{page:x?}");
}

/// For nearly all of the 16 ms the flash is busy and the CPU is halted.
#[test]
fn the_watchdog_resets_a_halted_cpu() {
    let steps = "if (MCUSR == _BV(PORF)) { wdt_enable(WDTO_15MS); for (;;) { erase(0x3F00); } } \
                 note(SPMCSR)";
    let mut avr = loader(steps);
    run(&mut avr);
    let resets = avr.resets();
    let [.., before, last] = &resets[..] else { panic!("{resets:?}") };
    assert_eq!(last.cause, ResetCause::Watchdog);
    assert!((14 * MS..18 * MS).contains(&(last.at - before.at)), "{resets:?}");
    // Three erases are complete; the reset interrupts the fourth.
    assert_eq!((last.at - before.at) / PAGE_PROGRAMMING_CYCLES, 3);
    assert_eq!((byte(&avr, "notes"), avr.is_programming_flash()), (0, false));
}

#[test]
fn a_debugger_steps_over_spm_that_halts_the_cpu() {
    let mut avr = loader("fill(0, 0); erase(0x3F00); note(1)");
    let spm = [0xE8, 0x95];
    let mut addresses = (0x3800..0x3F00).step_by(2).filter(|at| avr.flash()[*at..*at + 2] == spm);
    let erase = addresses.next_back().unwrap() as u32;
    let debugger = avr.debugger();
    debugger.set_breakpoint(erase);
    avr.run_until(MS);
    assert_eq!((avr.pc(), debugger.halted()), (erase, Some(Halt::Breakpoint)));
    debugger.resume(Resume::Step);
    avr.run_until(20 * MS);
    assert_eq!((avr.pc(), debugger.halted()), (erase + 2, Some(Halt::Stepped)));
    assert!(
        !avr.is_programming_flash() && avr.now() > PAGE_PROGRAMMING_CYCLES && avr.now() < 6 * MS
    );
}

#[test]
fn a_half_programmed_page_is_the_same_for_equal_seeds_and_differs_from_chip_to_chip() {
    let page = |seed| interrupted_page("erase(0x1000); wait()", 1, ResetCause::PowerOn, seed);
    assert_eq!(page(1), page(1));
    assert_ne!(page(1), page(2));
}

#[test]
fn an_eeprom_write_blocks_self_programming_and_empties_the_page_buffer() {
    let mut avr = loader("fill(0, 0); write_eeprom(1); erase(0x1000); note(SPMCSR); wait()");
    run(&mut avr);
    assert_eq!((avr.flash()[PAGE], byte(&avr, "notes"), avr.eeprom()[0]), (OLD, 0, 1));
    let texts: Vec<String> =
        avr.take_violations().into_iter().map(|violation| violation.text).collect();
    assert_eq!(texts.len(), 3, "{texts:?}");
    assert!(texts[0].contains("erases the page buffer"), "{texts:?}");
    assert!(texts[1].contains("SPMCSR is written while the EEPROM is written"), "{texts:?}");
    assert!(texts[2].contains("SPM without a command"), "{texts:?}");
}

#[test]
fn boot_lock_bits_block_spm_and_survive_a_loss_of_power() {
    let mut avr = loader("boot_lock_bits_set(_BV(BLB01)); wait(); erase(0x1000); wait()");
    assert_eq!(avr.lock_bits(), 0xFF);
    run(&mut avr);
    assert_eq!((avr.lock_bits(), avr.flash()[PAGE]), (0b1111_1011, OLD));
    assert_one_violation(&mut avr, "which the lock bits forbid");
    avr.reset(ResetCause::PowerOn);
    assert_eq!(avr.lock_bits(), 0b1111_1011);
}

#[test]
fn lock_bits_can_be_read_within_three_cycles_after_the_write_of_spmcsr() {
    let read =
        |nops: usize| notes(&format!("note(lock_bits_after(\"{}\"))", "nop\\n\\t".repeat(nops)));
    assert_eq!((read(0), read(2)), (vec![0xFF], vec![0xFF]));
    // After that time LPM reads the flash.
    let mut avr = loader("note(lock_bits_after(\"nop\\n\\tnop\\n\\tnop\\n\\t\"))");
    avr.load_flash(1, &[0x77]);
    run(&mut avr);
    assert_eq!(byte(&avr, "notes"), 0x77);
}

#[test]
fn a_program_can_read_the_fuses_and_the_signature() {
    let steps = "for (uint8_t i = 0; i < 4; i++) note(boot_lock_fuse_bits_get(i)); for (uint8_t i \
                 = 0; i < 6; i += 2) note(boot_signature_byte_get(i))";
    for (chip, start, expected) in [
        (Chip::Atmega168, 0x3800, [0xFF, 0xFF, 0xF8, 0xDD, 0x1E, 0x94, 0x06]),
        (Chip::Atmega328p, 0x7800, [0xFF, 0xFF, 0xFD, 0xDA, 0x1E, 0x95, 0x0F]),
    ] {
        let mut avr = loader_for(chip, start, steps);
        run(&mut avr);
        assert_eq!(bytes(&avr, "notes")[..7], expected, "{chip}");
    }
}

#[test]
fn the_interrupt_comes_when_the_flash_is_no_longer_busy() {
    let steps = "move_vectors(); erase(0x1000); SPMCSR |= _BV(SPMIE); sei(); note(SPMCSR); \
                 note(interrupts); wait(); note(interrupts); note(SPMCSR)";
    let mut avr = loader(steps);
    run(&mut avr);
    assert_eq!(bytes(&avr, "notes")[..4], [SPMIE | RWWSB | PGERS | SELFPRGEN, 0, 1, RWWSB]);
    assert_no_violation(&mut avr);
}

#[test]
fn an_interrupt_whose_vector_is_in_the_rww_section_crashes_the_program_while_rwwsb_is_set() {
    let mut avr = loader("erase(0x1000); SPMCSR |= _BV(SPMIE); sei(); for (;;) { }");
    avr.run_until(10 * MS);
    assert!(matches!(avr.state(), State::Crashed(1..0x80)), "{:?}", avr.state());
    assert_one_violation(&mut avr, "executes the RWW section while RWWSB is set");
}

#[test]
fn a_bootloader_and_an_application_share_a_chip() {
    let application = firmware_for(Chip::Atmega168, "spin", &[]);
    let mut avr = loader("((void (*)(void))0)()");
    let boot_section = avr.flash()[0x3800..].to_vec();
    avr.load_further(&application).unwrap();
    assert!(avr.flash()[0x3800..] == boot_section);
    assert!(avr.flash().starts_with(&application.flash[0].1));
    // The other order: the application first, then the bootloader.
    let mut other = with_firmware(&application).unwrap();
    let loader = bench::avr::Firmware { flash: vec![(0x3800, boot_section)], ..Default::default() };
    other.install_bootloader(&loader).unwrap();
    other.load_flash(PAGE, &[OLD; PAGE_BYTES]);
    other.reset(ResetCause::External);
    assert_eq!(other.pc(), 0x3800);
    assert!(other.flash() == avr.flash());
    assert!(other.install_bootloader(&application).is_err(), "it begins at 0");
    other.run_until(MS);
    assert!(other.pc() < 0x1000, "the application runs");
}
