//! The node on an Adafruit Feather RP2040 CAN Bus: an RP2040 with an MCP25625. A servo is at D5,
//! and the temperature is that of the chip.
//!
//! For another board with an MCP2515 change the pins, its crystal in `can.rs`, and the size of the
//! flash in `memory.x` and `flash.rs`.

#![no_std]
#![no_main]

mod can;
mod flash;

use embedded_hal::pwm::SetDutyCycle;
use embedded_hal::spi::MODE_0;
use embedded_hal_bus::spi::ExclusiveDevice;
use own_node::{Action, Node};
use panic_reset as _;
use rp2040_hal::fugit::RateExtU32;
use rp2040_hal::gpio::{FunctionSpi, PinState, Pins};
use rp2040_hal::pwm::Slices;
use rp2040_hal::{Adc, Clock, Sio, Spi, Timer, Watchdog, clocks, pac};

/// The second stage of the boot loader, for the flash of the board.
#[unsafe(link_section = ".boot2")]
#[used]
static BOOT2: [u8; 256] = rp2040_boot2::BOOT_LOADER_W25Q080;
/// The crystal of the RP2040.
const CRYSTAL_HZ: u32 = 12_000_000;
/// The response to RestartNode is sent within this time.
const RESTART_AFTER_MS: u32 = 100;

#[rp2040_hal::entry]
fn main() -> ! {
    let mut pac = pac::Peripherals::take().unwrap();
    let mut watchdog = Watchdog::new(pac.WATCHDOG);
    let clocks = clocks::init_clocks_and_plls(
        CRYSTAL_HZ,
        pac.XOSC,
        pac.CLOCKS,
        pac.PLL_SYS,
        pac.PLL_USB,
        &mut pac.RESETS,
        &mut watchdog,
    )
    .ok()
    .unwrap();
    let timer = Timer::new(pac.TIMER, &mut pac.RESETS, &clocks);
    let now_ms = || (timer.get_counter().ticks() / 1000) as u32;
    let sio = Sio::new(pac.SIO);
    let pins = Pins::new(pac.IO_BANK0, pac.PADS_BANK0, sio.gpio_bank0, &mut pac.RESETS);

    // The transceiver is not in standby, and the controller not in reset.
    let _standby = pins.gpio16.into_push_pull_output_in_state(PinState::Low);
    let _reset = pins.gpio18.into_push_pull_output_in_state(PinState::High);
    let wires = (
        pins.gpio15.into_function::<FunctionSpi>(),
        pins.gpio8.into_function::<FunctionSpi>(),
        pins.gpio14.into_function::<FunctionSpi>(),
    );
    let clock_hz = clocks.peripheral_clock.freq();
    let spi = Spi::<_, _, _, 8>::new(pac.SPI1, wires);
    let spi = spi.init(&mut pac.RESETS, clock_hz, 10.MHz(), MODE_0);
    let chip_select = pins.gpio19.into_push_pull_output_in_state(PinState::High);
    let device = ExclusiveDevice::new(spi, chip_select, timer).unwrap();
    let driver = can::driver(device, pins.gpio22.into_pull_up_input(), || now_ms() as u16);

    // A pulse each 20 ms, in microseconds. None before the first command.
    let mut slice = Slices::new(pac.PWM, &mut pac.RESETS).pwm2;
    slice.set_div_int(125);
    slice.set_top(19_999);
    slice.enable();
    let mut servo = slice.channel_b;
    servo.output_to(pins.gpio5);

    let mut adc = Adc::new(pac.ADC, &mut pac.RESETS);
    let sensor = adc.take_temp_sensor().unwrap();
    adc.free_running(&sensor);

    let mut node = Node::new(driver, flash::Flash, flash::unique_id());
    let mut restart_since = None;
    loop {
        match node.turn(now_ms(), kelvin(adc.read_single())) {
            Ok(Some(Action::Move(thousandths))) => {
                let Ok(()) = servo.set_duty_cycle((1500 + thousandths / 2) as u16);
            }
            Ok(Some(Action::Restart)) => restart_since = Some(now_ms()),
            // The driver recovers from an error by itself.
            Ok(None) | Err(_) => {}
        }
        if restart_since.is_some_and(|since| now_ms().wrapping_sub(since) > RESTART_AFTER_MS) {
            cortex_m::peripheral::SCB::sys_reset();
        }
    }
}

/// The temperature in 1/32 K, from a reading of 12 bits with a reference of 3.3 V. The sensor has
/// 706 mV at 27 °C, and 1.721 mV less for each degree more (RP2040 data sheet, 4.9.5).
fn kelvin(reading: u16) -> u16 {
    let microvolts = (u32::from(reading) * 825_000 / 1024) as i32;
    (30_015 * 32 / 100 - (microvolts - 706_000) * 32 / 1721) as u16
}
