//! The register map: the register at each address, the bits that exist, those that SPI writes can
//! change, and the values after a reset.
//!
//! The map is two-dimensional in the datasheet: the high digit of the address selects one of eight
//! columns, the low digit a row. CANSTAT and CANCTRL appear in rows E and F of every column; the
//! model stores them once.
//!
//! Source: DS20001801J section 11 (Tables 11-1 and 11-2) and the register descriptions that it
//! lists. CANCTRL is 87h after a reset; Table 11-2 of older revisions had another value.

/// Size of the address space, at which addresses wrap.
pub const SIZE: usize = 128;
/// The seven address bits that exist.
pub const ADDRESS_MASK: u8 = 0x7F;

pub const BFPCTRL: u8 = 0x0C;
pub const TXRTSCTRL: u8 = 0x0D;
pub const CANSTAT: u8 = 0x0E;
pub const CANCTRL: u8 = 0x0F;
pub const TEC: u8 = 0x1C;
pub const REC: u8 = 0x1D;
pub const RXM0SIDH: u8 = 0x20;
pub const CNF3: u8 = 0x28;
pub const CNF2: u8 = 0x29;
pub const CNF1: u8 = 0x2A;
pub const CANINTE: u8 = 0x2B;
pub const CANINTF: u8 = 0x2C;
pub const EFLG: u8 = 0x2D;
pub const TXB0CTRL: u8 = 0x30;
pub const RXB0CTRL: u8 = 0x60;

/// Distance between two transmit or receive buffers.
pub const BUFFER_STRIDE: u8 = 0x10;
/// Offsets inside a buffer, from its control register.
pub mod offset {
    pub const SIDH: u8 = 1;
    pub const SIDL: u8 = 2;
    pub const EID8: u8 = 3;
    pub const EID0: u8 = 4;
    pub const DLC: u8 = 5;
    pub const D0: u8 = 6;
    pub const D7: u8 = 13;
}

/// CANCTRL (Register 10-1).
pub mod canctrl {
    pub const REQOP: u8 = 0b1110_0000;
    pub const ABAT: u8 = 1 << 4;
    pub const OSM: u8 = 1 << 3;
}

/// CANINTF and CANINTE share one layout (Registers 7-1 and 7-2).
pub mod int {
    pub const MERR: u8 = 1 << 7;
    pub const WAK: u8 = 1 << 6;
    pub const ERR: u8 = 1 << 5;
    pub const TX0: u8 = 1 << 2;
    pub const RX1: u8 = 1 << 1;
    pub const RX0: u8 = 1 << 0;
}

/// TXRTSCTRL (Register 3-2): B2RTSM..B0RTSM below, B2RTS..B0RTS above them.
pub mod txrtsctrl {
    pub const MODES: u8 = 0b0000_0111;
    pub const PINS_SHIFT: u32 = 3;
}

/// EFLG (Register 6-3).
pub mod eflg {
    pub const RX1OVR: u8 = 1 << 7;
    pub const RX0OVR: u8 = 1 << 6;
    pub const TXBO: u8 = 1 << 5;
    pub const TXEP: u8 = 1 << 4;
    pub const RXEP: u8 = 1 << 3;
    pub const TXWAR: u8 = 1 << 2;
    pub const RXWAR: u8 = 1 << 1;
    pub const EWARN: u8 = 1 << 0;
}

/// TXBnCTRL (Register 3-1).
pub mod txctrl {
    pub const ABTF: u8 = 1 << 6;
    pub const MLOA: u8 = 1 << 5;
    pub const TXERR: u8 = 1 << 4;
    pub const TXREQ: u8 = 1 << 3;
    pub const TXP: u8 = 0b11;
}

/// RXBnCTRL (Registers 4-1 and 4-2).
pub mod rxctrl {
    pub const RXM: u8 = 0b0110_0000;
    pub const RXM_SHIFT: u32 = 5;
    pub const RXRTR: u8 = 1 << 3;
    pub const BUKT: u8 = 1 << 2;
    pub const BUKT1: u8 = 1 << 1;
    pub const FILHIT0: u8 = 1 << 0;
    /// RXB1CTRL only.
    pub const FILHIT: u8 = 0b111;
}

/// Identifier bytes of buffers, filters and masks (Registers 3-4, 4-5, 4-11).
pub mod sidl {
    pub const SID: u8 = 0b1110_0000;
    pub const SRR: u8 = 1 << 4;
    /// EXIDE in TXBnSIDL and RXFnSIDL, IDE in RXBnSIDL.
    pub const EXIDE: u8 = 1 << 3;
    pub const EID: u8 = 0b11;
}

/// TXBnDLC and RXBnDLC (Registers 3-7 and 4-8).
pub mod dlc {
    pub const RTR: u8 = 1 << 6;
    pub const CODE: u8 = 0x0F;
}

/// The kind of register at an address, by its access rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Filter or mask: written and read only in configuration mode.
    Filter,
    /// CNF1..3 and TXRTSCTRL: written only in configuration mode.
    ConfigOnly,
    Bfpctrl,
    Canstat,
    Canctrl,
    /// TEC and REC.
    ErrorCounter,
    Caninte,
    Canintf,
    Eflg,
    TxControl(usize),
    /// Identifier, DLC and data of a transmit buffer.
    TxBuffer(usize),
    RxControl(usize),
    /// Identifier, DLC and data of a receive buffer.
    RxBuffer(usize),
}

