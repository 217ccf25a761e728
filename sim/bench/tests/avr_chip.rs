//! Tests of the simulated AVR with programs: time, resets, sleep, pins, memory.

use std::cell::RefCell;
use std::rc::Rc;

use crate::avr::{
    ENGINE, MS, US, assert_no_violation, blank, byte, bytes, firmware_for, program, program_for,
    read, with_firmware, word,
};
use bench::avr::{Avr, Chip, Halt, Oc, Registers, ResetCause, Resume, State};
use bench::board::Board;
use bench::wiring::Wiring;

#[test]
fn time_goes_on_through_resets() {
    let mut avr = program("spin", &[]);
    avr.run_until(5 * MS);
    let before = avr.now();
    assert!((5 * MS..5 * MS + 8).contains(&before), "{before}");
    avr.reset(ResetCause::External);
    assert_eq!(avr.now(), before);
    avr.run_until(7 * MS);
    assert!((7 * MS..7 * MS + 8).contains(&avr.now()));
    let causes: Vec<ResetCause> = avr.resets().iter().map(|reset| reset.cause).collect();
    assert_eq!(causes, [ResetCause::PowerOn, ResetCause::External]);
    assert_eq!(avr.resets()[1].at, before);
}

/// As on an Arduino whose bootloader has found no program.
#[test]
fn a_program_behind_erased_flash_is_reached() {
    const PROGRAM: usize = 0x3800;
    // SBI DDRB, 5; SBI PORTB, 5; RJMP to itself.
    let mut avr = blank(Chip::Atmega168);
    avr.load_flash(PROGRAM, &[0x25, 0x9A, 0x2D, 0x9A, 0xFF, 0xCF]);
    avr.run_until(PROGRAM as u64 / 2);
    assert!(!avr.pin('B', 5));
    avr.run_until(PROGRAM as u64 / 2 + 10);
    assert!(avr.pin('B', 5));
    assert_no_violation(&mut avr);
}

/// A program that is none, one that leaves the flash, and one that sleeps for good. One engine
/// stops at the opcode, which does not exist, and behind the last instruction that was loaded, the
/// other at the end of the flash.
#[test]
fn a_program_that_cannot_go_on_stops_until_a_reset_and_time_still_passes() {
    let loaded = |opcode: [u8; 2]| {
        let mut avr = blank(Chip::Atmega168);
        avr.load_flash(0, &opcode);
        avr
    };
    for (mut avr, is_done) in [
        (loaded([0x01, 0x00]), false),
        (loaded([0x00, 0x00]), false),
        (program("sleep", &["FOR_GOOD"]), true),
    ] {
        let state = avr.run_until(10 * MS);
        let expected =
            if is_done { state == State::Done } else { matches!(state, State::Crashed(_)) };
        assert!(expected, "{state:?}");
        assert_eq!(avr.now(), 10 * MS);
        avr.reset(ResetCause::External);
        assert_eq!(avr.state(), State::Running);
    }
}

#[test]
fn the_result_does_not_depend_on_the_length_of_the_runs() {
    let count_after = |step: u64| {
        let mut avr = program("sleep", &[]);
        let mut at = 0;
        while at < 50 * MS {
            at += step;
            avr.run_until(at.min(50 * MS));
        }
        (word(&avr, "ticks"), avr.sp())
    };
    assert_eq!(count_after(16), count_after(50 * MS));
}

/// Datasheet 11.9: the watchdog stays on after its reset, with the shortest time-out, until the
/// program arms it again or turns it off. The oscillator's frequency deviates by at most 10 %.
#[test]
fn the_watchdog_runs_on_after_its_reset_until_the_program_arms_it_again_or_turns_it_off() {
    let long = 57 * MS..71 * MS;
    for (defines, ms, resets, further) in [
        (&[][..], 200, 10..13, 14 * MS..18 * MS),
        (&["REARM"], 300, 4..7, long.clone()),
        (&["DISABLE"], 500, 2..3, 0..0),
    ] {
        let mut avr = program("watchdog", defines);
        avr.run_until(ms * MS);
        let at: Vec<u64> = avr.resets().iter().map(|reset| reset.at).collect();
        assert!(resets.contains(&at.len()), "{defines:?}: {at:?}");
        assert!(long.contains(&at[1]), "{defines:?}: {at:?}");
        for pair in at[1..].windows(2) {
            assert!(further.contains(&(pair[1] - pair[0])), "{defines:?}: {at:?}");
        }
        assert!(avr.resets()[1..].iter().all(|reset| reset.cause == ResetCause::Watchdog));
        assert_eq!(usize::from(byte(&avr, "starts")), at.len(), "{defines:?}");
        assert_eq!(byte(&avr, "mcusr"), 1 << 3, "{defines:?}");
    }
}

