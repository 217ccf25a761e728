//! The TWI as the only master of its bus (datasheet section 22): START, addresses, bytes in both
//! directions, STOP, with the times of TWBR and TWSR. What is on the bus is a [`TwiBus`]; without
//! one nothing acknowledges.
//!
//! Not modelled: slave mode, other masters, devices that hold SCL, the levels of SDA and SCL.

use std::cell::{Cell, RefCell};

use super::base::{Base, Peripheral, Timer};
use super::chip::Chip;
use super::core::Vector;
use super::processor::TwiBus;
use super::regs::{TWBR, TWCR, TWDR, TWEA, TWEN, TWIE, TWINT, TWPS, TWSR, TWSTA, TWSTO, TWWC};
use sim_base::Cycles;
use sim_base::Noise;

/// Expires when what the TWI does on the bus is done.
const TIMER: Timer = Timer::Twi;

/// Periods of SCL: a byte and its acknowledgement; a START or a STOP.
const BYTE_BITS: Cycles = 9;
const CONDITION_BITS: Cycles = 1;

/// The bits of TWCR that the program sets and clears.
const CONTROL: u8 = TWEA | TWSTA | TWSTO | TWEN | TWIE;

/// Status codes (tables 22-2 and 22-3).
mod status {
    pub const START: u8 = 0x08;
    pub const REPEATED_START: u8 = 0x10;
    pub const WRITE_ADDRESS: [u8; 2] = [0x20, 0x18];
    pub const WRITTEN: [u8; 2] = [0x30, 0x28];
    pub const READ_ADDRESS: [u8; 2] = [0x48, 0x40];
    pub const READ: [u8; 2] = [0x58, 0x50];
    /// Nothing to report.
    pub const NONE: u8 = 0xF8;
}

/// What the master has done last, which decides what it does next.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum State {
    /// The bus is free.
    #[default]
    Idle,
    /// After a START: the address follows.
    Started,
    /// The device takes bytes.
    Writing,
    /// The device gives bytes.
    Reading,
    /// Nobody has acknowledged the address to read from: no byte follows.
    Refused,
}

/// What happens on the bus until the timer expires.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Action {
    Start,
    /// A STOP, and then a START if true.
    Stop(bool),
    /// The byte in TWDR, after a START or to a device.
    Send,
    Receive,
}

/// The TWI.
#[derive(Default)]
pub(super) struct Twi {
    state: Cell<State>,
    action: Cell<Option<Action>>,
    bus: RefCell<Option<Box<dyn TwiBus>>>,
}

impl Twi {
    /// Connects what is on the bus, in place of what was there.
    pub fn set_bus(&self, bus: Box<dyn TwiBus>) {
        self.bus.replace(Some(bus));
    }

    /// Calls the bus. `absent` is the result if nothing is there.
    fn with_bus<T>(&self, absent: T, call: impl FnOnce(&mut dyn TwiBus) -> T) -> T {
        self.bus.borrow_mut().as_mut().map_or(absent, |bus| call(&mut **bus))
    }

    fn write_control(&self, base: &Base, value: u8) {
        let core = &base.core;
        let flags = core.get(TWCR) & (TWINT | TWWC);
        core.set(TWCR, value & CONTROL | flags);
        if value & TWINT != 0 {
            core.clear(Vector::Twi);
            core.clear_bits(TWCR, TWINT);
        }
        if value & TWEN == 0 {
            if self.state.take() != State::Idle {
                self.with_bus((), |bus| bus.stop());
            }
            self.action.set(None);
            base.unschedule(TIMER);
            core.clear_bits(TWCR, TWSTO);
            set_status(base, status::NONE);
        } else if core.get(TWCR) & TWINT != 0 {
            self.interrupt_returns(base);
        } else if self.action.get().is_none() {
            self.begin(base, core.get(TWCR));
        }
    }

    /// Begins what TWCR asks for, once TWINT is 0.
    fn begin(&self, base: &Base, control: u8) {
        let action = match self.state.get() {
            _ if control & TWSTO != 0 => Action::Stop(control & TWSTA != 0),
            _ if control & TWSTA != 0 => Action::Start,
            State::Idle | State::Refused => return,
            State::Started | State::Writing => Action::Send,
            State::Reading => Action::Receive,
        };
        let bits = match action {
            Action::Start | Action::Stop(_) => CONDITION_BITS,
            Action::Send | Action::Receive => BYTE_BITS,
        };
        self.action.set(Some(action));
        base.schedule(TIMER, base.now() + bits * period(base));
    }

