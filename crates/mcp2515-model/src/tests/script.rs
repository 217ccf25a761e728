//! Tables of tests. A line that is not indented names a test, which begins with a new [`Bench`]: a
//! section of DS20001801J and what it says. The indented lines below it are statements, with `;`
//! between those of a line. Bytes are hexadecimal or the datasheet's names, and `|` joins bits; a
//! frame is in candump's form. `each $a $b: 1 2, 3 4+5` repeats the test with these words; `+` is a
//! space.
//!
//! | statement | |
//! | --- | --- |
//! | `set up`, `in MODE` | sets 1 Mbit/s and no filters; and then enters the mode |
//! | `request MODE`, `enter MODE` | sets REQOP; and then expects OPMOD after the time of a frame |
//! | `OPMOD = MODE` | expects the mode in CANSTAT, read through the SPI |
//! | `mode = MODE` | expects the mode without a use of the SPI |
//! | `A <- BYTE...` | WRITE from address A on |
//! | `modify A MASK BYTE` | BIT MODIFY |
//! | `A = BYTE...` | expects these bytes from address A on |
//! | `shows A BYTE` | expects the byte at A without a use of the SPI |
//! | `A & MASK = BYTE` | expects these bits at address A |
//! | `spi BYTE... -> BYTE...` | any instruction, and if it matters the last bytes of the answer |
//! | `load N FRAME`, `rts MASK` | loads the registers of a standard frame, requests buffers |
//! | `send FRAME` | both, with buffer 0 |
//! | `got FRAME...` | expects that the peer has received these frames since the last `got` |
//! | `peer FRAME...`, `queue FRAME` | the peer sends frames; waits until they have ended or not |
//! | `accepts FRAME...`, `rejects FRAME...` | expects that RXB0, or no buffer, takes each |
//! | `busy` | the peer begins a frame, 000 with 8 bytes |
//! | `unplug`, `plug`, `witness` | no node acknowledges; again; a second node does |
//! | `flip BIT`, `stuck`, `free` | a fault of the bus: a bit of the next frame; dominant; none |
//! | `bits N`, `wait`, `reset` | N bits pass; the time of a frame; RESET and its time |
//! | `unacknowledged`, `acknowledged` | expects that the peer has counted errors, or none |
//! | `counts A` | expects that the error counter at A is not 0 |
//! | `overflows N` | expects the model's count of frames lost |
//! | `int low`, `int high` | expects the level of INT |
//! | `violation WORD...` | expects one violation that has these words |

use super::support::*;
use can_model::{Fault, Frame, SoftNode};
use std::cell::RefCell;
use std::rc::Rc;

/// Runs the tests of a table.
#[track_caller]
pub fn run_all(table: &str) {
    let mut tests: Vec<(&str, Vec<&str>)> = vec![];
    for line in table.lines().filter(|line| !line.is_empty()) {
        match (line.starts_with(' '), tests.last_mut()) {
            (true, Some((_, script))) => script.extend(line.split(';').map(str::trim)),
            _ => tests.push((line, vec![])),
        }
    }
    assert!(!tests.is_empty());
    for (name, script) in tests {
        match script[0].strip_prefix("each ").and_then(|each| each.split_once(": ")) {
            None => run_one(name, &script.join(";")),
            Some((places, rows)) => {
                for row in rows.split(", ") {
                    let mut script = script[1..].join(";");
                    for (place, words) in places.split(' ').zip(row.split(' ')) {
                        script = script.replace(place, &words.replace('+', " "));
                    }
                    run_one(&format!("{name} ({row})"), &script);
                }
            }
        }
    }
}

/// Runs a script on a chip after power-up. No violation may be left.
#[track_caller]
fn run_one(name: &str, script: &str) {
    let mut bench = Bench::new();
    for statement in script.split(';') {
        run(&mut bench, statement, &format!("{name}: \"{statement}\""));
    }
    let violations = bench.violations();
    assert!(violations.is_empty(), "{name}: unexpected violations: {violations:#?}");
}

