//! Faults of the CAN controller and of its wires.

use super::{CHIP_LOGGED_LIMIT_MS, Case, FAILSAFE, Measured, Trial};
use crate::Rig;
use crate::status::CONTROLLER;

/// Durations of a lasting fault. They differ so that the fault ends in different phases of the
/// restarts, which are at least 100 ms apart.
const LASTS_MS: [u64; 3] = [600, 635, 670];
/// The node restarts the controller at most 100 ms after the fault; the controller is on the bus 5
/// ms later.
const LIMIT_MS: u64 = 300;

/// Registers that the driver checks (DS20001801J table 11-1), each with a mask of the bits that it
/// checks.
const WATCHED: [(u8, u8); 6] = [
    (0x28, 0x07), // CNF3
    (0x29, 0xBF), // CNF2 without SAM
    (0x2A, 0xFF), // CNF1
    (0x2B, 0xFF), // CANINTE
    (0x0F, 0xE8), // CANCTRL
    (0x60, 0x64), // RXB0CTRL
];
/// Addresses of RXF0SIDL to RXF5SIDL. Their bit [`EXIDE`] selects extended frames.
const RXF_SIDL: [u8; 6] = [0x01, 0x05, 0x09, 0x11, 0x15, 0x19];
const EXIDE: u8 = 0x08;

pub const ALL: [&Case; 12] = [
    &RESET, &BROWN_OUT, &NO_POWER, &HELD, &ASLEEP, &MISO_LOW, &MISO_HIGH, &FLIPPING, &REGISTER,
    &FILTER, &INT_HIGH, &INT_LOW,
];

const LOST: &str = "5V? MCP2515 settings lost";
const INT: &str = "INT open or shorted";
const STAYS: &str = "holds its position; the fault is over before the failsafe";
const STARTED_OVER: &str = "restarted, each register read back";

/// Runs a case whose fault happens once.
fn once(line: &'static str, fault: impl FnOnce(&mut Rig)) -> Measured {
    let mut trial = Trial::running();
    // The model reports accesses that are illegal in the chip's state, and the driver does not know
    // the state yet.
    trial.rig.violations_expected = true;
    trial.rig.overflows_expected = true;
    trial.begin(line, fault);
    trial.end(|_| {});
    trial.recover(LIMIT_MS, CONTROLLER)
}

/// Runs a case whose fault lasts, once for each of [`LASTS_MS`].
fn during(line: &'static str, fault: fn(&mut Rig, bool)) -> Measured {
    let measured = LASTS_MS.map(|lasts_ms| {
        let mut trial = Trial::running();
        trial.rig.violations_expected = true;
        trial.rig.overflows_expected = true;
        trial.begin(line, |rig| fault(rig, true));
        trial.live(lasts_ms);
        trial.end(|rig| fault(rig, false));
        trial.recover(LIMIT_MS, CONTROLLER)
    });
    measured.into_iter().reduce(Measured::or).expect("some")
}

const CASE: Case = Case {
    fault: "",
    noticed: "supervision every 10 ms (bit 8)",
    reaction: STARTED_OVER,
    servo: STAYS,
    logged_limit_ms: Some(CHIP_LOGGED_LIMIT_MS),
    limit_ms: LIMIT_MS,
    run: Measured::default,
};

pub const RESET: Case = Case {
    fault: "MCP2515 reset by a glitch",
    run: || once(LOST, |rig| rig.board().chip_reset()),
    ..CASE
};

pub const BROWN_OUT: Case = Case {
    fault: "MCP2515's supply is interrupted: all its registers are garbage",
    run: || {
        let all = (1..=12).map(|seed| once(LOST, |rig| rig.board().chip_brown_out(seed)));
        all.reduce(Measured::or).expect("some")
    },
    ..CASE
};

pub const NO_POWER: Case =
    Case {
        fault: "MCP2515 without power",
        reaction: "restarted ten times a second",
        servo: FAILSAFE,
        run: || {
            let of = |power: fn(&mut Rig, bool)| during("MCP2515", power);
            let low = of(|rig, off| {
                if off { rig.board().chip_power_off(0x00) } else { rig.board().chip_power_on() }
            });
            low.or(of(|rig, off| {
                if off { rig.board().chip_power_off(0xFF) } else { rig.board().chip_power_on() }
            }))
        },
        ..CASE
    };

pub const HELD: Case = Case {
    fault: "MCP2515 stuck in configuration mode",
    noticed: "supervision every 10 ms, and the mode that is read back at each start (bit 8)",
    reaction: "restarted six times a second",
    servo: FAILSAFE,
    run: || during(LOST, |rig, held| rig.board().chip_hold_in_configuration(held)),
    ..CASE
};

