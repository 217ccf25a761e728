//! The simulated bus, board and autopilot in WebAssembly.
//!
//! `make cross-check` runs the firmware on avr8js in Node.js and on simavr, and compares. `make
//! web` builds the page that runs it in a browser. The models, the decoders and the autopilot are
//! those of the simulator `sim`; only the instructions are executed by JavaScript.
//!
//! ```text
//! api, js      what JavaScript calls, and avr8js as a processor (WebAssembly only)
//! page         what the page shows, as JSON, and its controls
//! scenario     the traffic of the cross-check
//! world        board, autopilot, tool and further station on one bus
//! client       the tool on the bus
//! bits, spi    the bits of a frame; transactions on the SPI
//! ```

mod bits;
mod client;
pub mod page;
pub mod scenario;
mod spi;
pub mod world;

#[cfg(target_family = "wasm")]
mod api;
#[cfg(target_family = "wasm")]
mod js;
