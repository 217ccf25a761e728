//! The chips that the simulator knows. They differ in the sizes of their memories. Their vectors,
//! pins and peripherals are the same, as are the sections of the datasheets that the other files
//! cite.
//!
//! Source: Atmel 2545, "ATmega48/88/168", and Atmel 7810, "ATmega328P"; sections 8 (memories) and
//! 27 (boot loader).

use std::fmt;
use std::str::FromStr;

/// A chip.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Chip {
    /// 16 KiB of flash, 1 KiB of RAM.
    #[default]
    Atmega168,
    /// 32 KiB of flash, 2 KiB of RAM.
    Atmega328p,
}

impl Chip {
    /// All chips, the smallest first.
    pub const ALL: [Chip; 2] = [Chip::Atmega168, Chip::Atmega328p];

    /// Name for simavr, avr-gcc and `--mcu`.
    pub fn name(self) -> &'static str {
        match self {
            Chip::Atmega168 => "atmega168",
            Chip::Atmega328p => "atmega328p",
        }
    }

    /// The chip for programs of a device with avr-gcc's name. The suffixes A and P only concern
    /// power consumption.
    pub fn of_device(name: &str) -> Option<Chip> {
        match name {
            "atmega168" | "atmega168a" | "atmega168p" | "atmega168pa" => Some(Chip::Atmega168),
            "atmega328" | "atmega328p" => Some(Chip::Atmega328p),
            _ => None,
        }
    }

    /// Address of the last byte of the RAM, which begins at [`RAMSTART`](super::regs::RAMSTART).
    pub fn ram_end(self) -> u16 {
        match self {
            Chip::Atmega168 => 0x04FF,
            Chip::Atmega328p => 0x08FF,
        }
    }

    /// Bytes of RAM.
    pub fn ram_bytes(self) -> usize {
        usize::from(self.ram_end() - super::regs::RAMSTART) + 1
    }

    /// Bytes of flash.
    pub fn flash_bytes(self) -> usize {
        match self {
            Chip::Atmega168 => 16 * 1024,
            Chip::Atmega328p => 32 * 1024,
        }
    }

    /// Bytes of EEPROM.
    pub fn eeprom_bytes(self) -> usize {
        match self {
            Chip::Atmega168 => 512,
            Chip::Atmega328p => 1024,
        }
    }

    /// Byte addresses at which the boot section can start, for each value of the fuse bits BOOTSZ.
    pub fn boot_sections(self) -> [usize; 4] {
        match self {
            Chip::Atmega168 => [0x3800, 0x3C00, 0x3E00, 0x3F00],
            Chip::Atmega328p => [0x7000, 0x7800, 0x7C00, 0x7E00],
        }
    }

    /// First byte of the NRWW section, which cannot be read while it is written: the start of the
    /// longest boot section.
    pub fn nrww_start(self) -> usize {
        self.boot_sections()[0]
    }

    /// Bytes of the signature.
    pub fn signature(self) -> [u8; 3] {
        match self {
            Chip::Atmega168 => [0x1E, 0x94, 0x06],
            Chip::Atmega328p => [0x1E, 0x95, 0x0F],
        }
    }

    /// Low, high and extended fuse byte of an Arduino whose boot section starts at byte address
    /// `boot_start`. BOOTRST is programmed if `resets_to_boot` is true.
    pub fn fuses(self, boot_start: usize, resets_to_boot: bool) -> [u8; 3] {
        let bootsz =
            self.boot_sections().iter().position(|start| *start == boot_start).unwrap_or_default()
                as u8;
        let boot = bootsz << 1 | u8::from(!resets_to_boot);
        match self {
            Chip::Atmega168 => [0xFF, 0xDD, 0xF8 | boot],
            Chip::Atmega328p => [0xFF, 0xD8 | boot, 0xFD],
        }
    }
}

/// The name in the datasheet's spelling: "ATmega168".
impl fmt::Display for Chip {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Chip::Atmega168 => "ATmega168",
            Chip::Atmega328p => "ATmega328P",
        })
    }
}

impl FromStr for Chip {
    type Err = String;

    fn from_str(text: &str) -> Result<Chip, String> {
        Chip::ALL.into_iter().find(|chip| chip.name() == text).ok_or_else(|| {
            let names = Chip::ALL.map(Chip::name);
            format!("no chip is called \"{text}\": use {}", names.join(" or "))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chip_is_found_by_its_name_and_the_error_of_a_wrong_name_lists_the_chips() {
        for chip in Chip::ALL {
            assert_eq!(chip.name().parse(), Ok(chip));
            assert_eq!(Chip::of_device(chip.name()), Some(chip));
        }
        let error = "atmega2560".parse::<Chip>().unwrap_err();
        assert_eq!(error, "no chip is called \"atmega2560\": use atmega168 or atmega328p");
        assert_eq!(Chip::of_device("atmega328pb"), None);
    }

    #[test]
    fn each_boot_section_ends_at_the_end_of_the_flash() {
        for chip in Chip::ALL {
            let words = chip.boot_sections().map(|start| (chip.flash_bytes() - start) / 2);
            assert_eq!(
                words,
                [1024, 512, 256, 128].map(|words| words * (chip.flash_bytes() / 0x4000))
            );
        }
    }

    #[test]
    fn the_fuses_are_those_of_new_arduinos() {
        assert_eq!(Chip::Atmega168.fuses(0x3800, true), [0xFF, 0xDD, 0xF8]);
        assert_eq!(Chip::Atmega328p.fuses(0x7E00, true), [0xFF, 0xDE, 0xFD]);
        assert_eq!(Chip::Atmega328p.fuses(0x7800, false), [0xFF, 0xDB, 0xFD]);
    }
}
