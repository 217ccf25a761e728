//! The tests of the driver are one program: each would link the models of its own.

mod another_rate;
mod driver;
mod queue;
mod traits;
mod wire;
