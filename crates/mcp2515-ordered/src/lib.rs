//! A driver for the CAN controller MCP2515 (datasheet DS20001801J) that never waits, keeps frames in order, and supervises the chip.
//!
//! # How to begin
//!
//! [`Mcp2515::new`] takes an SPI bus that is the chip's alone, the pins CS and INT, and a [`Configuration`]. A main loop calls
//! [`Mcp2515::poll`] when [`State::is_due`], and [`Mcp2515::receive`] when [`Mcp2515::has_frame`], or from the interrupt of INT. Time is an
//! argument: milliseconds of 16 bits that wrap around.
//!
//! ```
//! use embedded_hal::digital::{InputPin, OutputPin};
//! use embedded_hal::spi::SpiBus;
//! use mcp2515_ordered::{Attempts, BitTiming, Configuration, Event, Filters, Frame, Mcp2515};
//!
//! /// Sends back what it receives, with the next higher identifier.
//! fn echo(spi: impl SpiBus, cs: impl OutputPin, int: impl InputPin, now_ms: impl Fn() -> u16) -> ! {
//!     let mut can = Mcp2515::new(spi, cs, int, Configuration {
//!         timing: const { BitTiming::new(16_000_000, 500_000) },
//!         acceptance: Filters::ALL_EXTENDED,
//!         attempts: Attempts::UntilSent,
//!     });
//!     let mut reply = None;
//!     loop {
//!         let mut frame = Frame::EMPTY;
//!         if reply.is_none() && can.has_frame() && can.receive(&mut frame) && !frame.is_foreign() {
//!             frame.id[3] ^= 1;
//!             reply = Some(frame);
//!         }
//!         if let Some(frame) = &reply {
//!             can.find_room();
//!             if can.state(now_ms()).has_room {
//!                 can.transmit(frame);
//!                 reply = None;
//!             }
//!         }
//!         if can.state(now_ms()).is_due
//!             && let Some(notice) = can.poll(now_ms())
//!         {
//!             match notice.event {
//!                 Event::Running => { /* on the bus */ }
//!                 Event::NotAnswering => { /* check the wiring; the driver tries again */ }
//!                 _ => {}
//!             }
//!         }
//!     }
//! }
//! ```
//!
//! `cargo run --example echo` runs such a loop on a host.
//!
//! # How it works
//!
//! [`Mcp2515::poll`] brings the chip up one short step at a time: reset, then each register written *and read back*, then
//! normal mode, which must show in CANSTAT. While the chip runs, `poll` checks every [`SUPERVISION_MS`] that it still has
//! its configuration (a brown-out or a glitch resets it), that INT agrees with the chip's flags, and its errors. After any failure it
//! returns a [`Notice`] and starts the chip over, without a limit: at once if the chip was running, else after [`RETRY_MS`]. Filters and
//! masks are the exception: outside configuration mode they read as zero (4.5), so nothing shows whether a running chip keeps them.
//!
//! What the chip takes in configuration mode only is a value, [`Configuration`]. [`Mcp2515::configure`] and
//! [`Mcp2515::reconfigure`] are the only ways to change it, and both start the chip over. Inside the driver these registers are written through a
//! type that exists only in the steps between reset and normal mode.
//!
//! [`Mcp2515::has_frame`] goes by the level of the INT pin. Waiting for an edge loses the chip when a second frame arrives
//! before the first is read, because then the pin never rises.
//!
//! # Order
//!
//! Frames leave in the order of [`Mcp2515::transmit`], although the chip sends the highest of its three buffers first. Frames come out of
//! [`Mcp2515::receive`] in the order in which they arrived, although the chip has two buffers and no order between them; except that
//! frames which only buffer 1's own filters accept are in order among themselves, but not with those of buffer 0. See [`Acceptance`].
//!
//! # Cost
//!
//! A frame is received in two chip selects and 8 bytes besides its data: READ STATUS, and READ RX BUFFER, which also clears
//! the flag. Only if INT is still low after that, the driver reads the status at once, which the next frame then does not need. A frame
//! is sent in three chip selects and 19 bytes: READ STATUS, WRITE, and RTS.
//!
//! # Assumptions and limits
//!
//! * `receive` must be called for each frame within two frame times (one where the filters leave it one buffer), or the chip loses
//!   frames. The driver reports each check that finds frames lost. An interrupt may call `receive` where the driver is not in use.
//! * The driver requests transmission by RTS in SPI mode 0,0. A request by WRITE could send a frame twice in one-shot mode if CS stayed low until
//!   the frame is over (errata DS80000179, 5).
//! * An SPI or a pin that reports an error counts as a chip that fails: what was read is nonsense, and the chip is started over.
//! * Extended data frames only. Others that the filters let through are marked [`Frame::FOREIGN`].
//!
//! # Features
//!
//! `counters`: [`Counters`] count. Without it they are zero, and take no memory.

#![no_std]
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod bit_timing;
mod chip;
mod configuration;
mod counters;
mod driver;
mod filters;
mod frame;
mod registers;
mod rx_order;
mod tx_order;

pub use bit_timing::BitTiming;
pub use configuration::{Attempts, Configuration};
pub use counters::{Counter, Counters, WORDS};
pub use driver::{ErrorFlags, Event, Mcp2515, Notice, RETRY_MS, SUPERVISION_MS, State, TX_TIMEOUT_MS};
pub use filters::{Acceptance, Filters, Pattern};
pub use frame::Frame;
