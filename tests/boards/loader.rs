//! The bootloader on the bus: it finds the bit rate before it sends, waits for slow servers, and
//! takes frames of each length.

use bench::can::Fault;
use bench::corner::Corner;

use crate::support::update_bench::*;

/// The bit rates that the board can use, highest first.
fn bit_rates() -> impl Iterator<Item = u32> {
    [1_000_000, 500_000, 250_000, 125_000]
        .into_iter()
        .filter(|rate| *rate <= board().fastest_bit_rate())
}

/// Without a record in EEPROM the bootloader begins with the board's highest rate.
#[test]
fn the_bootloader_finds_the_bit_rate_of_the_bus_without_disturbing_it() {
    for bit_rate in bit_rates() {
        let mut bench = UpdateBench::with_options(Options { bit_rate, ..Options::default() });
        let took_ms = bench.wait_for("NodeStatus", 6000, |bench| !bench.statuses().is_empty());
        println!("{bit_rate} bit/s: first NodeStatus after {took_ms} ms");
        assert_eq!(bench.call(GET_NODE_INFO, &[]).len(), 41);
        assert_eq!(bench.errors(), 0, "error frames at {bit_rate} bit/s");
    }
}

/// A program that hangs leads to the bootloader, whose record has another rate than the bus.
#[test]
#[ignore = "takes long: make test-all"]
fn a_record_with_the_wrong_bit_rate_disturbs_no_bus() {
    let eeprom = eeprom_with_bus_record();
    for bit_rate in bit_rates().filter(|rate| *rate != 125_000) {
        let options = Options { eeprom: &eeprom, bit_rate, ..Options::default() };
        let mut bench = UpdateBench::with_options(options);
        bench.node = 42;
        bench.wait_for("NodeStatus", 6000, |bench| !bench.statuses().is_empty());
        assert_eq!(bench.call(GET_NODE_INFO, &[]).len(), 41);
        assert_eq!(bench.errors(), 0, "{bit_rate}");
    }
}

/// The bootloader has begun to send, with the rate of its record, when the others begin, with
/// another one.
#[test]
#[ignore = "takes long: make test-all"]
fn after_a_silence_a_wrong_bit_rate_disturbs_few_frames() {
    let eeprom = eeprom_with_bus_record();
    for bit_rate in bit_rates().filter(|rate| *rate != 125_000) {
        let options = Options { eeprom: &eeprom, bit_rate, server_sends_status: false, flash: &[] };
        let mut bench = UpdateBench::with_options(options);
        bench.node = 42;
        bench.run_ms(6000);
        let silent = bench.errors();
        bench.server_begins_to_send_status();
        let took_ms = bench.wait_for("NodeStatus", 8000, |bench| !bench.statuses().is_empty());
        let errors = bench.errors();
        println!("{bit_rate} bit/s: {silent} + {errors} errors, NodeStatus after {took_ms} ms");
        // It tries twice before, if its oscillators are fast.
        let most = if rig::corner() == Corner::default() { 20 } else { 2 * 16 };
        assert!(silent + errors <= most, "{bit_rate}: {silent} + {errors} errors");
        assert_eq!(bench.call(GET_NODE_INFO, &[]).len(), 41);
        assert_eq!(bench.errors(), 0, "{bit_rate}");
    }
}

/// Each frame is broken in its data, so listen-only mode receives all of them.
#[test]
#[ignore = "takes long: make test-all"]
fn frames_that_are_only_heard_broken_are_no_proof_of_the_bit_rate() {
    let mut bench = UpdateBench::empty();
    bench.bench.bus().inject(Fault::DestroyFrames(true));
    bench.run_ms(5000);
    assert_eq!(bench.statuses(), []);
    bench.bench.bus().inject(Fault::DestroyFrames(false));
    bench.wait_for("NodeStatus", 6000, |bench| !bench.statuses().is_empty());
}

#[test]
fn on_a_silent_bus_the_bootloader_sends_after_three_seconds() {
    let options = Options { server_sends_status: false, ..Options::default() };
    let mut bench = UpdateBench::with_options(options);
    while bench.now_ms() < 3000 {
        bench.step();
        assert_eq!(bench.statuses(), []);
    }
    bench.wait_for("NodeStatus", 1500, |bench| !bench.statuses().is_empty());
}

/// A program that loops at its first instruction, in a file of `len` bytes.
fn short_file(len: usize) -> Vec<u8> {
    // RJMP to itself.
    let mut file = [0xFF, 0xCF].to_vec();
    file.resize(HEADER, 0);
    file.extend(&self::file()[HEADER..HEADER + 4]);
    file.extend((len as u16).to_le_bytes());
    file.extend((file.len()..len).map(|n| (n * 7) as u8));
    with_crc(file)
}

#[test]
#[ignore = "takes long: make test-all"]
fn a_server_that_takes_five_seconds_for_an_answer_is_slow_and_not_useless() {
    let mut bench = UpdateBench::empty();
    let file = short_file(400);
    bench.server.files.insert("short".to_owned(), file.clone());
    bench.server.delay_ms = 5000;
    bench.begin_update("short");
    // Two answers with new parts of the file, and the first one again.
    bench.run_ms(3 * 5100);
    assert!(bench.flash(file.len()) == file, "the program in flash is the file");
    assert!((6..=9).contains(&bench.server.requests), "{}", bench.server.requests);
}

/// Frames of all lengths, as transfers of two and three frames, for each service that the
/// bootloader puts together. One that is shorter than its CRC once made it read 65,535 bytes.
#[test]
fn no_length_of_frames_makes_the_bootloader_deaf_or_changes_what_it_says() {
    const BEGIN: u32 = 0x1E28_F8FF;
    const ANSWER: u32 = 0x1E30_78FF;
    for id in [BEGIN, ANSWER] {
        let mut bench = UpdateBench::empty();
        bench.next_mode();
        if id == ANSWER {
            bench.server.is_silent = true;
            bench.begin_update("fw.bin");
        }
        let info = bench.call(GET_NODE_INFO, &[])[5..].to_vec();
        for lengths in (0..9 * 9 * 9).map(|n| [n % 9, n / 9 % 9, n / 81]) {
            // The middle one is left out if it is empty.
            let frames: Vec<usize> = lengths
                .into_iter()
                .enumerate()
                .filter(|pair| *pair != (1, 0))
                .map(|pair| pair.1)
                .collect();
            for (n, len) in frames.iter().enumerate() {
                let (first, last) = (n == 0, n + 1 == frames.len());
                let mut data = vec![0x55; *len];
                if let Some(tail) = data.last_mut() {
                    *tail = u8::from(first) << 7 | u8::from(last) << 6 | (n as u8 % 2) << 5;
                }
                bench.send(id, &data);
            }
            let before = bench.now_ms();
            assert_eq!(bench.call(GET_NODE_INFO, &[])[5..], info, "{lengths:?}");
            assert!(bench.now_ms() - before < 20, "{lengths:?}: deaf");
        }
    }
}
