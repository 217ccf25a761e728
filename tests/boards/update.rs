//! Firmware updates over the bus: the bootloader of `boot/` on a simulated board, and a file
//! server.

use std::path::Path;

use crate::support::update_bench::*;
use bench::avr::{Firmware, ResetCause};
use bench::dronecan::{Message, NumberAndText};
use bench::{Noise, bootloader};
use rig::{ARMING_STATUS, MS, NOT_ARMED, PWM, Program, Rig, has_all_features, started_with};

#[test]
fn a_board_without_a_program_waits_in_the_bootloader_and_answers_get_node_info() {
    let mut bench = UpdateBench::empty();
    assert_eq!(bench.next_mode(), MAINTENANCE);
    let info = bench.call(GET_NODE_INFO, &[]);
    assert_eq!(info.len(), 41, "a response without a name");
    assert_eq!(info[22..24], file()[HEADER..HEADER + 2], "the hardware version of the board");
    let eeprom = bench.bench.board(0).avr().eeprom();
    assert_eq!(info[24..40], eeprom[UNIQUE_ID], "the unique ID that it has made");
    assert_eq!(info[40], 0, "no certificate");
    assert_eq!(info[7..22], [0; 15], "nothing of a program");
}

#[test]
fn the_bootloader_writes_a_file_from_a_server_and_starts_it() {
    let mut bench = UpdateBench::empty();
    assert_eq!(bench.next_mode(), MAINTENANCE);
    assert_eq!(bench.begin_update("fw.bin"), OK);
    bench.wait_for_program(10_000);
    let file = file();
    assert!(bench.flash(file.len()) == file, "the program in flash is the file");
    // The node is on the bus before its first line is out.
    bench.run_ms(100);
    let text = bench.bench.board(0).avr_mut().serial_take();
    let text: String = text.into_iter().map(|(_, byte)| char::from(byte)).collect();
    // The preset for updates of an ATmega168 has no serial monitor.
    assert!(text.contains("reset: on request") || !has_all_features(), "{text}");
}

/// The file fills the flash of an ATmega168, or is the longer program of an ATmega328P. Page writes
/// take their real time.
#[test]
fn an_update_of_14_kb_takes_less_than_3_seconds_at_1_mbit_per_second() {
    let mut bench = UpdateBench::empty();
    let mut file = file();
    let length = file.len().max(14_336);
    file.resize(length, 0xA5);
    file[HEADER + 4..HEADER + 6].copy_from_slice(&(length as u16).to_le_bytes());
    bench.server.files.insert("14k.bin".to_owned(), with_crc(file));
    assert_eq!(bench.begin_update("14k.bin"), OK);
    let took_ms = bench.wait_for_program(10_000);
    println!("{length} bytes: {took_ms} ms, {} requests", bench.server.requests);
    // A board with a crystal of 8 MHz has a bus of half that bit rate.
    let limit_ms = if board().fastest_bit_rate() == 1_000_000 { 3000 } else { 4000 };
    assert!(took_ms < limit_ms * length as u64 / 14_336, "{took_ms} ms");
}

#[test]
fn a_program_with_a_changed_byte_or_without_a_length_does_not_start() {
    let whole = file();
    let mut changed = whole.clone();
    changed[whole.len() / 2] ^= 0x10;
    let mut unchecked = whole;
    unchecked[HEADER + 4..HEADER + 8].fill(0);
    for file in [changed, unchecked] {
        let mut bench = UpdateBench::with(&[(0, file)], &[], board().fastest_bit_rate());
        assert_eq!(bench.next_mode(), MAINTENANCE);
    }
}