    fn finish(&self, base: &Base, action: Action) {
        let core = &base.core;
        let byte = core.get(TWDR);
        let (state, status) = match action {
            Action::Stop(restarts) => {
                self.with_bus((), |bus| bus.stop());
                self.state.set(State::Idle);
                core.clear_bits(TWCR, TWSTO);
                set_status(base, status::NONE);
                // A STOP sets no flag (section 22.9.2).
                if restarts {
                    self.begin(base, TWSTA);
                }
                return;
            }
            Action::Start if self.state.get() == State::Idle => (State::Started, status::START),
            Action::Start => (State::Started, status::REPEATED_START),
            Action::Send if self.state.get() == State::Started => {
                let is_read = byte & 1 != 0;
                let is_there =
                    self.with_bus(false, |bus| bus.address(base.now(), byte >> 1, is_read));
                match (is_read, is_there) {
                    (false, _) => (State::Writing, status::WRITE_ADDRESS[usize::from(is_there)]),
                    (true, true) => (State::Reading, status::READ_ADDRESS[1]),
                    (true, false) => (State::Refused, status::READ_ADDRESS[0]),
                }
            }
            Action::Send => {
                let is_taken = self.with_bus(false, |bus| bus.write(byte));
                (State::Writing, status::WRITTEN[usize::from(is_taken)])
            }
            Action::Receive => {
                core.set(TWDR, self.with_bus(0xFF, |bus| bus.read()));
                let acknowledges = core.get(TWCR) & TWEA != 0;
                let state = if acknowledges { State::Reading } else { State::Refused };
                (state, status::READ[usize::from(acknowledges)])
            }
        };
        self.state.set(state);
        set_status(base, status);
        core.raise(Vector::Twi);
    }
}

impl Peripheral for Twi {
    fn for_chip(_: Chip) -> Twi {
        Twi::default()
    }

    fn writes(&self) -> &'static [u16] {
        &[TWSR, TWDR, TWCR]
    }

    fn reads(&self) -> &'static [u16] {
        &[TWDR]
    }

    fn timers(&self) -> &'static [Timer] {
        &[TIMER]
    }

    fn write(&self, base: &Base, address: u16, value: u8) {
        let core = &base.core;
        match address {
            TWCR => self.write_control(base, value),
            TWSR => core.set(TWSR, core.get(TWSR) & !TWPS | value & TWPS),
            // > The TWWC bit is set when attempting to write to the TWI Data Register - TWDR when
            // > TWINT is low. This flag is cleared by writing the TWDR Register when TWINT is high.
            // > (section 22.9.2)
            _ if core.get(TWCR) & TWINT == 0 && core.get(TWCR) & TWEN != 0 => {
                core.set_bits(TWCR, TWWC);
            }
            _ => {
                core.clear_bits(TWCR, TWWC);
                core.set(TWDR, value);
            }
        }
    }

    fn expire(&self, base: &Base, _: Timer, _: Cycles) {
        if let Some(action) = self.action.take() {
            self.finish(base, action);
        }
    }

    fn reset(&self, base: &Base, _: &mut Noise) {
        if self.state.take() != State::Idle {
            self.with_bus((), |bus| bus.stop());
        }
        self.action.set(None);
        base.core.set(TWSR, status::NONE);
        base.core.set(TWDR, 0xFF);
    }

    /// TWINT interrupts as long as it is set.
    fn interrupt_returns(&self, base: &Base) {
        if base.core.get(TWCR) & (TWINT | TWIE) == TWINT | TWIE {
            base.core.raise(Vector::Twi);
        }
    }
}

/// Sets the five bits of the status.
fn set_status(base: &Base, status: u8) {
    base.core.set(TWSR, base.core.get(TWSR) & TWPS | status);
}

/// Length of a period of SCL in CPU cycles (section 22.5.2).
fn period(base: &Base) -> Cycles {
    let prescaler = 1 << (2 * (base.core.get(TWSR) & TWPS));
    16 + 2 * Cycles::from(base.core.get(TWBR)) * prescaler
}
