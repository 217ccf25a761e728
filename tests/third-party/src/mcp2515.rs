//! The job with the crate `mcp2515`, unchanged from crates.io, with the crate's own bit timing.

use crate::board::{self, CanBoard, CanSpi, Delay};
use crate::job::{self, Driver, FILTERS, MASK_0, MASK_1, Received};
use mcp2515::error::Error;
use mcp2515::filter::{RxFilter, RxMask};
use mcp2515::frame::CanFrame;
use mcp2515::regs::OpMode;
use mcp2515::{CanSpeed, MCP2515, McpSpeed, Settings};

/// Configures the chip and runs the job.
pub fn run<B: CanBoard>() -> ! {
    let (spi, serial, clock, task) = board::take::<B>();
    let mut chip = MCP2515::new(spi);
    // `init` sets filters that accept everything, and would leave configuration mode. Masks and
    // filters can only be written there.
    let settings = Settings {
        mode: OpMode::Configuration,
        can_speed: if B::CRYSTAL_MHZ == 8 { CanSpeed::Kbps500 } else { CanSpeed::Kbps1000 },
        mcp_speed: if B::CRYSTAL_MHZ == 8 { McpSpeed::MHz8 } else { McpSpeed::MHz16 },
        clkout_en: false,
    };
    chip.init(&mut Delay, settings).unwrap();
    chip.set_mask(RxMask::Mask0, MASK_0).unwrap();
    chip.set_mask(RxMask::Mask1, MASK_1).unwrap();
    for (filter, id) in RxFilter::ALL.into_iter().zip(FILTERS) {
        chip.set_filter(filter, id).unwrap();
    }
    chip.set_mode(OpMode::Normal).unwrap();
    job::run(Chip(chip), serial, clock, task)
}

struct Chip<B: CanBoard>(MCP2515<CanSpi<B>>);

impl<B: CanBoard> Driver for Chip<B> {
    type Frame = CanFrame;

    fn receive(&mut self) -> Received<CanFrame> {
        match self.0.read_message() {
            Ok(frame) => Received::Frame(frame),
            Err(Error::NoMessage) => Received::Nothing,
            Err(_) => Received::Refused,
        }
    }

    fn send(&mut self, frame: &CanFrame) -> bool {
        self.0.send_message(*frame).is_ok()
    }
}
