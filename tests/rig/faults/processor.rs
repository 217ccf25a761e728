//! Faults of the processor, its memory and its clock.

use super::{COMMANDED_US, Case, Measured, Trial};
use crate::status::{self, CONTROLLER, STACK_COLLISION, STRAY_INTERRUPT as STRAY, WATCHDOG};
use crate::{MS, Rig, status_fields};
use bench::Cycles;
use bench::avr::ResetCause;
use bench::budget::Budget;
use bench::dronecan::{Message, Opcode};

/// Timer1's register with the modes of its outputs (ATmega168 datasheet section 16.11.1).
const TCCR1A: u16 = 0x80;
const COM1A_AND_COM1B: u8 = 0xF0;

/// Limit of the time from a restart to full service.
const LIMIT_MS: u64 = 200;

pub const ALL: [&Case; 9] = [
    &HANG,
    &STRAY_INTERRUPT,
    &STACK,
    &BROWN_OUT,
    &BROWN_OUT_DURING_SAVE,
    &RESET_PIN,
    &POWER_CUT,
    &MILLISECONDS_WRAP,
    &UPTIME_WRAPS,
];

const NO_PULSE: &str = "complete pulses until the restart, then none until the next command";
const RESTARTED: &str = "restarted";
const CASE: Case = Case {
    fault: "",
    noticed: "",
    reaction: RESTARTED,
    servo: NO_PULSE,
    logged_limit_ms: Some(50),
    limit_ms: LIMIT_MS,
    run: Measured::default,
};

/// Overwrites the instructions where the main loop resets the watchdog. Returns the unchanged
/// program.
fn patch_the_main_loop(rig: &mut Rig, instructions: &[u8]) -> Vec<u8> {
    let flash = rig.board().avr().flash().to_vec();
    // WDR is 0x95A8. The last one of the program is in the main loop.
    let wdr = (0x68..Budget::of(crate::board().chip).flash as usize)
        .step_by(2)
        .rfind(|&at| flash[at..at + 2] == [0xA8, 0x95])
        .expect("a main loop");
    rig.board().avr_mut().load_flash(wdr, instructions);
    flash
}

/// Runs a case in which `fault` makes the program restart and log the reason `line`.
fn restarted_by(line: &'static str, reported: u16, fault: impl FnOnce(&mut Trial)) -> Measured {
    let mut trial = Trial::running();
    trial.begin(line, |_| {});
    fault(&mut trial);
    trial.end(|_| {});
    trial.recover(LIMIT_MS, reported)
}

pub const HANG: Case = Case {
    fault: "the main loop hangs",
    noticed: "watchdog, 250 ms (reset cause 1)",
    logged_limit_ms: Some(350),
    run: || {
        let mut trial = Trial::running();
        let mut program = Vec::new();
        // RJMP to itself.
        trial.begin("reset: WATCHDOG", |rig| program = patch_the_main_loop(rig, &[0xFF, 0xCF]));
        // Restores the program after the watchdog's reset, which clears TCCR1A. The restarted
        // program may hang again before.
        let end = trial.begun + 300 * MS;
        while trial.rig.board().avr().sram(TCCR1A) & COM1A_AND_COM1B != 0 && trial.rig.now() < end {
            trial.rig.run_ms(1);
        }
        trial.rig.board().avr_mut().load_flash(0, &program);
        super::assert_servo(&trial.rig, &[COMMANDED_US]);
        assert!(trial.rig.pulses.len() > 10, "pulses must continue while the program hangs");
        trial.rig.pulses.clear();
        trial.live(50);
        trial.end(|_| {});
        assert_eq!(
            trial.rig.board().avr().resets().len(),
            1,
            "it must restart without a reset of the chip, which would start the bootloader"
        );
        trial.recover(LIMIT_MS, WATCHDOG)
    },
    ..CASE
};

pub const STRAY_INTERRUPT: Case = Case {
    fault: "an interrupt without a handler",
    noticed: "default handler (reset cause 4)",
    run: || {
        restarted_by("reset: STRAY INTERRUPT", STRAY, |trial| {
            // TIMSK1.TOIE1: Timer1 overflows at the end of each servo period.
            trial.rig.board().avr_mut().poke_sram(0x6F, 1);
            trial.live(21);
        })
    },
    logged_limit_ms: Some(70),
    ..CASE
};

