//! The crate `mcp2515` on the Seeed CAN-BUS shield.
#![cfg_attr(target_arch = "avr", no_std, no_main)]

#[cfg(not(target_arch = "avr"))]
fn main() {}

#[cfg(target_arch = "avr")]
#[avr_device::entry]
fn main() -> ! {
    third_party::mcp2515::run::<third_party::board::Shield>()
}
