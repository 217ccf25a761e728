//! What the bootloader and file servers read of the program: its header and the begin of its
//! tables, at fixed addresses (see [`firmware::handover`]).

use firmware::handover::{HEADER, HEADER_LEN, SOFTWARE_VERSION};
use firmware::image::IMAGE;
use firmware::tables::information;

/// Bytes between the header and the tables, so that the application descriptor is at a multiple of
/// 8.
const GAP: usize = SOFTWARE_VERSION as usize - HEADER as usize - HEADER_LEN;

/// The header and the tables.
#[repr(C)]
pub struct Front {
    header: [u8; HEADER_LEN],
    gap: [u8; GAP],
    pub image: [u8; IMAGE.len()],
}

// Safety: no other symbol of the program has this name. `.vectors` has the vectors of the start-up
// code, which the linker is given first, so this follows them, at `handover::HEADER`; scripts/image
// checks that. Nothing runs or reads it as a vector, because the chip has no more of them. It is
// read only by LPM, in `Image::byte`.
#[unsafe(link_section = ".vectors")]
#[unsafe(no_mangle)]
#[used]
pub static PROGRAM_FRONT: Front =
    Front { header: information::HEADER, gap: [0; GAP], image: IMAGE };
