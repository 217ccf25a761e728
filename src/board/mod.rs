//! The board: an Arduino Diecimila (ATmega168 at 16 MHz) with a CAN-BUS shield (MCP2515 with a 16 MHz crystal).
//!
//! All of the firmware's `unsafe` and all its interrupts are in this directory. Every register that is used is written in
//! full at start, because the program can be restarted without a reset of the chip (see [`guard`]).
//!
//! | signal | pin | ATmega168 | how |
//! | --- | --- | --- | --- |
//! | MCP2515 INT | D2 | PD2, INT0 | input with pull-up, active low: an interrupt, and a level to look at (see [`bus`]) |
//! | MCP2515 CS | D9 | PB1 | output, active low |
//! | servo | D10 | PB2, OC1B | Timer1; also the SPI's SS, which must be an output for the SPI to stay master |
//! | MOSI, MISO, SCK | D11, D12, D13 | PB3, PB4, PB5 | SPI at 8 MHz, mode 0,0 |
//! | light | D3 | PD3, OC2B | Timer2 |
//! | button | D4 | PD4 | input with pull-up, pressed is low |
//! | temperature | A0 | ADC0 | LM35, against AVCC |
//! | serial monitor | D0, D1 | RXD, TXD | 115200 baud 8N1 |
//!
//! Timer0 counts milliseconds, by an interrupt.

mod adc;
mod bus;
#[cfg(feature = "button")]
mod button;
mod clock;
mod eeprom;
pub mod flash;
pub mod guard;
mod jitter;
#[cfg(feature = "lights")]
mod light;
mod pins;
mod serial;
mod servo;
mod spi;

use avr_device::atmega168::CPU;

use pins::Pins;

pub use adc::Adc;
pub use bus::Bus;
#[cfg(feature = "button")]
pub use button::Button;
pub use clock::Clock;
pub use eeprom::Eeprom;
pub use jitter::Jitter;
#[cfg(feature = "lights")]
pub use light::Light;
pub use serial::Serial;
pub use servo::Servo;

/// Crystal of the ATmega168, in hertz. Timer0, Timer1, the ADC and the UART are set up for it.
pub const CLOCK_HZ: u32 = 16_000_000;

/// Crystal of the MCP2515, in hertz.
pub const CAN_CRYSTAL_HZ: u32 = 16_000_000;

/// The parts of the board, set up.
pub struct Board {
    /// Milliseconds.
    pub clock: Clock,
    /// The serial monitor.
    pub serial: Serial,
    /// The CAN controller.
    pub bus: Bus,
    /// The servo output.
    pub servo: Servo,
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
    /// A source of noise, until the watchdog is started.
    pub jitter: Jitter,
    /// Where the cause of the last reset is.
    pub cpu: CPU,
}

impl Board {
    /// Sets everything up. To be called once.
    pub fn new() -> Self {
        // One by one, because `Peripherals` keeps a note of having been taken in RAM.
        macro_rules! peripheral {
            ($name:ident) => {
                // Safety: each register block is named once below, and this function is called once, by `main`, before any interrupt is let
                // in. The modules that steal a block again argue for it.
                unsafe { avr_device::atmega168::$name::steal() }
            };
        }
        // The servo's timer is still running after a restart, and drives its pin whatever the port is told. Before the SPI, which must find its SS
        // pin an output.
        let pins = Pins::new(peripheral!(PORTB), peripheral!(PORTD));
        Self {
            servo: Servo::new(peripheral!(TC1), pins.servo),
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