#[test]
fn a_file_for_another_board_is_rejected_before_a_byte_is_erased() {
    for (at, change) in [(0, 1), (1, 0x40)] {
        let mut bench = UpdateBench::empty();
        let mut other = file();
        other[HEADER + at] ^= change;
        bench.server.files.insert("other.bin".to_owned(), with_crc(other));
        bench.begin_update("fw.bin");
        bench.wait_for_program(10_000);
        bench.wait_in_the_bootloader();
        bench.begin_update("other.bin");
        // The bootloader gives up and starts the program that is still in flash.
        bench.wait_for_program(2000);
        let file = file();
        assert!(bench.flash(file.len()) == file, "the program is the one before");
    }
}

#[test]
fn invalid_files_are_rejected_and_the_next_valid_one_is_written() {
    let whole = file();
    let mut unchecked = whole.clone();
    unchecked[HEADER + 4..HEADER + 6].fill(0);
    let mut too_long = whole.clone();
    too_long[HEADER + 4..HEADER + 6].copy_from_slice(&0x7801u16.to_le_bytes());
    let mut bench = UpdateBench::empty();
    let random = (0..2000u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    bench.server.files.extend(
        [
            ("empty", vec![]),
            ("short", whole[..100].to_vec()),
            ("half", whole[..whole.len() / 2].to_vec()),
            ("uncheck", unchecked),
            ("long", too_long),
            ("random", random),
            ("changed", [&whole[..300], &[whole[300] ^ 1], &whole[301..]].concat()),
        ]
        .map(|(name, file)| (name.to_owned(), file)),
    );
    for name in ["empty", "short", "half", "uncheck", "long", "random", "changed", "missing"] {
        assert_eq!(bench.next_mode(), MAINTENANCE, "before {name}");
        assert_eq!(bench.begin_update(name), OK, "{name}");
        // The bootloader writes the longest file completely, and then finds its CRC wrong. After
        // that each start takes 75 ms to find it again. Then it hears a frame before it answers.
        bench.run_ms(2000);
        let known = bench.statuses().len();
        bench.wait_for(&format!("MAINTENANCE after {name}"), 5000, |bench| {
            bench.statuses()[known..].iter().any(|(_, status)| status[4] >> 3 & 7 == MAINTENANCE)
        });
    }
    assert_eq!(bench.begin_update("fw.bin"), OK);
    bench.wait_for_program(10_000);
}

#[test]
#[ignore = "takes long: make test-all"]
fn without_answers_the_bootloader_repeats_its_request_and_then_waits() {
    let mut bench = UpdateBench::empty();
    bench.server.is_silent = true;
    bench.begin_update("fw.bin");
    assert_eq!(bench.next_mode(), SOFTWARE_UPDATE);
    bench.run_ms(45_000);
    assert!((5..=20).contains(&bench.server.requests), "{}", bench.server.requests);
    assert_eq!(bench.next_mode(), MAINTENANCE);
    bench.server.is_silent = false;
    bench.begin_update("fw.bin");
    bench.wait_for_program(10_000);
}

#[test]
fn a_server_s_pause_of_some_seconds_does_not_stop_an_update() {
    let mut bench = UpdateBench::empty();
    bench.begin_update("fw.bin");
    bench.run_ms(300);
    bench.server.is_silent = true;
    bench.run_ms(6000);
    bench.server.is_silent = false;
    bench.wait_for_program(10_000);
}

#[test]
#[ignore = "takes long: make test-all"]
fn lost_frames_and_a_slow_server_delay_an_update() {
    for (drop, delay_ms) in [(9, 0), (0, 900)] {
        let mut bench = UpdateBench::empty();
        (bench.server.drop, bench.server.delay_ms) = (drop, delay_ms);
        bench.begin_update("fw.bin");
        bench.wait_for_program(120_000);
    }
}

#[test]
fn answers_that_are_repeated_or_late_are_not_written() {
    let mut bench = UpdateBench::empty();
    bench.server.is_repeating = true;
    bench.begin_update("fw.bin");
    bench.wait_for_program(120_000);
    let file = file();
    assert!(bench.flash(file.len()) == file, "the program in flash is the file");
}

/// An answer of less than 256 bytes means the end of the file.
#[test]
fn after_an_answer_of_less_than_256_bytes_nothing_is_erased() {
    let mut bench = UpdateBench::with(&[(0, file())], &[], board().fastest_bit_rate());
    bench.wait_for_program(3000);
    bench.wait_in_the_bootloader();
    bench.server.limit = 255;
    bench.begin_update("fw.bin");
    bench.wait_for_program(3000);
}

/// The bootloader sends NodeStatus each second, and the watchdog takes 16 ms.
#[test]
fn between_the_end_of_an_update_and_the_restart_the_bootloader_does_not_say_that_it_waits() {
    let mut bench = UpdateBench::with(&[(0, file())], &[], board().fastest_bit_rate());
    bench.wait_for_program(3000);
    let mut other = file();
    other[HEADER] ^= 1;
    bench.server.files.insert("other.bin".to_owned(), with_crc(other));
    // The first answer ends the update: in some of the turns just before the next NodeStatus.
    for before_status_ms in [12, 18] {
        bench.wait_in_the_bootloader();
        let last = bench.statuses().last().map_or(0, |(at, _)| *at);
        bench.run_ms(last + 1003 - before_status_ms - bench.now_ms());
        assert_eq!(bench.begin_update("other.bin"), OK);
        let known = bench.statuses().len();
        bench.wait_for_program(3000);
        for (at, status) in &bench.statuses()[known..] {
            assert_ne!(status[4] >> 3 & 7, MAINTENANCE, "{at} ms, turn {before_status_ms}");
        }
    }
}

#[test]
fn after_a_power_cut_at_any_time_a_second_update_succeeds() {
    let file = file();
    for cut_ms in [40, 60, 200, 333] {
        let mut bench = UpdateBench::with(&[(0, file.clone())], &[], board().fastest_bit_rate());
        bench.wait_for_program(3000);
        bench.wait_in_the_bootloader();
        bench.begin_update("fw.bin");
        bench.run_ms(cut_ms);
        bench.cut_power();
        assert_eq!(bench.next_mode(), MAINTENANCE, "after {cut_ms} ms");
        bench.begin_update("fw.bin");
        bench.wait_for_program(10_000);
        assert!(bench.flash(file.len()) == file, "the program in flash is the file");
    }
}

#[test]
fn the_bootloader_takes_the_update_from_ram_and_node_id_and_bit_rate_from_eeprom() {
    let mut bench = UpdateBench::with_bus_record();
    bench.server.files.insert("org.dronecan.servo168.1".to_owned(), file());
    bench.start_bootloader_with_update("org.dronecan.servo168.1");
    assert_eq!(bench.next_mode(), SOFTWARE_UPDATE);
    let reads = file().len().div_ceil(256) + 1;
    bench.wait_for("whole file", 20_000, |bench| bench.server.requests == reads);
    bench.run_ms(100);
    let file = file();
    assert!(bench.flash(file.len()) == file, "the program in flash is the file");
}

#[test]
fn a_second_request_is_answered_with_in_progress() {
    let mut bench = UpdateBench::empty();
    bench.server.delay_ms = 50;
    bench.begin_update("fw.bin");
    bench.run_ms(100);
    for path in ["fw.bin", "fw.bin2"] {
        assert_eq!(bench.begin_update(path), IN_PROGRESS, "{path}");
    }
    assert_eq!(bench.next_mode(), SOFTWARE_UPDATE);
    bench.wait_for_program(10_000);
}

#[test]
#[ignore = "takes long: make test-all"]
fn paths_up_to_24_characters_are_accepted() {
    for len in [1, 2, 3, 6, 7, 13, 24, 25, 60, 200] {
        let mut bench = UpdateBench::empty();
        let path = "p".repeat(len);
        bench.server.files.insert(path.clone(), file());
        if len <= 24 {
            assert_eq!(bench.begin_update(&path), OK, "{len}");
            bench.wait_for_program(10_000);
        } else {
            assert_eq!(bench.begin_update(&path), UNKNOWN, "{len}");
            assert_eq!(bench.next_mode(), MAINTENANCE, "{len}");
        }
    }
}

#[test]
fn the_bootloader_restarts_for_the_magic_number_only() {
    let mut bench = UpdateBench::empty();
    bench.run_ms(3000);
    for at in 0..MAGIC.len() {
        let mut wrong = MAGIC;
        wrong[at] ^= 4;
        assert_eq!(bench.call(RESTART_NODE, &wrong), [0], "{wrong:02X?}");
    }
    assert_eq!(bench.call(RESTART_NODE, &MAGIC), [0x80]);
    // It restarts a second later, and sends a second after that.
    bench.run_ms(2400);
    let uptime = |status: &[u8]| u32::from_le_bytes(status[..4].try_into().unwrap());
    assert_eq!(uptime(bench.statuses().last().expect("a status").1), 1, "the uptime begins anew");
}

#[test]
fn three_watchdog_resets_start_the_bootloader_and_the_reset_pin_the_program() {
    use bench::avr::ResetCause::{External, Watchdog};
    let mut bench = UpdateBench::with_program();
    bench.wait_for_program(1500);
    for _ in 0..2 {
        bench.bench.board(0).reset(Watchdog);
        bench.wait_for_program(3000);
    }
    bench.bench.board(0).reset(Watchdog);
    bench.run_ms(100);
    assert_eq!(bench.next_mode(), MAINTENANCE);
    bench.bench.board(0).reset(External);
    bench.wait_for_program(3000);
}

/// The loader leaves the flags of MCUSR for the program.
#[test]
fn the_program_behind_the_loader_tells_that_a_brown_out_restarted_it() {
    use bench::avr::ResetCause::{BrownOut, External, PowerOn};
    const BROWN_OUT: u16 = 2;
    let mut bench = UpdateBench::with_program();
    bench.wait_for_program(1500);
    for (cause, code) in [(BrownOut, BROWN_OUT), (External, 0), (BrownOut, BROWN_OUT), (PowerOn, 0)]
    {
        bench.bench.board(0).reset(cause);
        bench.wait_for_program(3000);
        let statuses = bench.statuses();
        let status = statuses.last().expect("a status").1;
        assert_eq!(u16::from_le_bytes([status[5], status[6]]), code, "{cause:?}");
    }
}

#[test]
fn the_bootloader_recovers_after_the_controller_lost_its_power() {
    let mut bench = UpdateBench::empty();
    bench.next_mode();
    // The bootloader checks the controller once a second.
    bench.bench.board(0).chip_reset();
    bench.bench.run_for_ms(1500);
    bench.bench.board(0).take_violations();
    assert_eq!(bench.next_mode(), MAINTENANCE);
}

/// Asks for updates of a node that gives pulses on all of its `outputs`, at 64 phases of their
/// period.
#[track_caller]
fn assert_updates_shorten_no_pulse(elf: &Path, outputs: u8) {
    // The program hands the request over when it polls the controller, each 10 ms. At 50 pulses a
    // second that is at two phases only. At 61 a poll is 0.61 periods after the one before, so 64
    // polls have phases 0.2 to 0.4 ms apart.
    const POLL_MS: u64 = 10;
    const RATE_HZ: i64 = 61;
    const ROUNDS: u64 = 64;
    let mut rig = Rig::running_elf(elf, started_with(elf));
    rig.set("OUT_RATE", RATE_HZ);
    if outputs > 1 {
        rig.set("OUT_COUNT", i64::from(outputs));
    }
    rig.save();
    // The board gets the bootloader, too, but each reset starts the program.
    let loader = bootloader(rig.board().wiring())
        .and_then(|hex| Firmware::read_hex(&hex))
        .unwrap_or_else(|error| panic!("{error:#}"));
    for (address, bytes) in &loader.flash {
        rig.board().avr_mut().load_flash(*address, bytes);
    }
    rig.board().reset(ResetCause::PowerOn);
    rig.run_ms(150);

    let width_us = |output: u8| 2000.0 - 100.0 * f32::from(output);
    let commands: Vec<_> = (0..outputs).map(|n| (n + 1, PWM, width_us(n))).collect();
    for round in 0..ROUNDS {
        rig.forget();
        rig.take_pulses();
        let resets = rig.board().avr().resets().len();
        rig.send_commands(&commands);
        rig.run_ms(2);
        // The vehicle is disarmed, so the node accepts an update at once.
        rig.send(ARMING_STATUS | 10, &[NOT_ARMED, 0xC0 | (round % 32) as u8]);
        rig.run_ms(40 + round * POLL_MS);
        let request = NumberAndText { number: 0, text: b"fw.bin".to_vec() };
        rig.request(&Message::BeginUpdate(request));
        // The answer, the hand-over 100 ms later, and the start of the program.
        rig.run_ms(300);
        assert_eq!(rig.board().avr().resets_after(resets).len(), 1, "round {round}");

        for (output, pulses) in (0..outputs).zip(rig.take_pulses()) {
            let count = pulses.len();
            assert!(count > 5, "round {round}, output {}: {count} pulses", output + 1);
            // Interrupts switch outputs 2 to 8, so an edge may be half a microsecond off. The last
            // pulse may be 3 us longer: the program ends it without an interrupt.
            let expected = f64::from(width_us(output));
            let (least, most) =
                if output == 0 { (expected, expected) } else { (expected - 0.6, expected + 3.0) };
            for width in pulses.iter().map(|pulse| pulse.width_us()) {
                let is_whole = (least..=most).contains(&width);
                assert!(is_whole, "round {round}, output {}: {width} us", output + 1);
            }
        }
    }
}

#[test]
#[ignore = "takes long: make test-all"]
fn an_update_shortens_no_pulse_whatever_its_phase() {
    assert_updates_shorten_no_pulse(&elf(), 1);
}

#[test]
#[ignore = "takes long: make test-all"]
fn an_update_shortens_no_pulse_of_several_outputs_whatever_its_phase() {
    assert_updates_shorten_no_pulse(&Program::With("full").elf(), 6);
}

#[test]
fn a_program_in_use_rejects_an_update_with_a_reason() {
    const IN_USE: &[u8] = b"armed, or a command in the last 2 s";
    let elf = elf();
    let firmware = Firmware::read(&elf).unwrap_or_else(|error| panic!("{error:#}"));
    let mut rig = Rig::running_elf(&elf, started_with(&elf));
    // With the trim as its failsafe, the servo would show one.
    rig.set("OUT1_FS", 1);
    rig.save();
    let eeprom = rig.board().avr().eeprom();
    let mut bench = UpdateBench::with(&firmware.flash, &eeprom, board().fastest_bit_rate());
    bench.wait_for_program(1500);
    // An ArmingStatus, and then an ArrayCommand with a position.
    for (id, data, us) in [
        (0x1804_4C0A, &[255, 0xC0][..], None),
        (0x1003_F20A, &[1, 0, 0, 0x38, 0xC7][..], Some(1750.0)),
    ] {
        bench.send(id, data);
        bench.run_ms(20);
        let response = bench.call(BEGIN_FIRMWARE_UPDATE, b"\0fw.bin");
        assert_eq!((response[0], &response[1..]), (INVALID_MODE, IN_USE), "{id:08X}");
        // What is rejected begins no failsafe either.
        bench.run_ms(20);
        bench.bench.board(0).take_servo_pulses();
        bench.run_ms(100);
        let pulses = bench.bench.board(0).take_servo_pulses();
        let widths: Vec<_> = pulses.iter().map(|pulse| pulse.width_us().round()).collect();
        let as_commanded = widths.iter().all(|&width| Some(width) == us);
        assert!(as_commanded && widths.is_empty() == us.is_none(), "{id:08X}: {widths:?}");
        bench.run_ms(5880);
    }
    let long = [&[0][..], &[b'p'; 25]].concat();
    let response = bench.call(BEGIN_FIRMWARE_UPDATE, &long);
    assert_eq!(
        (response[0], &response[1..]),
        (INVALID_MODE, &b"path longer than 24 characters"[..])
    );
    assert_eq!(bench.begin_update("fw.bin"), OK);
    bench.wait_for("first read", 1000, |bench| bench.server.requests > 0);
}

#[test]
fn a_program_that_hangs_repeatedly_starts_the_bootloader() {
    let mut bench = UpdateBench::with_program();
    bench.wait_for_program(1500);
    // WDR is 0x95A8; the last one of the program is in the main loop. RJMP to itself is 0xCFFF.
    let mut program = bench.flash(file().len());
    let wdr = (0x68..program.len() - 1)
        .step_by(2)
        .rfind(|&at| program[at..at + 2] == [0xA8, 0x95])
        .expect("a main loop");
    program[wdr..wdr + 2].copy_from_slice(&[0xFF, 0xCF]);
    bench.bench.board(0).avr_mut().load_flash(0, &with_crc(program));
    bench.run_ms(3000);
    assert_eq!(bench.next_mode(), MAINTENANCE);
    assert_eq!(bench.begin_update("fw.bin"), OK);
    bench.wait_for_program(10_000);
}

/// Messages of other nodes with a higher priority than the server's answers take 60 % of the bus.
#[test]
fn a_busy_bus_delays_an_update() {
    let mut bench = UpdateBench::empty();
    bench.fill_bus_percent = 60;
    bench.run_ms(1000);
    assert_eq!(bench.begin_update("fw.bin"), OK);
    bench.wait_for_program(30_000);
    let file = file();
    assert!(bench.flash(file.len()) == file, "the program in flash is the file");
}

/// Frames for another node use the same services and transfer IDs.
#[test]
fn an_update_of_another_node_at_the_same_time_changes_nothing() {
    let mut bench = UpdateBench::empty();
    assert_eq!(bench.begin_update("fw.bin"), OK);
    for n in 0..400u32 {
        // file.Read responses, and requests, to node 121.
        bench.send(0x1E30_79FF, &[0xA5, 0xA5, 0, 0, 1, 2, 3, 0x80 | (n % 32) as u8]);
        bench.send(0x1E28_F9FF, &[0, b'x', 0xC0 | (n % 32) as u8]);
        bench.run_ms(1);
    }
    bench.wait_for_program(10_000);
    let file = file();
    assert!(bench.flash(file.len()) == file, "the program in flash is the file");
}

/// After each cut the board runs a complete program or waits in the bootloader.
#[test]
#[ignore = "takes long: make test-all"]
fn after_a_hundred_random_power_cuts_updates_still_succeed() {
    let whole = file();
    let mut random = Noise::new(2);
    let mut bench = UpdateBench::with(&[(0, whole.clone())], &[], board().fastest_bit_rate());
    for cut in 0..100 {
        if bench.next_mode() != MAINTENANCE {
            bench.wait_in_the_bootloader();
        }
        assert_eq!(bench.begin_update("fw.bin"), OK, "cut {cut}");
        let end = bench.bench.now() + random.below(900 * MS);
        while bench.bench.now() < end {
            bench.step();
        }
        bench.cut_power();
        let mode = bench.next_mode();
        assert!(mode <= MAINTENANCE, "mode {mode} after cut {cut}");
        assert!(
            mode == MAINTENANCE || bench.flash(whole.len()) == whole,
            "an incomplete program runs after cut {cut}"
        );
    }
    if bench.next_mode() != MAINTENANCE {
        bench.wait_in_the_bootloader();
    }
    bench.begin_update("fw.bin");
    bench.wait_for_program(10_000);
    assert!(bench.flash(whole.len()) == whole, "the program in flash is the file");
}