pub const STACK: Case = Case {
    fault: "the stack reaches the statics",
    noticed: "a painted word between them, checked each millisecond (reset cause 5)",
    run: || {
        restarted_by("reset: STACK COLLISION", STACK_COLLISION, |trial| {
            let avr = trial.rig.board().avr_mut();
            let bottom = avr.symbol("__heap_start").expect("a symbol").address as u16;
            avr.poke_sram(bottom, 0);
            trial.live(20);
        })
    },
    ..CASE
};

fn reset(line: &'static str, cause: ResetCause, reported: u16) -> Measured {
    let mut trial = Trial::running();
    // Nobody reads while the processor starts.
    trial.rig.overflows_expected = crate::corner().start_ms() > 0;
    trial.begin(line, |rig| rig.board().reset(cause));
    trial.live(20);
    assert_reset_ended_pulses(&trial);
    trial.end_unchecked(|_| {});
    trial.recover(LIMIT_MS, reported)
}

/// Checks that the reset ended the pulse in progress and that no pulse followed.
#[track_caller]
fn assert_reset_ended_pulses(trial: &Trial) {
    let widths: Vec<f64> = trial.rig.pulses.iter().map(|pulse| pulse.width_us()).collect();
    if let Some((last, whole)) = widths.split_last() {
        assert!(whole.iter().all(|us| *us == COMMANDED_US) && *last <= COMMANDED_US, "{widths:?}");
    }
}

pub const BROWN_OUT: Case = Case {
    fault: "the processor's supply is too low for a moment",
    noticed: "brown-out detector (reset cause 2)",
    run: || reset("reset: BROWN-OUT", ResetCause::BrownOut, status::BROWN_OUT),
    servo: "no pulse until the next command; the reset ends the current pulse",
    ..CASE
};

pub const BROWN_OUT_DURING_SAVE: Case = Case {
    fault: "the processor's supply is too low for a moment while it writes its EEPROM",
    noticed: "brown-out detector (reset cause 2)",
    reaction: "restarted, with all old or all new parameters",
    run: || {
        let mut worst = Measured::default();
        // In milliseconds after the request; some are in the middle of a byte's write.
        for delay in [1, 8, 23, 60, 111, 180, 233] {
            let mut trial = Trial::running();
            // Nobody reads while the processor starts.
            trial.rig.overflows_expected = crate::corner().start_ms() > 0;
            trial.rig.set("TEMP_ID", 4242);
            trial.begin("reset: BROWN-OUT", |rig| {
                rig.request(&Message::ExecuteOpcode(Opcode::SAVE));
                rig.run_ms(delay);
                rig.board().reset(ResetCause::BrownOut);
            });
            trial.live(20);
            assert_reset_ended_pulses(&trial);
            trial.end_unchecked(|_| {});
            let logged_ms = delay as f64;
            let measured = trial.recover(LIMIT_MS, status::BROWN_OUT);
            let set = (trial.rig.get("TEMP_ID"), trial.rig.get("OUT1_TIMEOUT"));
            assert!(
                [(1, 1000), (4242, 300)].contains(&set),
                "{set:?} after a dip {delay} ms into a save"
            );
            worst = worst.or(Measured {
                logged_ms: measured.logged_ms.map(|ms| ms - logged_ms),
                ..measured
            });
        }
        worst
    },
    ..BROWN_OUT
};

pub const RESET_PIN: Case = Case {
    fault: "the reset pin is pulled",
    noticed: "the logged reset cause; not a fault",
    run: || reset("reset: reset pin", ResetCause::External, 0),
    ..BROWN_OUT
};

pub const POWER_CUT: Case = Case {
    fault: "the power is switched off and on",
    noticed: "the logged reset cause; not a fault",
    run: || reset("reset: power-on", ResetCause::PowerOn, 0),
    ..BROWN_OUT
};

