//! What own-node on an Uno uses of `mcp2515-ordered`, on the crate `mcp2515` unchanged from
//! crates.io: a queue of eight frames that INT0 fills.

#![no_std]

use core::cell::RefCell;

use critical_section::Mutex;
use embedded_can::nb::Can;
use embedded_hal::spi::SpiDevice;
use embedded_hal_bus::spi::{ExclusiveDevice, NoDelay};
use heapless::Deque;
use mcp2515::error::Error;
use mcp2515::frame::CanFrame;
use mcp2515::regs::{CanInte, OpMode};
use mcp2515::{CanSpeed, MCP2515, McpSpeed, Settings};

pub type Exclusive<SPI, CS> = ExclusiveDevice<SPI, CS, NoDelay>;

pub enum Attempts {
    UntilSent,
}

/// The crate has a table of its own, of which 16 MHz and 1 Mbit/s are one row.
pub struct BitTiming;

impl BitTiming {
    pub const fn new(_crystal_hz: u32, _bit_rate: u32) -> Self {
        Self
    }
}

/// The crate accepts all frames.
pub struct Filters;

impl Filters {
    pub const ALL_EXTENDED: Self = Self;
}

pub struct Configuration {
    pub timing: BitTiming,
    pub acceptance: Filters,
    pub attempts: Attempts,
}

#[derive(Debug)]
pub enum Event {
    Running,
    NotAnswering,
    IntWrong,
    AnotherRate,
    GaveUpSending,
    Other,
}

#[derive(Debug)]
pub struct Notice {
    pub event: Event,
}

#[derive(Debug)]
pub enum CanError {
    Notice(Notice),
    ListensOnly,
}

impl embedded_can::Error for CanError {
    fn kind(&self) -> embedded_can::ErrorKind {
        embedded_can::ErrorKind::Other
    }
}

pub struct Mcp2515<D> {
    crate_driver: MCP2515<D>,
    is_running: bool,
}

impl<SPI, CS> Mcp2515<Exclusive<SPI, CS>>
where
    Exclusive<SPI, CS>: SpiDevice,
    SPI: embedded_hal::spi::SpiBus,
    CS: embedded_hal::digital::OutputPin,
{
    pub fn new<INT>(spi: SPI, cs: CS, _int: INT, _configuration: Configuration) -> Self {
        let device = ExclusiveDevice::new_no_delay(spi, cs);
        let mut crate_driver = MCP2515::new(device.unwrap_or_else(|_| loop {}));
        let settings = Settings {
            mode: OpMode::Normal,
            can_speed: CanSpeed::Kbps1000,
            mcp_speed: McpSpeed::MHz16,
            clkout_en: false,
        };
        let is_running = crate_driver.init(&mut arduino_hal::Delay::new(), settings).is_ok();
        // `init` lets errors of the bus hold INT low until the program clears them, too.
        _ = crate_driver.write_register(CanInte::new().with_rx0ie(true).with_rx1ie(true));
        Self { crate_driver, is_running }
    }
}

impl<D> Mcp2515<D> {
    pub fn is_running(&self) -> bool {
        self.is_running
    }
}

pub struct Queue<D, INT, A, const N: usize> {
    contents: Mutex<RefCell<Contents<D, N>>>,
    _unused: core::marker::PhantomData<fn(INT, A)>,
}

struct Contents<D, const N: usize> {
    driver: Option<Mcp2515<D>>,
    frames: Deque<CanFrame, N>,
}

impl<D: SpiDevice, INT, A, const N: usize> Queue<D, INT, A, N> {
    pub const fn new() -> Self {
        let contents = Contents { driver: None, frames: Deque::new() };
        Self {
            contents: Mutex::new(RefCell::new(contents)),
            _unused: core::marker::PhantomData,
        }
    }

    pub fn install(&self, driver: Mcp2515<D>) {
        self.access(|contents| contents.driver = Some(driver));
    }

    fn access<R>(&self, access: impl FnOnce(&mut Contents<D, N>) -> R) -> R {
        critical_section::with(|cs| access(&mut self.contents.borrow_ref_mut(cs)))
    }

    pub fn receive(&self) {
        self.access(Contents::receive);
    }

    pub fn with_driver<R>(&self, access: impl FnOnce(&mut Mcp2515<D>) -> R) -> Option<R> {
        self.access(|contents| contents.driver.as_mut().map(access))
    }

    pub fn with_clock<T>(&self, _now_ms: T) -> Queued<'_, D, INT, A, N> {
        Queued(self)
    }
}

impl<D: SpiDevice, const N: usize> Contents<D, N> {
    #[inline(never)]
    fn receive(&mut self) {
        let Some(driver) = &mut self.driver else { return };
        while !self.frames.is_full()
            && let Ok(frame) = driver.crate_driver.read_message()
        {
            _ = self.frames.push_back(frame);
        }
    }
}

pub struct Queued<'q, D, INT, A, const N: usize>(&'q Queue<D, INT, A, N>);

impl<D, INT, A, const N: usize> Queued<'_, D, INT, A, N> {
    pub fn poll(&mut self) -> Option<Notice> {
        None
    }
}

impl<D: SpiDevice, INT, A, const N: usize> Can for Queued<'_, D, INT, A, N> {
    type Frame = CanFrame;
    type Error = CanError;

    fn transmit(&mut self, frame: &CanFrame) -> nb::Result<Option<CanFrame>, CanError> {
        match self.0.with_driver(|driver| driver.crate_driver.send_message(*frame)) {
            // TxFailed is a lost arbitration: the chip tries again.
            Some(Ok(()) | Err(Error::TxFailed)) => Ok(None),
            _ => Err(nb::Error::WouldBlock),
        }
    }

    /// Receives also what came without an edge of INT.
    fn receive(&mut self) -> nb::Result<CanFrame, CanError> {
        let frame = self.0.access(|contents| {
            let oldest = contents.frames.pop_front();
            contents.receive();
            oldest.or_else(|| contents.frames.pop_front())
        });
        frame.ok_or(nb::Error::WouldBlock)
    }
}
