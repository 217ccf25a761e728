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
//! | shaft | D3, or D2 if INT is on D3 | INT1 or INT0 | input with pull-up, with the feature `rpm`, in place of the light |
//! | button | D4 | PD4 | input with pull-up, low while pressed |
//! | temperature | A0 | ADC0 | LM35, against AVCC or the bandgap |
//! | serial monitor | D0, D1 | RXD, TXD | 115200 baud 8N1 |
//!
//! Timer0 counts milliseconds with an interrupt.

mod adc;
mod bus;
mod chip;
mod clock;
mod eeprom;
mod flash;
mod guard;
mod header;
mod jitter;
mod label;
mod pins;
mod serial;
mod spi;
mod timer1;

#[cfg_attr(not(feature = "button"), path = "absent/button.rs")]
mod button;
#[cfg_attr(not(feature = "lights"), path = "absent/light.rs")]
mod light;
#[cfg_attr(not(feature = "update"), path = "absent/loader.rs")]
mod loader;
#[cfg_attr(not(feature = "outputs"), path = "servo.rs")]
mod outputs;
#[cfg_attr(not(feature = "rpm"), path = "absent/shaft.rs")]
mod shaft;

use chip::CPU;
use firmware::handover::REQUEST_LEN;
use firmware::hardware::{Input, OUTPUTS, ShaftPulses};
use firmware::node::acceptance::NodeAcceptance;
use firmware::program::Board;
use firmware::tables::condition::ResetCause;
use firmware::tables::parameters::Parameters;
use mcp2515_ordered::{Attempts, Configuration, Frame, Notice, State};

use adc::Adc;
use bus::Bus;
use button::Button;
use clock::Clock;
use eeprom::Eeprom;
use flash::Image;
use jitter::Jitter;
use light::Light;
use outputs::Outputs;
use pins::Pins;
use serial::Serial;
use shaft::Shaft;

/// The Arduino with its CAN board, ready for use.
pub struct Arduino {
    clock: Clock,
    serial: Serial,
    bus: Bus,
    outputs: Outputs,
    adc: Adc,
    light: Light,
    button: Button,
    shaft: Shaft,
    eeprom: Eeprom,
    /// A source of random bits, until [`guard::start`] starts the watchdog.
    jitter: Jitter,
    /// The registers with the cause of the last reset.
    cpu: CPU,
}

impl Arduino {
    /// Sets up all of it. Call it once.
    pub fn new() -> Self {
        // Each register block separately: `Peripherals::take` stores in RAM that it was called.
        macro_rules! peripheral {
            ($name:ident) => {
                // Safety: each register block is named once below, and `main` calls this function
                // once, before interrupts are enabled. So each value is the only one of its block
                // here. A module that steals a block again argues for that at its place.
                unsafe { chip::steal::<chip::$name>() }
            };
        }
        // The pins come before the SPI, whose SS pin must be an output. After a restart Timer1
        // still runs and drives the servo's pin, whatever the port registers hold.
        let pins = Pins::new(peripheral!(PORTB), peripheral!(PORTC), peripheral!(PORTD));
        Self {
            outputs: Outputs::new(peripheral!(TC1), pins.servo),
            bus: Bus::new(peripheral!(SPI), peripheral!(EXINT), pins.can_interrupt),
            clock: Clock::new(peripheral!(TC0)),
            serial: Serial::new(peripheral!(USART0)),
            adc: Adc::new(peripheral!(ADC)),
            light: Light::new(peripheral!(TC2)),
            button: Button::new(pins.button),
            shaft: Shaft::new(peripheral!(TC2)),
            eeprom: Eeprom::new(peripheral!(EEPROM)),
            jitter: Jitter::new(peripheral!(WDT)),
            cpu: peripheral!(CPU),
        }
    }
}

impl Board for Arduino {
    type Flash = Image;
    type Outputs = Outputs;
    type Eeprom = Eeprom;
    type Counters = Bus;

    const FLASH: Image = Image;
    fn reset_cause(&mut self) -> ResetCause {
        guard::reset_cause(&self.cpu)
    }
    fn eeprom_and_noise(&mut self) -> (&mut Eeprom, impl FnMut() -> u8) {
        let Self { eeprom, jitter, .. } = self;
        (eeprom, || jitter.sample())
    }
    fn start(&mut self, parameters: &Parameters, controller: Configuration<NodeAcceptance<Image>>) {
        self.outputs.start(parameters);
        self.bus.controller(|can| can.configure(controller));
        guard::start();
    }
    fn begin_turn(&mut self) {
        guard::restart_watchdog();
    }
    fn has_ticked(&self) -> bool {
        self.clock.has_ticked()
    }
    fn tick(&mut self) -> u8 {
        guard::check_stack();
        self.clock.tick()
    }
    fn now_ms(&self) -> u16 {
        self.clock.now_ms()
    }
    fn has_frame(&mut self) -> bool {
        self.bus.has_frame()
    }
    fn act_on_frame(&mut self, act: impl FnOnce(&Frame)) {
        self.bus.act_on_frame(act);
    }
    fn controller(&mut self, now_ms: u16) -> State {
        self.bus.controller(|can| can.state(now_ms))
    }
    fn is_controller_empty(&mut self) -> bool {
        self.bus.controller(|can| can.is_empty())
    }
    fn poll_controller(&mut self, now_ms: u16) -> Option<Notice> {
        self.bus.poll(now_ms)
    }
    fn set_filters(&mut self, now_ms: u16, acceptance: NodeAcceptance<Image>, attempts: Attempts) {
        self.bus.controller(|can| {
            can.reconfigure(now_ms, |configuration| {
                configuration.acceptance = acceptance;
                configuration.attempts = attempts;
            });
        });
    }
    fn find_room(&mut self) {
        self.bus.controller(|can| can.find_room());
    }
    fn send_frame(&mut self, frame: &Frame) {
        // The interrupts of several outputs take time. So a received frame waits only for half of
        // this one.
        if OUTPUTS == 1 {
            self.bus.controller(|can| can.transmit(frame));
        } else {
            self.bus.controller(|can| can.begin_transmit(frame));
            self.bus.controller(|can| can.finish_transmit(frame));
        }
    }
    fn counters(&self) -> &Bus {
        &self.bus
    }
    fn outputs(&mut self) -> &mut Outputs {
        &mut self.outputs
    }
    fn eeprom(&mut self) -> &mut Eeprom {
        &mut self.eeprom
    }
    fn reading(&mut self, against_bandgap: bool, next: Input) -> Option<u16> {
        self.adc.reading(against_bandgap, next)
    }
    fn is_button_pressed(&self) -> bool {
        self.button.is_pressed()
    }
    fn shaft_pulses(&mut self, is_on: bool) -> ShaftPulses {
        self.shaft.pulses(is_on)
    }
    fn set_light(&mut self, brightness: u8) {
        self.light.set(brightness);
    }
    fn received_byte(&mut self) -> Option<u8> {
        self.serial.receive()
    }
    fn can_send_byte(&self) -> bool {
        self.serial.can_send()
    }
    fn send_byte(&mut self, byte: u8) {
        self.serial.send(byte);
    }
    fn has_loader(&self) -> bool {
        loader::is_there()
    }
    fn forget_restarts(&mut self) {
        loader::forget_restarts();
    }
    fn restart(&mut self, request: Option<&[u8; REQUEST_LEN]>) {
        if let Some(request) = request {
            loader::enter(Some(request));
        }
        guard::restart(ResetCause::ASKED_FOR);
    }
}
