//! The simulated bus, board and autopilot in WebAssembly.
//!
//! `make cross-check` runs the firmware on avr8js in Node.js and on simavr, and compares. `make
//! web` builds the page that runs it in a browser. The models, the decoders and the autopilot are
//! those of the simulator `sim`; only the instructions are executed by JavaScript. The page also
//! shows a real bus, with the crates of host/, and flashes a real board.
//!
//! ```text
//! api, js        what JavaScript calls, and avr8js as a processor (WebAssembly only)
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
#[cfg(target_family = "wasm")]
mod js;
