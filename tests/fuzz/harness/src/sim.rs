//! Target `sim`: the simulator's inputs: firmware as Intel HEX and as ELF, scripts and logs to
//! play, faults with their times, streams of a bus plan; levels on the wire, and bytes to the
//! MCP2515, which a faulty node can send in any order.
//!
//! The first byte of the input selects one of them.

use bench::avr::{Chip, Firmware};
use bench::can::{Engine, EngineMode, Event, Frame, Level, OnWire as _, Station as _};
use bench::mcp2515::Mcp2515;
use sim::fault::Injection;
use sim::links::script;
use sim::time::parse_duration;
use sim::utilisation::{Cost, Entry};

/// Runs an input.
pub fn run(input: &[u8]) {
    let Some((&kind, rest)) = input.split_first() else { return };
    match kind % 7 {
        0 => hex(&String::from_utf8_lossy(rest)),
        1 => check(&Firmware::parse(rest)),
        2 => script(&String::from_utf8_lossy(rest)),
        3 => faults(&String::from_utf8_lossy(rest)),
        4 => plan(&String::from_utf8_lossy(rest)),
        5 => wire(rest),
        _ => chip(rest),
    }
}

/// A program that fits a chip must be inside the chip's flash.
fn check(firmware: &Result<Firmware, impl Sized>) {
    let Ok(firmware) = firmware else { return };
    let _ = firmware.chip();
    for chip in Chip::ALL.into_iter().filter(|chip| firmware.check_fits(*chip).is_ok()) {
        assert!(
            firmware.flash.iter().all(|(start, bytes)| start + bytes.len() <= chip.flash_bytes())
        );
    }
}

/// The lines unchanged, and with valid checksums.
fn hex(text: &str) {
    check(&Firmware::parse_hex(text));
    let right = |line: &str| {
        let digits: Vec<u8> = line.bytes().filter(u8::is_ascii_hexdigit).collect();
        let value = |digit: u8| char::from(digit).to_digit(16).unwrap_or(0) as u8;
        let bytes =
            digits.as_chunks::<2>().0.iter().map(|[high, low]| value(*high) << 4 | value(*low));
        let bytes: Vec<u8> = bytes.collect();
        let sum = bytes.iter().fold(0u8, |sum, byte| sum.wrapping_sub(*byte));
        let line: String = bytes.iter().map(|byte| format!("{byte:02X}")).collect();
        format!(":{line}{sum:02X}\n")
    };
    check(&Firmware::parse_hex(&text.lines().map(right).collect::<String>()));
}

/// Scripts, complete and line by line. Parsed entries must be in the order of their times.
fn script(text: &str) {
    for part in std::iter::once(text).chain(text.lines()) {
        if let Ok(actions) = script::parse(part) {
            assert!(actions.is_sorted_by_key(|(at, _)| *at));
        }
    }
}

fn faults(text: &str) {
    for line in text.lines() {
        let _ = parse_duration(line);
        if let Ok(injection) = line.parse::<Injection>() {
            let again: Injection = injection.to_string().parse().expect("its text parses");
            assert_eq!(again.fault, injection.fault);
            // The text has the time in seconds, and an f64 has 53 bits for it.
            assert!(
                again.at.abs_diff(injection.at) <= 1 + injection.at / (1 << 50),
                "{again} from {injection}"
            );
        }
    }
}

/// A stream must need more than zero bits.
fn plan(text: &str) {
    for line in text.lines().take(4) {
        for stream in line.parse::<Entry>().map(|entry| entry.0).unwrap_or_default() {
            let cost = Cost::of(&stream);
            let bits = cost.bits;
            assert!(
                0.0 < bits.least && bits.least <= bits.typical && bits.typical <= bits.most,
                "{line}: {bits:?}"
            );
        }
    }
}

/// After any levels, with a frame to send meanwhile, and a sufficiently long idle bus, the next
/// frame must be received.
fn wire(bytes: &[u8]) {
    /// Bits of the recovery from bus-off (128 times 11 recessive bits) and of the integration after
    /// it.
    const RECOVERY: usize = 128 * 11 + 32;
    let mut engine = Engine::new();
    engine.set_mode(EngineMode::Normal);
    let own = Frame::extended(0x1234_5678, &[0x55, 0, 0xFF]);
    for byte in bytes {
        for bit in 0..8 {
            // For half of the byte values the receiver has a frame to send, too.
            let level = engine.drive((byte & 1 != 0).then_some(&own));
            let noise = Level::from_bit(byte >> bit & 1 != 0);
            let _ = engine.sample(if byte & 2 != 0 { noise } else { level });
        }
    }
    for _ in 0..RECOVERY {
        engine.drive(None);
        let _ = engine.sample(Level::Recessive);
    }
    assert!(engine.is_idle());
    let mut received = None;
    for bit in own.wire_bits() {
        let level = if engine.drive(None).is_dominant() { Level::Dominant } else { bit };
        received =
            received.or(engine.sample(level).find(|event| matches!(event, Event::Received(_))));
    }
    assert_eq!(received, Some(Event::Received(own)));
}

/// Instructions to the MCP2515, each with a length and its bytes, with bits on the bus in between.
/// Then RESET must lead to configuration mode.
fn chip(mut bytes: &[u8]) {
    const RESET: u8 = 0xC0;
    const CANSTAT: u8 = 0x0E;
    const READ: u8 = 0x03;
    const CONFIGURATION: u8 = 0x80;
    /// Cycles of an SPI byte at 8 MHz, and of a bit at 1 Mbit/s.
    const SHORT: u64 = 16;
    /// Longer than the start of the oscillator.
    const LONG: u64 = 1000;
    let mut chip = Mcp2515::new(16_000_000);
    let mut at = LONG;
    let mut instruction = |chip: &mut Mcp2515, bytes: &[u8], levels: u8| {
        chip.select(at);
        let answer = bytes.iter().map(|&byte| {
            chip.begin_byte(at);
            at += SHORT;
            chip.end_byte(byte, at)
        });
        let answer = answer.last();
        chip.deselect(at);
        if chip.bit_time_ps().is_some() {
            for bit in 0..8 {
                chip.drive(at);
                at += SHORT;
                chip.sample(Level::from_bit(levels >> bit & 1 != 0), at);
            }
        }
        at += LONG;
        answer
    };
    while let [first, levels, rest @ ..] = bytes {
        let (these, rest) = rest.split_at(usize::from(first % 16).min(rest.len()));
        instruction(&mut chip, these, *levels);
        bytes = rest;
    }
    instruction(&mut chip, &[RESET], 0xFF);
    assert_eq!(
        instruction(&mut chip, &[READ, CANSTAT, 0], 0xFF).map(|canstat| canstat & 0xE0),
        Some(CONFIGURATION)
    );
}