pub const ASLEEP: Case = Case {
    fault: "MCP2515 asleep",
    run: || once(LOST, |rig| rig.board().chip_fall_asleep()),
    ..CASE
};

pub const MISO_LOW: Case = Case {
    fault: "SPI reads all zeros",
    reaction: "restarted ten times a second",
    servo: FAILSAFE,
    run: || during("MCP2515", |rig, on| rig.board().set_stuck_miso(on.then_some(0x00))),
    ..CASE
};

pub const MISO_HIGH: Case = Case {
    fault: "SPI reads all ones",
    // The first line that names it can be one of those dropped: all ones are many errors.
    run: || during("5V?", |rig, on| rig.board().set_stuck_miso(on.then_some(0xFF))),
    ..MISO_LOW
};

pub const FLIPPING: Case = Case {
    fault: "SPI flips bits, 1 in 1,000 each way",
    noticed: "supervision every 10 ms, and the registers that are read back at each start (bit 8)",
    servo: "within its travel: the node cannot detect a flipped bit in a command",
    // By chance.
    logged_limit_ms: Some(2000),
    limit_ms: 500,
    run: || {
        let mut trial = Trial::running();
        trial.rig.violations_expected = true;
        trial.rig.overflows_expected = true;
        trial.begin("SI SO SCK? register", |rig| rig.board().set_spi_noise(1000, 5));
        trial.live(2000);
        for pulse in trial.rig.pulses.iter().skip(1) {
            assert_eq!(pulse.period_cycles, Some(super::SERVO_PERIOD), "the period");
        }
        let widths = trial.rig.pulses.iter().map(|pulse| pulse.width_us());
        assert!(
            widths.into_iter().all(|us| (1000.0..=2000.0).contains(&us)),
            "{:?}",
            trial.rig.pulses
        );
        trial.end_unchecked(|rig| rig.board().set_spi_noise(0, 0));
        assert_eq!(trial.rig.board().avr().resets().len(), 1, "only the power-on");
        // The next command corrects a pulse that comes from a misread command.
        trial.live(60);
        trial.rig.pulses.clear();
        trial.recover(500, CONTROLLER)
    },
    ..CASE
};

pub const REGISTER: Case = Case {
    fault: "a bit of CNF1 to CNF3, CANINTE, CANCTRL or RXB0CTRL flips",
    run: || {
        let bits = |(address, mask): (u8, u8)| {
            (0..8)
                .map(|bit| 1 << bit)
                .filter(move |bit| mask & bit != 0)
                .map(move |bit| (address, bit))
        };
        // Every third bit is enough: the driver compares all of them in one way.
        let all = WATCHED.into_iter().flat_map(|register| bits(register).step_by(3));
        let measured =
            all.map(|(address, bit)| once(LOST, |rig| rig.board().chip_flip_bits(address, bit)));
        measured.reduce(Measured::or).expect("some")
    },
    ..CASE
};

pub const FILTER: Case = Case {
    fault: "the filters change by themselves and reject commands",
    noticed: "failsafe (bit 10), because filters cannot be read while the controller runs \
              (DS20001801J 4.5)",
    reaction: "the failsafe restarts the controller",
    servo: FAILSAFE,
    logged_limit_ms: Some(400),
    limit_ms: 1300,
    run: || {
        let mut trial = Trial::running();
        trial.begin("FAILSAFE", |rig| {
            for filter in RXF_SIDL {
                rig.board().chip_flip_bits(filter, EXIDE);
            }
        });
        // Until the failsafe, after 300 ms.
        trial.live(320);
        trial.end(|_| {});
        trial.recover(1300, 0)
    },
};

pub const INT_HIGH: Case = Case {
    fault: "INT open, or shorted to 5 V",
    noticed: "supervision every 10 ms: a frame waits, and INT is high (bit 8)",
    reaction: "the chip is asked for frames in each turn",
    servo: "follows the commands",
    logged_limit_ms: Some(CHIP_LOGGED_LIMIT_MS),
    limit_ms: LIMIT_MS,
    run: || during(INT, |rig, on| rig.board().set_stuck_int(on.then_some(true))),
};

pub const INT_LOW: Case = Case {
    fault: "INT shorted to ground",
    noticed: "supervision every 10 ms: INT is low, and no frame waits (bit 8)",
    run: || during(INT, |rig, on| rig.board().set_stuck_int(on.then_some(false))),
    ..INT_HIGH
};
