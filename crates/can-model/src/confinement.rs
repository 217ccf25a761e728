//! Fault confinement: the two error counters of a node and the state they put it in.
//!
//! The rules are lettered in ISO 11898-1:2003 13.1.4.2 (and Bosch CAN 2.0B "Fault confinement");
//! [`Engine`](super::Engine) decides which rule applies; this file changes the counters.

/// The error state of a node, from its counters.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Hash)]
pub enum ErrorState {
    /// Sends active (dominant) error flags.
    Active,
    /// A counter is at 128 or more: sends passive (recessive) error flags and pauses before
    /// sending.
    Passive,
    /// The transmit error counter passed 255 (bus-off): drives nothing.
    BusOff,
}

/// Either counter at this value makes a node error passive.
const PASSIVE_AT: u16 = 128;
/// A transmit error counter above this makes a node leave the bus.
const TEC_LIMIT: u16 = 255;
/// Real chips have eight bits; no rule depends on a higher value.
const REC_LIMIT: u16 = 255;
/// The specification allows 119 to 127 after a success beyond 127. This is the lowest, with which
/// one more error of 8 does not make the node error-passive again.
const REC_AFTER_SUCCESS: u16 = 119;
/// Increment for a severe error.
const SEVERE: u16 = 8;

/// TEC and REC.
#[derive(Clone, Copy, Default, Debug)]
pub(super) struct Confinement {
    pub tec: u16,
    pub rec: u16,
}

impl Confinement {
    pub fn state(&self) -> ErrorState {
        if self.tec > TEC_LIMIT {
            ErrorState::BusOff
        } else if self.tec >= PASSIVE_AT || self.rec >= PASSIVE_AT {
            ErrorState::Passive
        } else {
            ErrorState::Active
        }
    }

    /// Rule a): a receiver found an error.
    pub fn receive_error(&mut self) {
        self.rec = (self.rec + 1).min(REC_LIMIT);
    }

    /// Rules b), e), f) for a receiver: dominant bits after its flag, a bit error in its flag.
    pub fn severe_receive_error(&mut self) {
        self.rec = (self.rec + SEVERE).min(REC_LIMIT);
    }

    /// Rules c), d), f) for a transmitter. Does not count beyond the limit.
    pub fn transmit_error(&mut self) {
        if self.tec <= TEC_LIMIT {
            self.tec += SEVERE;
        }
    }

    /// Rule g): a frame was sent and acknowledged.
    pub fn transmitted(&mut self) {
        self.tec = self.tec.saturating_sub(1);
    }

    /// Rule h): a frame was received and acknowledged.
    pub fn received(&mut self) {
        self.rec =
            if self.rec >= PASSIVE_AT { REC_AFTER_SUCCESS } else { self.rec.saturating_sub(1) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_is_passive_from_128_and_off_from_256() {
        let state = |tec, rec| Confinement { tec, rec }.state();
        assert_eq!(state(127, 127), ErrorState::Active);
        assert_eq!(state(128, 0), ErrorState::Passive);
        assert_eq!(state(0, 128), ErrorState::Passive);
        assert_eq!(state(255, 255), ErrorState::Passive);
        assert_eq!(state(256, 0), ErrorState::BusOff);
    }
}
