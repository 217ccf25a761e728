//! The label of the ELF: the section `.board` says what board the program is for, one `key=value` a
//! line. The simulator reads it.
//!
//! The section has no flags. So the linker keeps it, and no byte of it gets into the chip.

use core::arch::global_asm;

macro_rules! label {
    ($($key:literal $variable:literal,)*) => {
        global_asm!(
            ".section .board,\"\",@progbits",
            $(concat!(".ascii \"", $key, "=", env!($variable), "\\n\""),)*
            ".text",
        );
    };
}

label! {
    "board" "NODE_BOARD",
    "shield" "NODE_SHIELD",
    "mcu" "NODE_CHIP",
    "cs" "NODE_CS",
    "int" "NODE_INT",
    "crystal_mhz" "NODE_CRYSTAL_MHZ",
    "servo" "NODE_SERVO",
    "light" "NODE_LIGHT",
    "button" "NODE_BUTTON",
    "sensor" "NODE_SENSOR",
}

#[cfg(feature = "outputs")]
label! {
    "outputs" "NODE_OUTPUTS",
}

#[cfg(feature = "rpm")]
label! {
    "rpm" "NODE_RPM",
}

#[cfg(feature = "power")]
label! {
    "power" "NODE_POWER",
}