/// The kind of register at `address` (0 to 7Fh).
pub fn kind(address: u8) -> Kind {
    let column = usize::from(address >> 4);
    match address {
        _ if address & 0x0F == CANSTAT => Kind::Canstat,
        _ if address & 0x0F == CANCTRL => Kind::Canctrl,
        BFPCTRL => Kind::Bfpctrl,
        TXRTSCTRL | CNF1 | CNF2 | CNF3 => Kind::ConfigOnly,
        TEC | REC => Kind::ErrorCounter,
        CANINTE => Kind::Caninte,
        CANINTF => Kind::Canintf,
        EFLG => Kind::Eflg,
        0x30..=0x5F if address & 0x0F == 0 => Kind::TxControl(column - 3),
        0x30..=0x5F => Kind::TxBuffer(column - 3),
        0x60.. if address & 0x0F == 0 => Kind::RxControl(column - 6),
        0x60.. => Kind::RxBuffer(column - 6),
        _ => Kind::Filter,
    }
}

/// The bits that a WRITE can change, in a mode that allows it.
pub fn writable(address: u8) -> u8 {
    match kind(address) {
        Kind::Filter if address & 0b11 != 1 => 0xFF,
        Kind::Filter if address >= RXM0SIDH => sidl::SID | sidl::EID,
        Kind::Filter => sidl::SID | sidl::EXIDE | sidl::EID,
        Kind::ConfigOnly => match address {
            TXRTSCTRL => txrtsctrl::MODES,
            CNF3 => 0b1100_0111,
            _ => 0xFF,
        },
        Kind::Bfpctrl => 0b0011_1111,
        Kind::Canstat | Kind::ErrorCounter | Kind::RxBuffer(_) => 0,
        Kind::Canctrl | Kind::Caninte | Kind::Canintf => 0xFF,
        Kind::Eflg => eflg::RX0OVR | eflg::RX1OVR,
        Kind::TxControl(_) => txctrl::TXREQ | txctrl::TXP,
        Kind::TxBuffer(_) => match address & 0x0F {
            offset::SIDL => sidl::SID | sidl::EXIDE | sidl::EID,
            offset::DLC => dlc::RTR | dlc::CODE,
            _ => 0xFF,
        },
        Kind::RxControl(0) => rxctrl::RXM | rxctrl::BUKT,
        Kind::RxControl(_) => rxctrl::RXM,
    }
}

/// The bits that exist in a register whose value after a reset is undefined.
fn implemented(address: u8) -> u8 {
    match (kind(address), address & 0x0F) {
        (Kind::RxBuffer(_), offset::SIDL) => !(1 << 2),
        (Kind::RxBuffer(_), offset::DLC) => !(1 << 7),
        (Kind::RxBuffer(_), _) => 0xFF,
        _ => writable(address),
    }
}

/// True if BIT MODIFY works on the register (shaded in Table 11-1).
pub fn is_bit_modifiable(address: u8) -> bool {
    !matches!(
        kind(address),
        Kind::Filter | Kind::Canstat | Kind::ErrorCounter | Kind::TxBuffer(_) | Kind::RxBuffer(_)
    )
}

/// The value after a reset. `None` where the datasheet has "x": the reset does not change the
/// register.
pub fn reset_value(address: u8) -> Option<u8> {
    match kind(address) {
        Kind::Filter if address < RXM0SIDH => None,
        Kind::TxBuffer(_) | Kind::RxBuffer(_) => None,
        Kind::Canctrl => Some(0x87),
        _ => Some(0),
    }
}

/// The value of an undefined register at power-up: differs from all usual defaults, and is the
/// same in every run.
pub fn power_up_noise(address: u8) -> u8 {
    address.wrapping_mul(0x9D).wrapping_add(0x5B) & implemented(address)
}

/// The datasheet's name of the register, for messages.
pub fn name(address: u8) -> String {
    let part = |base: u8| match address - base {
        0 => "SIDH",
        1 => "SIDL",
        2 => "EID8",
        _ => "EID0",
    };
    let content = || match address & 0x0F {
        low @ 1..=4 => ["SIDH", "SIDL", "EID8", "EID0"][usize::from(low) - 1].to_owned(),
        5 => "DLC".to_owned(),
        low => format!("D{}", low - offset::D0),
    };
    match kind(address) {
        Kind::Filter if address >= RXM0SIDH => {
            let n = (address - RXM0SIDH) / 4;
            format!("RXM{n}{}", part(RXM0SIDH + 4 * n))
        }
        Kind::Filter => {
            let n = (address & 0x0F) / 4 + 3 * (address >> 4);
            format!("RXF{n}{}", part(address & !0b11))
        }
        Kind::ConfigOnly => match address {
            TXRTSCTRL => "TXRTSCTRL",
            CNF1 => "CNF1",
            CNF2 => "CNF2",
            _ => "CNF3",
        }
        .to_owned(),
        Kind::Bfpctrl => "BFPCTRL".to_owned(),
        Kind::Canstat => "CANSTAT".to_owned(),
        Kind::Canctrl => "CANCTRL".to_owned(),
        Kind::ErrorCounter => if address == TEC { "TEC" } else { "REC" }.to_owned(),
        Kind::Caninte => "CANINTE".to_owned(),
        Kind::Canintf => "CANINTF".to_owned(),
        Kind::Eflg => "EFLG".to_owned(),
        Kind::TxControl(n) => format!("TXB{n}CTRL"),
        Kind::TxBuffer(n) => format!("TXB{n}{}", content()),
        Kind::RxControl(n) => format!("RXB{n}CTRL"),
        Kind::RxBuffer(n) => format!("RXB{n}{}", content()),
    }
}
