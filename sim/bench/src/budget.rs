//! The memory budget of the node's program, from `avr-specs/budget.toml`. The linker's limits come
//! from the same file.

use crate::avr::Chip;
use std::sync::LazyLock;
use toml::Table;

const TEXT: &str = include_str!("../../../avr-specs/budget.toml");

/// The node's program fills the free RAM with this value at its start. The bytes that have changed
/// show the depth of the stack.
pub const PAINT: u8 = 0xC5;

/// Limits in bytes. `avr-specs/budget.toml` explains each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    pub flash: u32,
    pub statics: u32,
    pub statics_and_stack: u32,
    /// Address of the first byte of the RAM.
    pub ram_start: u32,
}

impl Budget {
    /// The budget of a chip.
    ///
    /// # Panics
    /// If the file has none for the chip.
    pub fn of(chip: Chip) -> Budget {
        let chip = chip.name();
        let file: Table =
            TEXT.parse().unwrap_or_else(|error| panic!("avr-specs/budget.toml: {error}"));
        let bytes = |name: &str| {
            let value = file
                .get(chip)
                .and_then(|limits| limits.get(name))
                .and_then(|value| value.as_integer());
            let value = value.and_then(|value| u32::try_from(value).ok());
            value.unwrap_or_else(|| panic!("avr-specs/budget.toml has no {name} of {chip}"))
        };
        Budget {
            flash: bytes("flash"),
            statics: bytes("statics"),
            statics_and_stack: bytes("statics_and_stack"),
            ram_start: bytes("ram_start"),
        }
    }
}

/// The budget of the default board's chip.
pub fn budget() -> &'static Budget {
    static BUDGET: LazyLock<Budget> = LazyLock::new(|| Budget::of(Chip::default()));
    &BUDGET
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avr::regs;

    #[test]
    fn the_limits_are_within_the_chip() {
        for chip in Chip::ALL {
            let budget = Budget::of(chip);
            assert_eq!(budget.ram_start, u32::from(regs::RAMSTART));
            assert!(budget.flash < chip.flash_bytes() as u32);
            assert!(budget.statics < budget.statics_and_stack);
            assert!(budget.statics_and_stack < chip.ram_bytes() as u32);
        }
    }
}
