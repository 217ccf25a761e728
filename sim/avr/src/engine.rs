//! What the engines and the models share: the choice of an engine, interrupts, states, timers.

/// What executes a program. The default is simavr, if the build has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Engine {
    /// The crate `avr-core`.
    Own,
    /// simavr, an independent simulator. Only with the feature `simavr`.
    Simavr,
}

/// Interrupt sources.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Vector {
    SpiTransferComplete,
    UsartReceiveComplete,
    UsartDataRegisterEmpty,
    UsartTransmitComplete,
    EepromReady,
    SpmReady,
    Twi,
    Adc,
    /// INT0 or INT1, by its number.
    External(u8),
    /// A change of a pin, by the index of the port.
    PinChange(u8),
    /// A timer, by its number and the mask of the flag in TIFRn.
    Timer(u8, u8),
    Watchdog,
}

/// State of the core.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Activity {
    Running,
    Sleeping,
    Crashed,
}

/// Kind of a program's access to memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Access {
    Read,
    Write,
}

macro_rules! timers {
    ($($(#[$doc:meta])* $name:ident,)*) => {
        /// A timer of a model. It has at most one expiry time.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(super) enum Timer {
            $($(#[$doc])* $name,)*
        }

        impl Timer {
            /// All timers, in the order of their numbers.
            pub const ALL: [Timer; Timer::COUNT] = [$(Timer::$name),*];
            pub const COUNT: usize = [$(stringify!($name)),*].len();
        }
    };
}

timers! {
    Spi,
    UartSend,
    UartReceive,
    Eeprom,
    Spm,
    Twi,
    /// Timer0, and so on.
    Counter0,
    Counter1,
    Counter2,
    /// Input capture of Timer1.
    Capture,
    /// Of the own engine.
    Watchdog,
    /// Of the own engine.
    Adc,
    /// The clocks start after a sleep.
    Wake,
    /// End of a run on simavr.
    Stop,
}
