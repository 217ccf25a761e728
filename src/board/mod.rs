//! The board: an Arduino at 16 MHz with an ATmega168 or ATmega328P, and a CAN board with an
//! MCP2515. avr-specs/boards.toml is the table of boards; [`firmware::hardware`] has what differs
//! between them. The two chips differ in the sizes of their memories only.
//!
//! All of the firmware's `unsafe` and all its interrupts are in this directory. The start code
//! writes every register in use in full, because the program can restart without a reset of the
//! chip (see [`guard`]).
//!
//! | signal | pin | of the chip | use |
//! | --- | --- | --- | --- |
//! | MCP2515 INT | D2 or D3 | INT0 or INT1 | input with pull-up, active low: an interrupt, and a level to poll (see [`bus`]) |
//! | MCP2515 CS | D9, D10 or another | | output, active low |
//! | servo | D10, or D9 if CS is on D10 | OC1B or OC1A | Timer1. D10 is also the SPI's SS, which must be an output so that the SPI stays master |
//! | MOSI, MISO, SCK | D11, D12, D13 | PB3, PB4, PB5 | SPI at 8 MHz, mode 0,0 |
//! | light | D3, unless INT is there | PD3, OC2B | Timer2 |
//! | button | D4 | PD4 | input with pull-up, low while pressed |
//! | temperature | A0 | ADC0 | LM35, against AVCC or the bandgap |
//! | serial monitor | D0, D1 | RXD, TXD | 115200 baud 8N1 |
//!
//! Timer0 counts milliseconds with an interrupt.

/// Makes a function the handler of an interrupt. `avr_device` wants the name of the chip.
macro_rules! interrupt {
    ($name:ident $body:block) => {
        #[cfg_attr(chip = "atmega168", avr_device::interrupt(atmega168))]
        #[cfg_attr(chip = "atmega328p", avr_device::interrupt(atmega328p))]
        fn $name() $body
    };
}

mod adc;
mod bus;
#[cfg(feature = "button")]
mod button;
mod clock;
mod eeprom;
pub mod flash;
pub mod guard;
mod header;
mod jitter;
mod label;
#[cfg(feature = "lights")]
mod light;
#[cfg(feature = "update")]
pub mod loader;
#[cfg(feature = "outputs")]
mod outputs;
mod pins;
mod serial;
#[cfg(not(feature = "outputs"))]
mod servo;
mod spi;
mod timer1;

/// The registers of the chip.
#[cfg(chip = "atmega168")]
use avr_device::atmega168 as chip;
#[cfg(chip = "atmega328p")]
use avr_device::atmega328p as chip;

use chip::CPU;
use pins::Pins;

pub use adc::Adc;
pub use bus::{Bus, has_backlog};
#[cfg(feature = "button")]
pub use button::Button;
pub use clock::Clock;
pub use eeprom::Eeprom;
pub use jitter::Jitter;
#[cfg(feature = "lights")]
pub use light::Light;
#[cfg(feature = "outputs")]
pub use outputs::Outputs;
pub use serial::Serial;
#[cfg(not(feature = "outputs"))]
pub use servo::Servo as Outputs;

/// Crystal of the Arduino, in hertz. The setup of Timer0, Timer1, the ADC and the UART depends on
/// it.
pub const CLOCK_HZ: u32 = 16_000_000;

/// The parts of the board, ready for use.
pub struct Board {
    /// The millisecond clock.
    pub clock: Clock,
    /// The serial monitor.
    pub serial: Serial,
    /// The CAN controller.
    pub bus: Bus,
    /// The servo output, or the outputs.
    pub servo: Outputs,
    /// The temperature sensor.
    pub adc: Adc,
    /// The light.
    #[cfg(feature = "lights")]
    pub light: Light,
    /// The push button.
    #[cfg(feature = "button")]
    pub button: Button,
    /// The EEPROM.
    pub eeprom: Eeprom,
    /// A source of random bits, until [`guard::start`] starts the watchdog.
    pub jitter: Jitter,
    /// The registers with the cause of the last reset.
    pub cpu: CPU,
}

impl Board {
    /// Sets up all parts. Call it once.
    pub fn new() -> Self {
        // Each register block separately: `Peripherals::take` stores in RAM that it was called.
        macro_rules! peripheral {
            ($name:ident) => {
                // Safety: each register block is named once below, and `main` calls this function
                // once, before interrupts are enabled. So each value is the only one of its
                // block here. A module that steals a block again argues for that at its place.
                unsafe { chip::$name::steal() }
            };
        }
        // The pins come before the SPI, whose SS pin must be an output. After a restart Timer1
        // still runs and drives the servo's pin, whatever the port registers hold.
        let pins = Pins::new(peripheral!(PORTB), peripheral!(PORTC), peripheral!(PORTD));
        Self {
            servo: Outputs::new(peripheral!(TC1), pins.servo),
            bus: Bus::new(peripheral!(SPI), peripheral!(EXINT), pins.can_interrupt),
            clock: Clock::new(peripheral!(TC0)),
            serial: Serial::new(peripheral!(USART0)),
            adc: Adc::new(peripheral!(ADC)),
            #[cfg(feature = "lights")]
            light: Light::new(peripheral!(TC2)),
            #[cfg(feature = "button")]
            button: Button::new(pins.button),
            eeprom: Eeprom::new(peripheral!(EEPROM)),
            jitter: Jitter::new(peripheral!(WDT)),
            cpu: peripheral!(CPU),
        }
    }
}
