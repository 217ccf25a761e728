//! A build without the feature `simavr`: no chip can have this engine.

use std::ops::Range;

use anyhow::{Result, bail};

use super::chip::Chip;
use super::engine::{Activity, Engine, Timer, Vector};

/// There is none.
pub(super) enum Simavr {}

impl Simavr {
    /// Fails.
    pub fn new(_: Chip) -> Result<Simavr> {
        bail!(
            "this program was built without simavr; with it: cargo build --release -p sim \
             --features simavr"
        )
    }
}

#[allow(clippy::derivable_impls, reason = "a build with simavr has another default")]
impl Default for Engine {
    fn default() -> Engine {
        Engine::Own
    }
}

macro_rules! never {
    ($($(#[$doc:meta])* fn $name:ident($($argument:ident: $type:ty),*) $(-> $result:ty)?;)*) => {
        impl Simavr {
            $($(#[$doc])*
            pub fn $name(&self $(, _: $type)*) $(-> $result)? {
                match *self {}
            })*
        }
    };
}

methods!(never);

never! {
    fn schedule(timer: Timer, cycle: u64);
    fn unschedule(timer: Timer);
    fn drive_pin(port: usize, bit: u8, level: bool);
    fn hold_pin(port: usize, bit: u8, level: bool);
    fn release_pin(port: usize, bit: u8);
    fn set_external(port: usize, mask: u8, levels: u8);
    fn disconnect_timer1();
    fn store(address: u16, value: u8);
    fn forward(address: u16, value: u8);
    fn reset();
    fn set_stack_mark(mark: Option<u16>);
}
