//! Listens before the loader sends, so that it does not disturb a bus of another bit rate.
//!
//! In listen-only mode the controller neither acknowledges frames nor sends error frames
//! (DS20001801J 10.3). The loader leaves this mode when it has received a whole frame: then the bit
//! rate is right. If it has seen errors in a second, it tries the next of the board's bit rates.
//! After [`SILENCE_LIMIT_S`] seconds with neither it takes the bit rate of the record: at a wrong
//! rate, too, traffic would have caused errors.

use firmware::hardware::CAN_CRYSTAL_HZ;
use firmware::tables::bit_rate::HIGHEST_RATE;
use mcp2515_ordered::BitTiming;

use crate::can::{LISTEN_ONLY, MODE, NORMAL};
use crate::variables::{CNF1, CNF2, QUIET_S};
use crate::{can, clock};

/// Seconds without a frame or an error before the loader sends.
const SILENCE_LIMIT_S: u8 = 3;

/// What comes next.
pub enum Next {
    /// The loader goes on listening.
    Listen,
    /// The bit rate or the mode has changed: the controller is to be set up.
    Configure,
    /// The bus is silent: the controller is to be set up with the bit rate of the record.
    UseRecord,
}

/// True if the loader must not send yet.
#[inline(always)]
pub fn is_listening() -> bool {
    MODE.read() != NORMAL
}

/// Begins to listen.
#[inline(always)]
pub fn begin() {
    MODE.write(LISTEN_ONLY);
}

/// Does a turn of listening.
#[inline(always)]
pub fn turn() -> Next {
    let flags = can::interrupt_flags();
    if flags & (can::RX0IF | can::RX1IF) != 0 {
        MODE.write(NORMAL);
        return Next::Configure;
    }
    if !clock::take_second() {
        return Next::Listen;
    }
    if flags & can::MERRF != 0 {
        QUIET_S.write(0);
        choose_next_rate();
        return Next::Configure;
    }
    let quiet = QUIET_S.read() + 1;
    QUIET_S.write(quiet);
    if quiet != SILENCE_LIMIT_S {
        return Next::Listen;
    }
    MODE.write(NORMAL);
    Next::UseRecord
}

/// Timing of the board's highest bit rate, and of the lower ones, each of which is half the one
/// before.
const HIGHEST: BitTiming = BitTiming::new(CAN_CRYSTAL_HZ, 125_000 << HIGHEST_RATE);
const SECOND: BitTiming = BitTiming::new(CAN_CRYSTAL_HZ, 125_000 << (HIGHEST_RATE - 1));
const LOWEST: BitTiming = BitTiming::new(CAN_CRYSTAL_HZ, 125_000);

/// Sets the next lower bit rate, or the highest one after the lowest.
#[inline(always)]
fn choose_next_rate() {
    // The lower rates differ in the prescaler only, which is 0, 1 and, if there is a third, 3.
    const {
        let mut rate = 0;
        while rate < HIGHEST_RATE {
            let timing = BitTiming::new(CAN_CRYSTAL_HZ, 125_000 << (HIGHEST_RATE - 1 - rate));
            assert!(timing.cnf1() == (1 << rate) - 1);
            assert!(timing.cnf2() == SECOND.cnf2() && timing.cnf3() == HIGHEST.cnf3());
            rate += 1;
        }
        assert!(HIGHEST.cnf1() == 0 && HIGHEST.cnf2() != SECOND.cnf2());
    }
    let mut cnf1 = CNF1.read();
    let mut cnf2 = SECOND.cnf2();
    if CNF2.read() == cnf2 {
        cnf1 = cnf1 << 1 | 1;
        if cnf1 > LOWEST.cnf1() {
            cnf1 = HIGHEST.cnf1();
            cnf2 = HIGHEST.cnf2();
        }
    }
    CNF1.write(cnf1);
    CNF2.write(cnf2);
}
