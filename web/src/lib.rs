//! The simulated bus, board and autopilot in WebAssembly.
//!
//! `make web` builds the page that runs the firmware in a browser. Processor, models, decoders and
//! autopilot are those of the simulator `sim`. `make cross-check` runs the firmware so in Node.js
//! and natively on simavr, and compares. The page also shows a real bus, with the crates of host/,
//! and flashes a real board.
//!
//! ```text
//! api            what JavaScript calls (WebAssembly only)
//! page           what the page shows of the simulation, as JSON, and its controls
//! bus            the same of a real bus
//! scenario       the traffic of the cross-check
//! world          board, autopilot, tool and further station on one bus
//! client         the tool on the simulated bus
//! dialogue       what a tool asks a node, on either bus
//! traffic        what the page shows of a frame, on either bus
//! bits           the bits of a frame
//! meaning        what they mean in DroneCAN
//! spi            transactions on the SPI
//! stk500         uploads through the bootloader of a real Arduino
//! program_file   what is uploaded
//! parameter_file parameters as a text file
//! ```

mod bits;
pub mod bus;
mod client;
mod dialogue;
mod meaning;
pub mod page;
mod parameter_file;
pub mod program_file;
pub mod scenario;
mod spi;
pub mod stk500;
mod traffic;
pub mod world;

#[cfg(target_family = "wasm")]
mod api;
