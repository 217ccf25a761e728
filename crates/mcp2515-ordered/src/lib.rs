//! A driver for the CAN controller MCP2515 (datasheet DS20001801J) that never waits, keeps frames
//! in order, and supervises the chip.
//!
//! # Getting started
//!
//! [`SharedMcp2515::new`] takes an SPI device on a bus with other devices, the pin INT, and a
//! [`Configuration`]. [`Mcp2515::new`] takes an SPI bus that only the chip uses, the pins CS and
//! INT, and a configuration, and is faster. Both make a [`Driver`].
//!
//! [`Driver::with_clock`] makes of it what the traits of [`embedded_can`] need. Without it a main
//! loop calls [`Driver::poll`] when [`State::is_due`] is true, and [`Driver::receive`] when
//! [`Driver::has_frame`] is true; the interrupt of INT may call `receive` instead: see [`Queue`].
//! The caller passes the time: 16 bits of milliseconds that wrap around.
//!
//! ```
//! use embedded_hal::digital::{InputPin, OutputPin};
//! use embedded_hal::spi::SpiBus;
//! use mcp2515_ordered::{Attempts, BitTiming, Configuration, Event, Filters, Frame, Mcp2515};
//!
//! /// Sends each received frame back, with bit 0 of its identifier inverted.
//! fn echo(
//!     spi: impl SpiBus,
//!     cs: impl OutputPin,
//!     int: impl InputPin,
//!     now_ms: impl Fn() -> u16,
//! ) -> ! {
//!     let mut can = Mcp2515::new(spi, cs, int, Configuration {
//!         timing: const { BitTiming::new(16_000_000, 500_000) },
//!         acceptance: Filters::ALL_EXTENDED,
//!         attempts: Attempts::UntilSent,
//!     });
//!     let mut reply = None;
//!     loop {
//!         let mut frame = Frame::EMPTY;
//!         let has_room = reply.is_none();
//!         if has_room && can.has_frame() && can.receive(&mut frame) && !frame.is_foreign() {
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
//!                 Event::NotAnswering => { /* check the wiring; the driver retries */ }
//!                 _ => {}
//!             }
//!         }
//!     }
//! }
//! ```
//!
//! `cargo run --example echo` runs a main loop like this on a host.
//!
//! # How it works
//!
//! [`Driver::poll`] starts the chip one short step at a time: it resets the chip, writes each
//! register *and reads it back*, and requests normal mode, which CANSTAT must confirm. While the
//! chip runs, `poll` checks every [`SUPERVISION_MS`] that the chip still has its configuration (a
//! brown-out or a glitch resets it) and that INT agrees with its flags, and reads its error flags
//! and counters. If INT does not agree ([`Event::IntWrong`]), [`Driver::has_frame`] is true while
//! the chip runs, and [`Driver::receive`] asks the chip. After any other failure `poll` returns a
//! [`Notice`] and restarts the chip, any number of times: at once if the chip was running, else
//! after [`RETRY_MS`]. It cannot check filters and masks of a running chip: outside configuration
//! mode they read as zero (4.5).
//!
//! The registers that the chip accepts in configuration mode only are one value, [`Configuration`].
//! Only [`Driver::configure`] and [`Driver::reconfigure`] change it, and both restart the chip.
//! Inside the driver, only a type that exists between reset and normal mode can write these
//! registers.
//!
//! [`Driver::has_frame`] polls the level of the INT pin. An edge is not enough: if a second frame
//! arrives before the first is read, the pin stays low, and no further edge comes.
//!
//! # A bus of another bit rate
//!
//! A chip with a wrong bit rate would destroy each frame of the others. So until a frame has passed
//! in either direction, the chip tries each frame once, and the first disturbed frame of the others
//! makes the driver reset the chip, which then only listens ([`Event::AnotherRate`]). Listening
//! costs the others nothing. The chip comes back when it hears a frame without an error, or when
//! the bus is silent for a second.
//! On a bus where the others rarely send, only the chip's own frames show that something is wrong.
//! So until one has passed there is room for one frame, and then in the last 40 ms of each 1050 ms
//! only.
//! An error-passive chip, bus-off, or a second in which nothing could be sent also leads back to
//! the beginning, because the cable may be plugged in elsewhere.
//!
//! # Order
//!
//! The driver sends frames in the order of [`Driver::transmit`], although the chip sends the
//! highest of its three buffers first. [`Driver::receive`] returns frames in the order in which
//! they arrived, although the chip has two buffers and no order between them. There is
//! one exception: frames that only buffer 1's own filters accept are in order among themselves, but
//! not with the frames of buffer 0. See [`Acceptance`].
//!
//! # Cost
//!
//! On a bus of its own, to receive a frame takes two chip selects and 8 bytes besides its data:
//! READ STATUS, and READ RX BUFFER, which also clears the flag. If INT is still low after that, the
//! driver reads the status at once, and the next frame needs no READ STATUS. To send a frame takes
//! three chip selects and 19 bytes: READ STATUS, WRITE, and RTS. On a shared bus to receive a frame
//! takes two transactions of 16 bytes, because a transaction cannot depend on the length that it
//! reads.
//!
//! # Assumptions and limits
//!
//! * The application must call `receive` for each frame within two frame times, or the chip loses
//!   frames; within one frame time if the filters give the frame one buffer only. The driver
//!   reports each check that finds frames lost. An interrupt may call `receive` while the main loop
//!   does not use the driver.
//! * The driver requests transmission by RTS in SPI mode 0,0. A request by WRITE could send a frame
//!   twice in one-shot mode if CS stayed low until the end of the frame (errata DS80000179, 5).
//! * The driver does not report an error of the SPI or of a pin itself. The values that it then
//!   reads are wrong, so its checks find a failure and it restarts the chip.
//! * A [`Frame`] is an extended data frame: [`Driver::receive`] marks other frames that the filters
//!   accept with [`Frame::FOREIGN`]. An [`AnyFrame`] is a frame of any kind.
//!
//! # Features
//!
//! * `counters`: the driver counts in [`Counters`]. Without the feature they are zero and take no
//!   memory.
//! * `defmt`: frames, notices, states and errors implement `defmt::Format`.

#![no_std]
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod any_frame;
mod bit_timing;
mod chip;
mod configuration;
mod counters;
mod driver;
mod filters;
mod frame;
mod queue;
mod registers;
mod rx_order;
mod shared;
mod tx_order;
mod with_clock;

pub use any_frame::AnyFrame;
pub use bit_timing::BitTiming;
pub use chip::{Exclusive, Instructions};
pub use configuration::{Attempts, Configuration};
pub use counters::{Counter, Counters, NO_WORD, WORDS};
pub use driver::{
    Driver, ErrorFlags, Event, Mcp2515, Notice, RETRY_MS, SUPERVISION_MS, SharedMcp2515, State,
    TX_TIMEOUT_MS,
};
pub use filters::{Acceptance, Filters, Pattern};
pub use frame::Frame;
pub use queue::{Queue, Queued};
pub use shared::Shared;
pub use with_clock::{CanError, WithClock};

/// Compiles the examples of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
