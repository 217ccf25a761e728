//! The job with the crate `mcp25xx`, unchanged from crates.io, with the crate's own bit timing.

use crate::board::{self, CanBoard, CanSpi, Delay};
use crate::job::{self, Driver, FILTERS, MASK_0, MASK_1, Received};
use embedded_can::nb::Can;
use embedded_hal::delay::DelayNs;
use mcp25xx::bitrates::{clock_8mhz, clock_16mhz};
use mcp25xx::registers::{OperationMode, RXB0CTRL, RXB1CTRL, RXM};
use mcp25xx::{AcceptanceFilter, CanFrame, Config, MCP25xx};

/// Waits for the chip's oscillator: 128 of its cycles, at most 16 us (DS20001801, section 8.1).
const OSCILLATOR_START_MS: u32 = 1;

/// Configures the chip and runs the job.
pub fn run<B: CanBoard>() -> ! {
    let (spi, serial, clock, task) = board::take::<B>();
    Delay.delay_ms(OSCILLATOR_START_MS);
    let mut chip = MCP25xx { spi };
    let filters = [
        (AcceptanceFilter::Mask0, MASK_0.into()),
        (AcceptanceFilter::Mask1, MASK_1.into()),
        (AcceptanceFilter::Filter0, FILTERS[0].into()),
        (AcceptanceFilter::Filter1, FILTERS[1].into()),
        (AcceptanceFilter::Filter2, FILTERS[2].into()),
        (AcceptanceFilter::Filter3, FILTERS[3].into()),
        (AcceptanceFilter::Filter4, FILTERS[4].into()),
        (AcceptanceFilter::Filter5, FILTERS[5].into()),
    ];
    let config = Config::default()
        .mode(OperationMode::NormalOperation)
        .bitrate(if B::CRYSTAL_MHZ == 8 {
            clock_8mhz::CNF_500K_BPS
        } else {
            clock_16mhz::CNF_1000K_BPS
        })
        .receive_buffer_0(RXB0CTRL::default().with_rxm(RXM::Filter).with_bukt(true))
        .receive_buffer_1(RXB1CTRL::default().with_rxm(RXM::Filter))
        .filters(&filters);
    let Ok(()) = chip.apply_config(&config);
    job::run(Chip(chip), serial, clock, task)
}

struct Chip<B: CanBoard>(MCP25xx<CanSpi<B>>);

impl<B: CanBoard> Driver for Chip<B> {
    type Frame = CanFrame;

    fn receive(&mut self) -> Received<CanFrame> {
        match Can::receive(&mut self.0) {
            Ok(frame) => Received::Frame(frame),
            Err(_) => Received::Nothing,
        }
    }

    fn send(&mut self, frame: &CanFrame) -> bool {
        Can::transmit(&mut self.0, frame).is_ok()
    }
}