#[track_caller]
fn run(bench: &mut Bench, statement: &str, what: &str) {
    let words: Vec<&str> = statement.split_whitespace().collect();
    match words[..] {
        ["in", mode] => {
            bench.set_up();
            bench.enter(byte(mode));
        }
        ["set", "up"] => bench.set_up(),
        ["request", mode] => bench.request(byte(mode)),
        ["enter", mode] => bench.enter(byte(mode)),
        ["OPMOD", "=", mode] => assert_eq!(bench.read(CANSTAT) & 0xE0, byte(mode), "{what}"),
        ["mode", "=", mode] => assert_eq!((bench.mode() as u8) << 5, byte(mode), "{what}"),
        [address, "<-", ref values @ ..] => bench.write(byte(address), &bytes(values)),
        ["modify", address, mask, value] => bench.modify(byte(address), byte(mask), byte(value)),
        [address, "=", ref values @ ..] => {
            let read = bench.read_many(byte(address), values.len());
            assert_eq!(hex(&read), hex(&bytes(values)), "{what}");
        }
        [address, "&", mask, "=", value] => {
            let read = bench.read(byte(address)) & byte(mask);
            assert_eq!(hex(&[read]), hex(&[byte(value)]), "{what}");
        }
        ["shows", address, value] => {
            let shown = bench.chip.borrow().register(byte(address));
            assert_eq!(hex(&[shown]), hex(&[byte(value)]), "{what}");
        }
        ["spi", ref words @ ..] => {
            let (sent, expected) = split(words, "->");
            let answer = bench.spi(&bytes(sent));
            let expected = bytes(expected);
            assert!(answer.ends_with(&expected), "{what}: {}", hex(&answer));
        }
        ["load", n, frame] => load(bench, byte(n), frame),
        ["rts", mask] => bench.rts(byte(mask)),
        ["send", frame] => {
            load(bench, 0, frame);
            bench.rts(1);
        }
        ["got", ref expected @ ..] => assert_eq!(bench.peer_received(), frames(expected), "{what}"),
        ["peer", ref sent @ ..] => bench.peer_sends(&frames(sent)),
        [verb @ ("accepts" | "rejects"), ref sent @ ..] => {
            for text in sent {
                bench.peer_sends(&frames(&[text]));
                let flags = bench.read(CANINTF);
                assert_eq!(flags, u8::from(verb == "accepts"), "{what}: {text}");
                bench.write(CANINTF, &[0]);
            }
        }
        ["queue", frame] => bench.peer.borrow_mut().send(frames(&[frame])[0]),
        ["busy"] => bench.occupy_bus(),
        ["unplug"] => bench.bus.connect(bench.peer_port, false),
        ["plug"] => bench.bus.connect(bench.peer_port, true),
        ["witness"] => {
            bench.bus.attach("witness", Rc::new(RefCell::new(SoftNode::new(1_000_000))));
            bench.run_bits(50);
        }
        ["flip", bit] => bench.bus.inject(Fault::FlipBit { bit: decimal(bit) as u32 }),
        ["stuck"] => bench.bus.inject(Fault::StuckDominant(true)),
        ["free"] => bench.bus.clear_faults(),
        ["bits", count] => bench.run_bits(decimal(count)),
        ["wait"] => bench.run_bits(FRAME_BITS),
        ["reset"] => bench.reset(),
        ["counts", address] => assert_ne!(bench.read(byte(address)), 0, "{what}"),
        ["unacknowledged"] => assert_ne!(bench.peer.borrow().tec(), 0, "{what}"),
        ["acknowledged"] => assert_eq!(bench.peer.borrow().tec(), 0, "{what}"),
        ["overflows", n] => {
            assert_eq!(bench.chip.borrow().rx_overflows() as u64, decimal(n), "{what}")
        }
        ["int", level] => assert_eq!(bench.int_is_low(), level == "low", "{what}"),
        ["violation", ref words @ ..] => {
            let found = bench.violations();
            let [text] = &found[..] else { panic!("{what}: {found:#?}") };
            assert!(words.iter().all(|word| text.contains(word)), "{what}: {text}");
        }
        _ => panic!("{what}: no such statement"),
    }
}

fn split<'a>(words: &'a [&'a str], at: &str) -> (&'a [&'a str], &'a [&'a str]) {
    match words.iter().position(|word| *word == at) {
        Some(position) => (&words[..position], &words[position + 1..]),
        None => (words, &[]),
    }
}

fn byte(text: &str) -> u8 {
    let bits = text.split('|').map(|bit| match NAMED.iter().find(|(name, _)| *name == bit) {
        Some((_, value)) => *value,
        None => u8::from_str_radix(bit, 16).unwrap_or_else(|_| panic!("{bit} is no byte")),
    });
    bits.fold(0, |all, bit| all | bit)
}

fn bytes(words: &[&str]) -> Vec<u8> {
    words.iter().map(|word| byte(word)).collect()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X} ")).collect()
}

fn decimal(text: &str) -> u64 {
    text.parse().unwrap_or_else(|_| panic!("{text} is no number"))
}

fn frames(words: &[&str]) -> Vec<Frame> {
    words.iter().map(|text| text.parse().unwrap_or_else(|_| panic!("{text} is no frame"))).collect()
}

fn load(bench: &mut Bench, n: u8, text: &str) {
    let frame = frames(&[text])[0];
    let can_model::Id::Standard(id) = frame.id else { panic!("{text} is extended") };
    bench.load(n, id, frame.data());
}
