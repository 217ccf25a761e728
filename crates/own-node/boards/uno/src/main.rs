//! The node on an Arduino Uno or Diecimila with an MCP2515, on arduino-hal. CS of the MCP2515 is
//! D10, its INT is D2. A servo is at D9, and an LM35 at A0.
//!
//! The interrupt INT0 receives each frame, so none is lost while the main loop does other work.

#![no_std]
#![no_main]
#![feature(abi_avr_interrupt)]
#![feature(asm_experimental_arch)]

mod chip;
mod memory;
mod monitor;

use core::cell::Cell;

use arduino_hal::adc::{AdcSettings, ReferenceVoltage};
use arduino_hal::hal::port::{PB2, PD2};
use arduino_hal::hal::spi::ChipSelectPin;
use arduino_hal::port::Pin;
use arduino_hal::port::mode::{Input, PullUp};
use arduino_hal::spi::{SerialClockRate, Settings};
use arduino_hal::{Adc, Eeprom, Spi};
use avr_device::interrupt::{self, Mutex};
use mcp2515_ordered::{
    Attempts, BitTiming, CanError, Configuration, Exclusive, Filters, Mcp2515, Queue,
};
use memory::Memory;
use monitor::Monitor;
use own_node::{Action, Node};

/// The crystal of the CAN board, as it is stamped on it. With 8 MHz 500 kbit/s are possible.
const CRYSTAL_HZ: u32 = 16_000_000;
/// The usual bit rate of DroneCAN.
const BIT_RATE: u32 = 1_000_000;
/// A number that no other node has: the chips have none of their own.
const UNIQUE_ID: [u8; 16] = *b"own-node, uno  1";
/// The response to RestartNode is sent within this time.
const RESTART_AFTER_MS: u32 = 100;

type Chip = Exclusive<Spi, ChipSelectPin<PB2>>;

/// The driver, and eight frames that wait for the main loop.
static CAN: Queue<Chip, Pin<Input<PullUp>, PD2>, Filters, 8> = Queue::new();
/// The time since the start.
static NOW_MS: Mutex<Cell<u32>> = Mutex::new(Cell::new(0));

/// Called by the interrupt of INT0.
fn frame_received() {
    CAN.receive();
}

/// Called by the interrupt of Timer0.
fn millisecond_passed() {
    interrupt::free(|cs| {
        let now_ms = NOW_MS.borrow(cs);
        now_ms.set(now_ms.get().wrapping_add(1));
    });
}

fn now_ms() -> u32 {
    interrupt::free(|cs| NOW_MS.borrow(cs).get())
}

#[arduino_hal::entry]
fn main() -> ! {
    let dp = arduino_hal::Peripherals::take().unwrap();
    let pins = arduino_hal::pins!(dp);
    let mut monitor = Monitor::new(arduino_hal::default_serial!(dp, pins, 115_200));

    // A millisecond is 250 counts of 4 us.
    dp.TC0.tccr0a().write(|w| w.wgm0().ctc());
    dp.TC0.ocr0a().write(|w| w.set(249));
    dp.TC0.tccr0b().write(|w| w.cs0().prescale_64());
    dp.TC0.timsk0().write(|w| w.ocie0a().set_bit());

    // The MCP2515 needs mode 0; arduino-hal has mode 1 and half the clock unless told otherwise.
    let settings = Settings {
        clock: SerialClockRate::OscfOver2,
        mode: embedded_hal::spi::MODE_0,
        ..Settings::default()
    };
    let (spi, cs) = Spi::new(
        dp.SPI,
        pins.d13.into_output(),
        pins.d11.into_output(),
        pins.d12.into_pull_up_input(),
        pins.d10.into_output_high(),
        settings,
    );
    let configuration = Configuration {
        timing: const { BitTiming::new(CRYSTAL_HZ, BIT_RATE) },
        acceptance: Filters::ALL_EXTENDED,
        attempts: Attempts::UntilSent,
    };
    CAN.install(Mcp2515::new(spi, cs, pins.d2.into_pull_up_input(), configuration));
    chip::enable_int0(&dp.EXINT);

    // A pulse each 20 ms, in counts of 0.5 us. The mode comes before the top. No pulse before the
    // first command.
    pins.d9.into_output();
    dp.TC1.tccr1a().write(|w| w.wgm1().set(0b10));
    dp.TC1.tccr1b().write(|w| w.wgm1().set(0b11).cs1().prescale_8());
    dp.TC1.icr1().write(|w| w.set(39_999));

    let settings = AdcSettings { ref_voltage: ReferenceVoltage::Internal, ..Default::default() };
    let mut adc = Adc::new(dp.ADC, settings);
    let sensor = pins.a0.into_analog_input(&mut adc);
    let mut kelvin = kelvin_of(0);

    // SAFETY: no critical section is open.
    unsafe { interrupt::enable() };
    // The node begins when the chip is on the bus: its first turn is longer than two frames.
    let mut can = CAN.with_clock(|| now_ms() as u16);
    while !monitor.step(CAN.with_driver(|driver| driver.is_running())) {
        if let Some(notice) = can.poll() {
            monitor.print(notice);
        }
    }

    let memory = Memory::new(Eeprom::new(dp.EEPROM));
    let mut node = Node::new(can, &memory, UNIQUE_ID);
    let mut restart_since = None;
    loop {
        let now_ms = now_ms();
        memory.step(now_ms);
        monitor.step(CAN.with_driver(|driver| driver.is_running()));
        if let Ok(reading) = adc.read_nonblocking(&sensor) {
            kelvin = kelvin_of(reading);
        }
        match node.turn(now_ms, kelvin) {
            Ok(Some(Action::Move(thousandths))) => {
                dp.TC1.ocr1a().write(|w| w.set((2999 + thousandths) as u16));
                dp.TC1.tccr1a().write(|w| w.wgm1().set(0b10).com1a().match_clear());
            }
            Ok(Some(Action::Restart)) => restart_since = Some(now_ms),
            Ok(None) => {}
            // The driver recovers from an error by itself.
            Err(CanError::Notice(notice)) => monitor.print(notice),
            Err(CanError::ListensOnly) => {}
        }
        if restart_since.is_some_and(|since| now_ms.wrapping_sub(since) > RESTART_AFTER_MS)
            && !memory.is_busy()
        {
            chip::restart();
        }
    }
}

/// The temperature in 1/32 K from a reading of 10 bits, with the chip's reference of 1.1 V. The
/// LM35 has 10 mV for each degree Celsius.
fn kelvin_of(reading: u16) -> u16 {
    8741 + reading * 55 / 16
}