/// Finds a counter in RAM: addresses whose `len` bytes are within `tolerance` of `value_at(now)` at
/// each of `times` moments.
fn find_counter(
    rig: &mut Rig,
    len: usize,
    tolerance: u64,
    value_at: impl Fn(Cycles) -> u64,
    times: u32,
) -> Vec<u16> {
    let floor = rig.board().avr().symbol("__heap_start").expect("a symbol").address as u16;
    let mut found: Vec<u16> = (0x100..floor - len as u16).collect();
    for _ in 0..times {
        let now = rig.now();
        let ram = rig.board().avr().sram_range(0x100..=floor - 1);
        let expected = value_at(now);
        found.retain(|&at| {
            let bytes = &ram[usize::from(at - 0x100)..][..len];
            let value = bytes.iter().rev().fold(0, |value, byte| value << 8 | u64::from(*byte));
            expected.saturating_sub(tolerance) <= value && value <= expected + tolerance
        });
        rig.run_ms(1337);
    }
    found
}

/// The 16-bit clock and all deadlines wrap every 65.536 s. The node must behave as at other times.
pub const MILLISECONDS_WRAP: Case = Case {
    fault: "the millisecond counter wraps, every 65.536 s",
    noticed: "nothing to notice",
    reaction: "none needed: the program uses differences only",
    servo: "follows",
    logged_limit_ms: None,
    limit_ms: 100,
    run: || {
        let mut trial = Trial::running();
        // Runs to a second before the wrap, then through it with commands, statuses and a request.
        let quiet = 64_500 * MS;
        while trial.rig.now() < quiet {
            trial.live(500);
            trial.rig.forget();
        }
        trial.begin("", |_| {});
        trial.live(2500);
        assert!(
            trial
                .rig
                .serial
                .lines()
                .all(|line| !line.contains("FAILSAFE") && !line.contains("reset:"))
        );
        let statuses = trial.rig.statuses();
        let gaps: Vec<u64> = statuses.windows(2).map(|pair| (pair[1].0 - pair[0].0) / MS).collect();
        assert!(!gaps.is_empty() && gaps.iter().all(|gap| (980..=1020).contains(gap)), "{gaps:?}");
        // The failsafe was not triggered, and no pulse is missing.
        super::assert_servo(&trial.rig, &[COMMANDED_US]);
        trial.end(|_| {});
        let measured = trial.recover(100, 0);
        // A timeout that spans the wrap did not end early.
        assert_eq!(trial.rig.status_now().1, 0);
        Measured { logged_ms: None, ..measured }
    },
};

/// Sets the uptime forward in RAM: shortly before 49.7 days (2^32 ms) and before the end of its 32
/// bits. The transfer IDs wrap, too.
pub const UPTIME_WRAPS: Case = Case {
    fault: "the uptime passes 49.7 days, and wraps after 136 years",
    noticed: "nothing to notice",
    reaction: "none needed",
    servo: "follows",
    logged_limit_ms: None,
    limit_ms: 100,
    run: || {
        let mut trial = Trial::running();
        trial.live(8000);
        // The uptime is a u32 in seconds.
        let places = find_counter(&mut trial.rig, 4, 0, |now| now / (1000 * MS), 5);
        let [uptime] = places[..] else { panic!("the uptime is at one of {places:x?}") };
        for near in [4_294_967 - 3, u32::MAX - 3] {
            for (byte, at) in near.to_le_bytes().into_iter().zip(uptime..) {
                trial.rig.board().avr_mut().poke_sram(at, byte);
            }
            trial.begin("", |_| {});
            trial.live(8000);
            let uptimes: Vec<u32> =
                trial.rig.statuses().iter().map(|(_, data)| status_fields(data).0).collect();
            assert!(uptimes.len() >= 7, "{uptimes:?}");
            for pair in uptimes.windows(2) {
                assert_eq!(pair[1].wrapping_sub(pair[0]), 1, "{uptimes:?}");
            }
            let has_passed = |uptime: &u32| uptime.wrapping_sub(near) >= 4;
            assert!(uptimes.iter().any(has_passed), "{uptimes:?}");
            super::assert_servo(&trial.rig, &[COMMANDED_US]);
        }
        // Transfer IDs are consecutive modulo 32.
        let numbers = trial.rig.statuses().iter().map(|(_, data)| data[7] & 31).collect::<Vec<_>>();
        for pair in numbers.windows(2) {
            assert_eq!(pair[1], (pair[0] + 1) % 32);
        }
        trial.end(|_| {});
        let measured = trial.recover(100, 0);
        assert_eq!(trial.rig.status_now().1 & CONTROLLER, 0);
        Measured { logged_ms: None, ..measured }
    },
};