/// Datasheet 11.9.2: the program polls the flag, and clears it by writing a one to it. It counts
/// turns of a loop meanwhile. Equal seeds give equal counts.
#[test]
fn time_outs_of_the_watchdog_have_jitter_and_differ_from_chip_to_chip() {
    let turns = |seed: u64| {
        let mut avr = program("watchdog_noise", &[]);
        avr.seed(seed);
        avr.reset(ResetCause::PowerOn);
        avr.run_until(160 * MS);
        assert_eq!(byte(&avr, "done"), 1);
        let turns = bytes(&avr, "turns");
        turns.chunks(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect::<Vec<u16>>()
    };
    let first = turns(1);
    let (least, most) = (first.iter().min().unwrap(), first.iter().max().unwrap());
    assert!(most - least >= 2 && most - least < most / 1000, "{first:?}");
    assert_eq!(first, turns(1));
    assert_ne!(first, turns(2));
}

/// Datasheet 11.9.1: a power-on clears the other flags, other resets add theirs.
#[test]
fn mcusr_has_the_causes_of_the_resets() {
    const MCUSR: u16 = 0x54;
    let mut avr = program("spin", &[]);
    assert_eq!(avr.sram(MCUSR), 0b0001);
    use ResetCause::{BrownOut, External, PowerOn};
    for (cause, flags) in [(External, 0b0011), (BrownOut, 0b0111), (PowerOn, 0b0001)] {
        avr.reset(cause);
        assert_eq!(avr.sram(MCUSR), flags, "{cause:?}");
    }
}

#[test]
fn sram_has_random_contents_after_power_on_and_its_old_contents_after_other_resets() {
    for (chip, ram_end) in [(Chip::Atmega168, 0x4FF), (Chip::Atmega328p, 0x8FF)] {
        let contents = |avr: &Avr| avr.sram_range(0x100..=ram_end);
        let mut avr = blank(chip);
        let first = contents(&avr);
        assert!(first.iter().filter(|byte| **byte == 0).count() < 20);
        assert!(first[first.len() - 20..].iter().any(|byte| *byte != 0));
        avr.reset(ResetCause::External);
        assert_eq!(contents(&avr), first);
        avr.reset(ResetCause::PowerOn);
        assert_ne!(contents(&avr), first);
        assert_eq!(contents(&blank(chip)), first, "not repeatable");
    }
}

/// Clock cycles that a round of the program takes beside its sleep.
const ROUND: u16 = 200;

/// Table 10-1: Timer0 stands in each of these modes, and Timer1, so that the watchdog alone wakes
/// the chip. From power-down and power-save the crystal needs 16,384 cycles, in which they stand.
#[test]
fn in_a_deep_sleep_the_timers_stand_and_the_watchdog_wakes_the_chip() {
    // SM2:0: ADC Noise Reduction, Power-down, Power-save, Standby, Extended Standby.
    for mode in [1, 2, 3, 6, 7] {
        let mut avr = program("sleep", &["WATCHDOG", &format!("MODE={mode}<<SM0")]);
        avr.run_until(2000 * MS);
        let rounds = word(&avr, "rounds");
        // 64 ms, with an oscillator that deviates by up to 10 %.
        assert!((27..=35).contains(&rounds), "{mode}: {rounds} rounds");
        assert_eq!(word(&avr, "others"), rounds, "{mode}");
        assert_eq!(word(&avr, "ticks"), 0, "{mode}");
        assert!(word(&avr, "moved") < ROUND, "{mode}: {}", word(&avr, "moved"));
        assert_no_violation(&mut avr);
    }
}

/// Section 13.1: edges of INT0 need the clock, its low level does not. Section 9.3: the crystal
/// starts within 16,384 cycles.
#[test]
fn a_low_level_of_int0_and_a_change_of_a_pin_end_a_deep_sleep_and_an_edge_of_int0_does_not() {
    let wakes_after = |define: &str, pin: u8| {
        let mut avr = program("sleep", &["MODE=SLEEP_MODE_PWR_DOWN", define]);
        avr.drive_pin('D', pin, true);
        avr.run_until(100 * MS);
        let before = word(&avr, "others");
        avr.drive_pin('D', pin, false);
        let begin = avr.now();
        while word(&avr, "others") == before && avr.now() < begin + 10 * MS {
            avr.run_until(avr.now() + 16);
        }
        let others = word(&avr, "others") - before;
        (others, avr.now() - begin)
    };
    for (define, pin) in [("INT0_SENSE=0", 2), ("PIN_CHANGE", 4)] {
        let (others, cycles) = wakes_after(define, pin);
        assert_eq!(others, 1, "{define}");
        assert!((16_384..16_384 + 128).contains(&cycles), "{define}: {cycles}");
    }
    let falling = 2;
    assert_eq!(wakes_after(&format!("INT0_SENSE={falling}"), 2).0, 0);
}

/// Section 10.5: entering the mode starts a conversion, whose interrupt ends the sleep.
#[test]
fn adc_noise_reduction_converts_once_for_each_sleep() {
    let mut avr = program("sleep", &["CONVERSION", "MODE=SLEEP_MODE_ADC"]);
    avr.run_until(100 * MS);
    let rounds = word(&avr, "rounds");
    // 13 ADC clocks of 128 cycles.
    assert!((850..970).contains(&rounds), "{rounds} rounds");
    assert!(rounds.abs_diff(word(&avr, "others")) <= 1);
    assert!(word(&avr, "moved") < ROUND);
}

/// LDI r24, 0x0E; STS WDTCSR, r24; LDI r24, 0x08; STS UCSR0B, r24; WDR; NOP; STS UDR0, r24; NOP;
/// NOP; RJMP back to WDR. Arming the watchdog, resetting it and sending a character each set a
/// cycle timer in simavr.
const WITH_CYCLE_TIMERS: [u16; 13] = [
    0xE08E, 0x9380, 0x0060, 0xE088, 0x9380, 0x00C1, 0x95A8, 0x0000, 0x9380, 0x00C6, 0x0000, 0x0000,
    0xCFF9,
];

fn with_cycle_timers() -> Avr {
    let mut avr = blank(Chip::Atmega168);
    avr.load_flash(0, &WITH_CYCLE_TIMERS.map(u16::to_le_bytes).concat());
    avr
}

/// Byte addresses of the first instructions that the program executes.
const COURSE: [u32; 15] = [0, 2, 6, 8, 12, 14, 16, 20, 22, 24, 12, 14, 16, 20, 22];

#[test]
fn a_tracer_sees_every_instruction_before_it_runs() {
    let mut avr = with_cycle_timers();
    let seen = Rc::new(RefCell::new(Vec::new()));
    let log = Rc::clone(&seen);
    avr.trace(Some(Box::new(move |moment| log.borrow_mut().push((moment.pc(), moment.at())))));
    avr.run_until(MS);
    avr.trace(None);
    let traced = seen.borrow().len();
    avr.run_until(2 * MS);
    let seen = seen.borrow();
    assert_eq!(seen.len(), traced, "the tracer is not called after the end");
    let course: Vec<u32> = seen.iter().map(|&(pc, _)| pc).collect();
    assert_eq!(course[..15], COURSE);
    let cycles = |pair: &[(u32, u64)]| pair[1].1 - pair[0].1;
    assert!(seen.windows(2).all(|pair| (1..=2).contains(&cycles(pair))), "one or two cycles each");
}

#[test]
fn a_debugger_steps_by_one_instruction_and_halts_at_every_breakpoint() {
    let mut avr = with_cycle_timers();
    let debugger = avr.debugger();
    debugger.halt(Halt::Asked);
    for pc in COURSE {
        assert_eq!((debugger.halted().is_some(), avr.pc()), (true, pc));
        debugger.resume(Resume::Step);
        avr.run_until(MS);
    }
    // The instructions after WDR, and after the write to UDR0.
    for pc in [14, 20, 14, 20] {
        debugger.set_breakpoint(pc);
        debugger.resume(Resume::Run);
        avr.run_until(MS);
        assert_eq!((debugger.halted(), avr.pc()), (Some(Halt::Breakpoint), pc));
        debugger.clear_breakpoint(pc);
    }
}

/// A watcher of the pin sees what it does, with its times.
fn watched(avr: &mut Avr, bit: u8) -> Rc<RefCell<Vec<(u64, bool)>>> {
    let seen = Rc::new(RefCell::new(Vec::new()));
    let log = Rc::clone(&seen);
    avr.watch_pin('B', bit, Box::new(move |level, at| log.borrow_mut().push((at, level))));
    seen
}

/// The program copies D2 to B0.
#[test]
fn an_input_keeps_its_level_from_outside_when_the_port_is_written_and_after_a_reset() {
    let mut avr = program("pins", &[]);
    for (level, ms) in [(true, 1), (false, 2)] {
        avr.drive_pin('D', 2, level);
        avr.run_until(ms * MS);
        assert_eq!(avr.pin('B', 0), level);
    }
    avr.drive_pin('D', 2, true);
    avr.reset(ResetCause::External);
    assert!(!avr.pin('B', 0));
    avr.run_until(3 * MS);
    assert!(avr.pin('B', 0));
}

/// The program masks INT0 while D3 is low.
#[test]
fn falling_edges_of_int0_interrupt_and_those_while_it_is_masked_once_afterwards() {
    let mut avr = program("pins", &[]);
    let mut falls = 0;
    for (masked, levels, new) in [
        (false, &[true][..], 0),
        (false, &[false, true, false, true, false, true], 3),
        (true, &[false, true, false, true], 0),
        (false, &[], 1),
        (true, &[], 0),
        (false, &[], 0),
        (false, &[false], 1),
    ] {
        avr.drive_pin('D', 3, !masked);
        avr.run_until(avr.now() + 20 * US);
        for &level in levels {
            avr.drive_pin('D', 2, level);
            avr.run_until(avr.now() + 10 * US);
        }
        falls += new;
        assert_eq!(byte(&avr, "falls"), falls, "masked {masked}, {levels:?}");
    }
}

#[test]
fn the_largest_stack_is_measured_in_painted_sram() {
    let mut avr = blank(Chip::Atmega168);
    (0x200..=0x4FF).for_each(|address| avr.poke_sram(address, 0xC5));
    assert_eq!(avr.stack_high_water(0xC5, 0x200), 0);
    avr.poke_sram(0x4F0, 0);
    assert_eq!(avr.stack_high_water(0xC5, 0x200), 16);
    assert_eq!(avr.stack_high_water(0xC5, 0x500), 0);
    assert_eq!(avr.stack_high_water(0xC5, 0x900), 0, "the symbol of a program for a larger chip");
}

/// The linker writes the name of the chip into a note of the ELF file.
#[test]
fn a_program_runs_on_the_chip_that_it_was_linked_for() {
    for chip in Chip::ALL {
        let mut avr = program_for(chip, "sleep", &[]);
        assert_eq!(avr.chip(), chip);
        assert_eq!(avr.run_until(1024 * US * 100 + 512 * US), State::Sleeping);
        assert_eq!(word(&avr, "ticks"), 100);
        // main's return address and locals are at the end of the RAM.
        assert!((chip.ram_end() - 32..=chip.ram_end()).contains(&avr.sp()), "{:#x}", avr.sp());
        let sizes = (avr.flash().len(), avr.eeprom().len());
        assert_eq!(sizes, (chip.flash_bytes(), chip.eeprom_bytes()));
        assert_no_violation(&mut avr);
    }
}

#[test]
fn the_error_of_a_program_that_is_too_large_for_the_chip_has_the_sizes() {
    for (define, expected) in [
        (
            "VARIABLES=1500",
            "1,500 bytes of variables do not fit the 1,024 bytes of RAM of an ATmega168; is it \
             for an ATmega328P?",
        ),
        (
            "CODE=20000",
            " bytes of code and initialised data do not fit the 16,384 bytes of flash of an \
             ATmega168; is it for an",
        ),
    ] {
        let firmware = firmware_for(Chip::Atmega328p, "memory", &[define]);
        let error =
            Avr::programmed_on(ENGINE, Chip::Atmega168, &firmware).err().expect(define).to_string();
        assert!(error.contains(expected) && error.ends_with("--mcu atmega328p"), "{error}");
        let mut avr = with_firmware(&firmware).unwrap();
        avr.run_until(10 * MS);
        assert_no_violation(&mut avr);
    }
}

#[test]
fn the_section_board_of_a_program_sets_the_wiring() {
    let firmware = firmware_for(Chip::Atmega328p, "label", &[]);
    let wiring = Wiring::of("uno", "module").unwrap();
    assert_eq!(Wiring::of_program(&firmware).unwrap(), wiring);
    assert_eq!(Board::new(with_firmware(&firmware).unwrap()).wiring(), &wiring);
    // The section is not loaded: without it the program has nearly the same size.
    let bytes = |firmware: &bench::avr::Firmware| {
        firmware.flash.iter().map(|(_, bytes)| bytes.len()).sum::<usize>()
    };
    let without = firmware_for(Chip::Atmega328p, "spin", &[]);
    assert!(bytes(&firmware).abs_diff(bytes(&without)) < 64);
    assert_eq!(
        Wiring::of_program(&without).unwrap(),
        Wiring { chip: Chip::Atmega328p, ..Wiring::default() }
    );
    let error = read(Chip::Atmega328p, "label", &["CRYSTAL=80"])
        .and_then(|wrong| Wiring::of_program(&wrong))
        .unwrap_err();
    let error = format!("{error:#}");
    assert!(error.contains("the section .board: crystal_mhz: \"80\" is not a crystal"), "{error}");
}

/// A chip with the program LDS r24, ADDRESS; STS ADDRESS, r24; RJMP to itself.
fn with_access_of(chip: Chip, address: u16) -> Avr {
    let mut avr = blank(chip);
    let program = [0x9180, address, 0x9380, address, 0xCFFF];
    avr.load_flash(0, &program.map(u16::to_le_bytes).concat());
    avr.run_until(MS);
    avr
}

#[test]
fn an_access_beyond_the_ram_is_reported_with_its_program_counter() {
    for (chip, end) in [(Chip::Atmega168, "0x04ff"), (Chip::Atmega328p, "0x08ff")] {
        assert_no_violation(&mut with_access_of(chip, chip.ram_end()));
        let address = chip.ram_end() + 1;
        let violations = with_access_of(chip, address).take_violations();
        let texts: Vec<&str> = violations.iter().map(|violation| violation.text.as_str()).collect();
        let text = |verb, pc| {
            format!(
                "the program {verb} {address:#06x}, but the RAM of an {chip} ends at {end} (PC \
                 {pc})"
            )
        };
        assert_eq!(texts, [text("reads", "0x0000"), text("writes", "0x0004")]);
    }
}

/// simavr reads and writes flash at any address in Z.
#[test]
fn addresses_beyond_the_end_of_the_flash_read_0xff() {
    // LDI r30, 0xFF; LDI r31, 0xFF; LPM r24, Z; STS 0x100, r24; LDI r31, 0x40; LPM r24, Z; STS
    // 0x101, r24; RJMP to itself.
    let program = [0xEFEF, 0xEFFF, 0x9184, 0x9380, 0x0100, 0xE4F0, 0x9184, 0x9380, 0x0101, 0xCFFF];
    let mut avr = blank(Chip::Atmega168);
    avr.load_flash(0, &program.map(u16::to_le_bytes).concat());
    avr.run_until(MS);
    assert_eq!(avr.sram_range(0x100..=0x101), [0xFF, 0xFF]);
}

#[test]
fn a_debugger_can_access_the_memories_of_the_chip_and_nothing_beyond_their_ends() {
    for chip in Chip::ALL {
        let mut avr = blank(chip);
        let debugger = avr.debugger();
        let ram_end = u32::from(chip.ram_end());
        assert!(debugger.data(ram_end).is_some() && debugger.data(ram_end + 1).is_none());
        assert!(debugger.set_data(ram_end, 1) && !debugger.set_data(ram_end + 1, 1));
        let (flash, eeprom) = (chip.flash_bytes() as u32, chip.eeprom_bytes() as u32);
        assert!(debugger.flash(flash - 1).is_some() && debugger.flash(flash).is_none());
        assert!(debugger.set_eeprom(eeprom - 1, 1) && !debugger.set_eeprom(eeprom, 1));
        assert!(debugger.eeprom(eeprom - 1).is_some() && debugger.eeprom(eeprom).is_none());
        debugger.set_registers(&Registers { pc: u32::MAX, sp: u16::MAX, ..Registers::default() });
        avr.run_until(MS);
    }
}

#[test]
fn both_chips_run_a_program_with_the_same_results_in_the_same_cycles() {
    for (name, results) in [("adc", "result"), ("spi", "received"), ("servo", "")] {
        let run = |chip| {
            let mut avr = program_for(chip, name, &[]);
            avr.set_analog(0, 1234);
            avr.connect_spi(Box::new(|byte: &bench::avr::SpiByte| byte.mosi ^ 0x5A));
            let sent = watched(&mut avr, 1);
            avr.run_until(45 * MS);
            let result = avr.symbol(results).map(|_| bytes(&avr, results));
            (result, sent.take(), avr.take_edges(Oc::B), avr.take_violations())
        };
        let [small, large] = Chip::ALL.map(run);
        assert_eq!(small, large, "{name}");
    }
}
