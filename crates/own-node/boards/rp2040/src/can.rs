//! The CAN controller of the board: an MCP25625, which is an MCP2515 and its transceiver.

use embedded_can::nb::Can;
use embedded_hal::digital::InputPin;
use embedded_hal::spi::SpiDevice;
use mcp2515_ordered::{Attempts, BitTiming, CanError, Configuration, Filters, SharedMcp2515};

/// The crystal of the MCP25625.
const CRYSTAL_HZ: u32 = 16_000_000;
/// The usual bit rate of DroneCAN.
const BIT_RATE: u32 = 1_000_000;

/// Returns the driver, which receives all extended frames.
pub fn driver(
    device: impl SpiDevice,
    int: impl InputPin,
    now_ms: impl Fn() -> u16,
) -> impl Can<Error = CanError> {
    let configuration = Configuration {
        timing: const { BitTiming::new(CRYSTAL_HZ, BIT_RATE) },
        acceptance: Filters::ALL_EXTENDED,
        attempts: Attempts::UntilSent,
    };
    SharedMcp2515::new(device, int, configuration).with_clock(now_ms)
}
