//! Listens before the loader sends, so that it does not disturb a bus of another bit rate.
//!
//! In listen-only mode the controller neither acknowledges frames nor sends error frames
//! (DS20001801J 10.3). It receives invalid frames, too, so the loader leaves this mode when it has
//! received a frame and there was no error. If it has seen errors in a second, it tries the next of
//! the board's bit rates. After [`SILENCE_LIMIT_S`] seconds with neither it takes the bit rate of
//! the record.
//!
//! Then it tries each frame once, until one has passed: the bit rate is right. At the first frame
//! of others that is not valid it listens again, with the next bit rate.

use firmware::hardware::CAN_CRYSTAL_HZ;
use firmware::tables::bit_rate::HIGHEST_RATE;
use mcp2515_ordered::BitTiming;

use crate::can::{LISTEN_ONLY, MODE, NORMAL, TRIAL};
use crate::variables::{CNF1, CNF2, QUIET_S};
use crate::{can, clock};

/// Seconds without a frame or an error before the loader sends.
const SILENCE_LIMIT_S: u8 = 3;

/// [`QUIET_S`] when the loader begins to listen at any time of a second. The rest of that second
/// does not count.
const BEFORE_FIRST_SECOND: u8 = u8::MAX;

/// What comes next.
pub enum Next {
    /// The loader may send.
    Send,
    /// The loader goes on listening.
    Listen,
    /// The bit rate or the mode has changed: the controller is to be set up.
    Configure,
    /// The bus is silent: the controller is to be set up with the bit rate of the record.
    UseRecord,
}

/// True if the bit rate may be wrong.
#[inline(always)]
pub fn is_unsure() -> bool {
    MODE.read() != NORMAL
}

/// Begins to listen.
#[inline(always)]
pub fn begin() {
    MODE.write(LISTEN_ONLY);
}

/// The bit rate is right: a frame has passed.
pub fn trust() {
    MODE.write(NORMAL);
    can::set_mode();
}

/// Does a turn of listening, or of a trial.
#[inline(always)]
pub fn turn() -> Next {
    let flags = can::interrupt_flags();
    if MODE.read() == TRIAL {
        if flags & can::TX0IF != 0 {
            trust();
            return Next::Send;
        }
        if !can::has_received_error() {
            return Next::Send;
        }
        MODE.write(LISTEN_ONLY);
    } else {
        // Flags of a frame, without MERRF.
        if flags as i8 > 0 {
            MODE.write(TRIAL);
            return Next::Configure;
        }
        if !clock::take_second() {
            return Next::Listen;
        }
        if flags == 0 {
            let quiet = QUIET_S.read().wrapping_add(1);
            QUIET_S.write(quiet);
            if quiet != SILENCE_LIMIT_S {
                return Next::Listen;
            }
            MODE.write(TRIAL);
            return Next::UseRecord;
        }
    }
    QUIET_S.write(BEFORE_FIRST_SECOND);
    choose_next_rate();
    Next::Configure
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
    let cnf1 = CNF1.read();
    if CNF2.read() != SECOND.cnf2() {
        CNF2.write(SECOND.cnf2());
    } else if cnf1 < LOWEST.cnf1() {
        CNF1.write(cnf1 << 1 | 1);
    } else {
        CNF1.write(HIGHEST.cnf1());
        CNF2.write(HIGHEST.cnf2());
    }
}
