//! The header of the program: which board it is for, and its length (see [`firmware::handover`]). The
//! bootloader reads it.

use firmware::handover::{HEADER_LEN, UNCHECKED_HEADER};

// Safety: no other symbol of the program has this name. `.vectors` has the vectors of the start-up
// code, which the linker is given first, so this follows them, at `handover::HEADER`;
// scripts/firmware checks that. Nothing runs or reads it as a vector, because the chip has no more
// of them.
#[unsafe(link_section = ".vectors")]
#[unsafe(no_mangle)]
#[used]
static IMAGE_HEADER: [u8; HEADER_LEN] = UNCHECKED_HEADER;
