//! The SPI as transactions: what the processor and the MCP2515 said while CS was low.

use bench::Cycles;

/// Instruction bytes of the MCP2515 (DS20001801J table 12-1), and their names in the datasheet.
const INSTRUCTIONS: [(u8, u8, &str); 9] = [
    (0xFF, 0xC0, "RESET"),
    (0xFF, 0x03, "READ"),
    (0xF9, 0x90, "READ RX BUFFER"),
    (0xFF, 0x02, "WRITE"),
    (0xF8, 0x40, "LOAD TX BUFFER"),
    (0xF8, 0x80, "RTS"),
    (0xFF, 0xA0, "READ STATUS"),
    (0xFF, 0xB0, "RX STATUS"),
    (0xFF, 0x05, "BIT MODIFY"),
];

/// One instruction to the MCP2515.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Transaction {
    /// CS falls.
    pub start: Cycles,
    /// CS rises.
    pub end: Cycles,
    /// Bytes on MOSI and MISO.
    pub bytes: Vec<(u8, u8)>,
}

impl Transaction {
    /// Name of the instruction in the datasheet; "?" for an unknown one.
    pub fn name(&self) -> &'static str {
        let Some(&(first, _)) = self.bytes.first() else { return "?" };
        let known = INSTRUCTIONS.iter().find(|(mask, value, _)| first & mask == *value);
        known.map_or("?", |(_, _, name)| name)
    }
}

/// Builds transactions from the events of a probe, in order of time.
#[derive(Debug, Default)]
pub struct Transactions {
    open: Option<Transaction>,
}

impl Transactions {
    /// CS changes. Returns the transaction that ends with it.
    pub fn chip_select(&mut self, at: Cycles, level: bool) -> Option<Transaction> {
        if level {
            return self.open.take().map(|open| Transaction { end: at, ..open });
        }
        self.open = Some(Transaction { start: at, end: at, bytes: Vec::new() });
        None
    }

    /// A byte passes.
    pub fn byte(&mut self, mosi: u8, miso: u8) {
        if let Some(open) = &mut self.open {
            open.bytes.push((mosi, miso));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transaction_is_what_passes_while_cs_is_low() {
        let mut transactions = Transactions::default();
        transactions.byte(1, 1);
        assert_eq!(transactions.chip_select(10, false), None);
        transactions.byte(0x90, 0xFF);
        transactions.byte(0, 0x12);
        let transaction = transactions.chip_select(99, true).unwrap();
        let bytes = vec![(0x90, 0xFF), (0, 0x12)];
        assert_eq!(transaction, Transaction { start: 10, end: 99, bytes });
        assert_eq!(transaction.name(), "READ RX BUFFER");
        assert_eq!(transactions.chip_select(100, true), None);
    }

    #[test]
    fn every_instruction_of_the_datasheet_has_its_name() {
        for (first, name) in [
            (0x96, "READ RX BUFFER"),
            (0x45, "LOAD TX BUFFER"),
            (0x87, "RTS"),
            (0x05, "BIT MODIFY"),
            (0xB0, "RX STATUS"),
            (0x00, "?"),
        ] {
            let transaction = Transaction { start: 0, end: 0, bytes: vec![(first, 0)] };
            assert_eq!(transaction.name(), name, "{first:#04x}");
        }
    }
}
