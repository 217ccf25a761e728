//! Instructions, registers and bits of the MCP2515 that the driver uses, by their names in
//! DS20001801J (sections 11, 12).

/// SPI instructions (table 12-1).
pub mod instruction {
    pub const WRITE: u8 = 0x02;
    pub const READ: u8 = 0x03;
    /// After the address follow a mask of the bits to change, and their values.
    pub const BIT_MODIFY: u8 = 0x05;
    /// Request to send (RTS). The bits 1, 2 and 4 select the buffers.
    pub const RTS: u8 = 0x80;
    /// READ RX BUFFER of RXB0, from RXB0SIDH on; add 4 for RXB1. The rising edge of CS clears the
    /// buffer's RXnIF.
    pub const READ_RX_BUFFER: u8 = 0x90;
    /// LOAD TX BUFFER of TXB0, from TXB0D0 on; add 2 for TXB1, and 4 for TXB2.
    pub const LOAD_TX_DATA: u8 = 0x41;
    pub const READ_STATUS: u8 = 0xA0;
    pub const RESET: u8 = 0xC0;
}

/// Bits in the answer to READ STATUS (figure 12-8).
pub mod status {
    /// RX0IF and RX1IF.
    pub const RXIF: u8 = 1 << 1 | 1 << 0;
    /// TXREQ of the three buffers.
    pub const TXREQ: u8 = 1 << 6 | 1 << 4 | 1 << 2;
    /// TX0IF to TX2IF of CANINTF.
    pub const TXIF: u8 = 1 << 7 | 1 << 5 | 1 << 3;
}

pub const CANSTAT: u8 = 0x0E;
pub const CANCTRL: u8 = 0x0F;
pub const REC: u8 = 0x1D;
/// From here on follow CNF3, CNF2, CNF1, CANINTE, CANINTF, EFLG, and CANSTAT and CANCTRL again.
pub const CNF3: u8 = 0x28;
pub const CANINTE: u8 = 0x2B;
pub const CANINTF: u8 = 0x2C;
pub const EFLG: u8 = 0x2D;
/// TXBnCTRL of the other buffers are 16 and 32 higher. The two lowest bits are TXP, the priority.
/// SIDH, SIDL, EID8, EID0, DLC and the data follow.
pub const TXB0CTRL: u8 = 0x30;
pub const TXB2CTRL: u8 = 0x50;
pub const RXB0CTRL: u8 = 0x60;

/// CANSTAT: the current mode of the chip.
pub const OPMOD: u8 = 0b1110_0000;
/// OPMOD and REQOP: configuration mode, which is also the mode after a reset.
pub const MODE_CONFIGURATION: u8 = 0b1000_0000;
/// OPMOD and REQOP: normal mode.
pub const MODE_NORMAL: u8 = 0b0000_0000;
/// OPMOD and REQOP: listen-only mode.
pub const MODE_LISTEN_ONLY: u8 = 0b0110_0000;

/// OPMOD and REQOP: loopback mode.
pub const MODE_LOOPBACK: u8 = 0b0100_0000;

/// CANCTRL: abort all pending transmissions.
pub const ABAT: u8 = 1 << 4;
/// CANCTRL: one-shot mode.
pub const OSM: u8 = 1 << 3;

/// CANINTE: receive buffer 0 full.
pub const RX0IE: u8 = 1 << 0;
/// CANINTE: receive buffer 1 full.
pub const RX1IE: u8 = 1 << 1;

/// CANINTF: a receive buffer has a frame.
pub const RX0IF: u8 = 1 << 0;
pub const RX1IF: u8 = 1 << 1;
/// CANINTF: TX0IF to TX2IF, a frame was sent and acknowledged.
pub const TXIF: u8 = 1 << 4 | 1 << 3 | 1 << 2;
/// CANINTF: there was an error in a frame.
pub const MERRF: u8 = 1 << 7;
/// CANINTF: frames were lost, or the error state has changed.
pub const ERRIF: u8 = 1 << 5;

/// EFLG: a frame was lost because buffer 0 (and, with rollover, buffer 1) was full.
pub const RX0OVR: u8 = 1 << 6;
/// EFLG: a frame was lost because buffer 1 was full.
pub const RX1OVR: u8 = 1 << 7;
/// EFLG: bus-off.
pub const TXBO: u8 = 1 << 5;
/// EFLG: transmit error-passive.
pub const TXEP: u8 = 1 << 4;
/// EFLG: receive error-passive.
pub const RXEP: u8 = 1 << 3;

/// TXBnCTRL: the frame lost an arbitration.
pub const MLOA: u8 = 1 << 5;
/// TXBnCTRL: there was an error while the frame was sent.
pub const TXERR: u8 = 1 << 4;

/// RXB0CTRL: 00 receives the frames that the filters accept.
pub const RXM: u8 = 0b0110_0000;
/// RXB0CTRL: a frame that finds buffer 0 full goes to buffer 1.
pub const BUKT: u8 = 1 << 2;

/// RXBnSIDL: the frame has an extended identifier. The name of the bit in TXBnSIDL and RXFnSIDL is
/// EXIDE.
pub const IDE: u8 = 1 << 3;
/// RXBnSIDL: the frame is a remote frame. Only for a standard identifier.
pub const SRR: u8 = 1 << 4;
/// RXBnDLC and TXBnDLC: the frame is a remote frame. In RXBnDLC only for an
/// extended identifier.
pub const RTR: u8 = 1 << 6;
/// RXBnDLC: the data length code. Codes above 8 mean 8 bytes (ISO 11898-1).
pub const DLC: u8 = 0x0F;
