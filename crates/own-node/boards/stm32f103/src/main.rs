//! The node on a board with an STM32F103C8, such as the Blue Pill, and a CAN transceiver at PA11
//! (RX) and PA12 (TX). A servo is at PA6, and the temperature is that of the chip.
//!
//! The crystal of the board has 8 MHz.

#![no_std]
#![no_main]

mod flash;

use core::sync::atomic::{AtomicU32, Ordering};

use bxcan::filter::Mask32;
use bxcan::{ExtendedId, Fifo};
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::{entry, exception};
use own_node::{Action, Node};
use panic_reset as _;
use stm32f1xx_hal::timer::{Channel, Tim3NoRemap};
use stm32f1xx_hal::{pac, prelude::*, rcc};

/// The clock of the processor.
const CLOCK_HZ: u32 = 64_000_000;
/// The clock of the CAN controller.
const PCLK1_HZ: u32 = CLOCK_HZ / 2;
/// A bit of 1 Mbit/s is 1, 13 and 2 quanta long, so the sample point is at 87.5 %. The register
/// CAN_BTR has each less one.
const BIT_TIMING: u32 = 1 << 20 | 12 << 16 | (PCLK1_HZ / 16_000_000 - 1);
/// The response to RestartNode is sent within this time.
const RESTART_AFTER_MS: u32 = 100;

/// The time since the start.
static NOW_MS: AtomicU32 = AtomicU32::new(0);

#[exception]
fn SysTick() {
    NOW_MS.store(now_ms().wrapping_add(1), Ordering::Relaxed);
}

fn now_ms() -> u32 {
    NOW_MS.load(Ordering::Relaxed)
}

#[entry]
fn main() -> ! {
    let pac = pac::Peripherals::take().unwrap();
    let mut system_timer = cortex_m::Peripherals::take().unwrap().SYST;
    let mut flash = pac.FLASH.constrain();
    let clocks = rcc::Config::hse(8.MHz()).sysclk(CLOCK_HZ.Hz()).pclk1(PCLK1_HZ.Hz());
    let mut rcc = pac.RCC.freeze(clocks, &mut flash.acr);

    system_timer.set_clock_source(SystClkSource::Core);
    system_timer.set_reload(CLOCK_HZ / 1000 - 1);
    system_timer.clear_current();
    system_timer.enable_counter();
    system_timer.enable_interrupt();

    // A pulse each 20 ms, in microseconds. None before the first command.
    let mut gpioa = pac.GPIOA.split(&mut rcc);
    let mut afio = pac.AFIO.constrain(&mut rcc);
    let pin = gpioa.pa6.into_alternate_push_pull(&mut gpioa.crl);
    let mut servo =
        pac.TIM3.pwm_us::<Tim3NoRemap, _, _>(pin, &mut afio.mapr, 20.millis(), &mut rcc);
    servo.set_duty(Channel::C1, 0);
    servo.enable(Channel::C1);

    let mut adc = pac.ADC1.adc(&mut rcc);
    adc.enable_temp_vref();

    let can = pac.CAN.can(pac.USB, (gpioa.pa12, gpioa.pa11), &mut rcc);
    let mut can = bxcan::Can::builder(can).set_bit_timing(BIT_TIMING).leave_disabled();
    let any = ExtendedId::new(0).unwrap();
    can.modify_filters().enable_bank(0, Fifo::Fifo0, Mask32::frames_with_ext_id(any, any));
    // Waits until the bus is idle for 11 bits.
    while can.enable_non_blocking().is_err() {}

    let mut node = Node::new(can, flash::Flash(flash), flash::unique_id());
    let mut restart_since = None;
    loop {
        // The sensor has whole degrees Celsius.
        let kelvin = (adc.read_temp() + 273) * 32;
        match node.turn(now_ms(), kelvin as u16) {
            Ok(Some(Action::Move(thousandths))) => {
                servo.set_duty(Channel::C1, (1500 + thousandths / 2) as u16);
            }
            Ok(Some(Action::Restart)) => restart_since = Some(now_ms()),
            // A frame was lost, because three others waited.
            Ok(None) | Err(_) => {}
        }
        if restart_since.is_some_and(|since| now_ms().wrapping_sub(since) > RESTART_AFTER_MS) {
            cortex_m::peripheral::SCB::sys_reset();
        }
    }
}
