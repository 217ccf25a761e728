//! Devices on the board's two-wire bus (TWI, I2C), such as sensors: each has an address and 256
//! registers of a byte.
//!
//! As most such devices they take the first byte after the address as the number of a register, and
//! read and write from there on, each byte in the next register.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::rc::Rc;
use std::str::FromStr;

use crate::avr::TwiBus;
use crate::{Cycles, F_CPU_HZ};

/// Highest address: those from 0x78 on are reserved, as are those below 0x08.
const ADDRESSES: std::ops::RangeInclusive<u8> = 0x08..=0x77;
/// A program that asks for more addresses which nobody has looks for devices.
const MISSING_MAX: usize = 8;
/// It has asked for all of them after this time.
const SCANNED: Cycles = F_CPU_HZ / 10;
/// Most bytes that a text lists.
const BYTES_SHOWN: usize = 16;
/// Most transactions that are kept.
const TRANSACTIONS_MAX: usize = 10_000;

/// A device, and values for its registers: `0x48`, or `0x48:0x00=0x19,0x80`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Setting {
    pub address: u8,
    /// The register of the first value. The others follow.
    pub register: u8,
    pub values: Vec<u8>,
}

impl FromStr for Setting {
    type Err = String;

    fn from_str(text: &str) -> Result<Setting, String> {
        let (address, rest) = text.split_once(':').map_or((text, None), |(a, b)| (a, Some(b)));
        let address = number(address)?;
        if !ADDRESSES.contains(&address) {
            return Err(format!("\"{text}\": use an address of seven bits from 0x08 to 0x77"));
        }
        let Some(rest) = rest else {
            return Ok(Setting { address, register: 0, values: Vec::new() });
        };
        let (register, values) = rest
            .split_once('=')
            .ok_or_else(|| format!("\"{text}\": write for example 0x48:0x00=0x19,0x80"))?;
        let values: Vec<u8> = values.split(',').map(number).collect::<Result<_, _>>()?;
        let register = number(register)?;
        if usize::from(register) + values.len() > 0x100 {
            return Err(format!("\"{text}\": the last register of a device is 0xFF"));
        }
        Ok(Setting { address, register, values })
    }
}

/// Reads a byte, decimal or with 0x.
fn number(text: &str) -> Result<u8, String> {
    let text = text.trim();
    let parsed = match text.strip_prefix("0x").or(text.strip_prefix("0X")) {
        Some(digits) => u8::from_str_radix(digits, 16),
        None => text.parse(),
    };
    parsed.map_err(|_| format!("\"{text}\": use a number from 0 to 255 or 0x00 to 0xFF"))
}

struct Device {
    registers: [u8; 0x100],
    /// True for a register that the program has written.
    is_written: [bool; 0x100],
    /// The register that is read or written next.
    next: u8,
}

#[derive(Default)]
struct Bus {
    devices: BTreeMap<u8, Device>,
    /// The device that the master has addressed.
    selected: Option<u8>,
    /// True if the next byte to the device is the number of a register.
    takes_register: bool,
    /// The transaction that goes on: its start, device, and bytes in each direction.
    transaction: Option<(Cycles, u8, Vec<u8>, Vec<u8>)>,
    transactions: Vec<(Cycles, String)>,
    /// Addresses that nobody acknowledged, with the time of the first, and whether it was told.
    missing: BTreeMap<u8, (Cycles, bool)>,
}

impl Bus {
    fn selected(&mut self) -> Option<&mut Device> {
        self.devices.get_mut(&self.selected?)
    }
}

/// The devices of a board. Clones are the same devices.
#[derive(Clone, Default)]
pub struct Devices(Rc<RefCell<Bus>>);

impl Devices {
    /// Adds the device, if it is not there, and sets its registers.
    pub fn set(&self, setting: &Setting) {
        let mut bus = self.0.borrow_mut();
        let device = bus.devices.entry(setting.address).or_insert_with(|| Device {
            registers: [0; 0x100],
            is_written: [false; 0x100],
            next: 0,
        });
        let first = usize::from(setting.register);
        device.registers[first..first + setting.values.len()].copy_from_slice(&setting.values);
    }

    /// Removes and returns the transactions since the last call: times and texts.
    pub fn take_transactions(&self) -> Vec<(Cycles, String)> {
        std::mem::take(&mut self.0.borrow_mut().transactions)
    }

    /// The addresses that nobody acknowledged, each once, unless the program looks for devices.
    pub fn missing(&self, now: Cycles) -> Vec<u8> {
        let missing = &mut self.0.borrow_mut().missing;
        let is_scan = missing.len() > MISSING_MAX;
        let due = missing.iter_mut().filter(|(_, (first, is_told))| {
            !is_scan && !is_told && now >= first.saturating_add(SCANNED)
        });
        due.map(|(address, (_, is_told))| {
            *is_told = true;
            *address
        })
        .collect()
    }

    /// What the program has written: address, first register, and the values from there on.
    pub fn written(&self) -> Vec<(u8, u8, Vec<u8>)> {
        let mut runs: Vec<(u8, u8, Vec<u8>)> = Vec::new();
        for (address, device) in &self.0.borrow().devices {
            let mut follows = false;
            for register in 0..=0xFF {
                let at = usize::from(register);
                match runs.last_mut() {
                    _ if !device.is_written[at] => {}
                    Some((.., values)) if follows => values.push(device.registers[at]),
                    _ => runs.push((*address, register, vec![device.registers[at]])),
                }
                follows = device.is_written[at];
            }
        }
        runs
    }

    /// The value of a register; `None` if there is no such device.
    pub fn register(&self, address: u8, register: u8) -> Option<u8> {
        Some(self.0.borrow().devices.get(&address)?.registers[usize::from(register)])
    }
}

/// Registers in the notation of the option `--i2c`.
pub fn text(address: u8, register: u8, values: &[u8]) -> String {
    let values: Vec<String> = values.iter().map(|value| format!("{value:#04X}")).collect();
    format!("{address:#04X}:{register:#04X}={}", values.join(","))
}

impl Bus {
    /// Ends the transaction that goes on.
    fn end(&mut self) {
        let Some((at, address, written, read)) = self.transaction.take() else { return };
        if self.transactions.len() >= TRANSACTIONS_MAX {
            return;
        }
        let mut text = format!("{address:#04X}");
        for (verb, bytes) in [("is written", written), ("gives", read)] {
            if bytes.is_empty() {
                continue;
            }
            text += &format!(" {verb}");
            for byte in bytes.iter().take(BYTES_SHOWN) {
                let _ = write!(text, " {byte:02X}");
            }
            if bytes.len() > BYTES_SHOWN {
                text += &format!(" ... ({} bytes)", bytes.len());
            }
        }
        self.transactions.push((at, text));
    }
}

impl TwiBus for Devices {
    fn address(&mut self, at: Cycles, address: u8, is_read: bool) -> bool {
        let mut bus = self.0.borrow_mut();
        bus.selected = bus.devices.contains_key(&address).then_some(address);
        if bus.selected.is_none() {
            bus.missing.entry(address).or_insert((at, false));
        }
        // A read after a repeated START belongs to the write before it, which chose the register.
        let last = bus.transaction.as_ref();
        let is_same = last.is_some_and(|(_, of, _, read)| *of == address && read.is_empty());
        let goes_on = is_read && is_same;
        if !goes_on {
            bus.end();
            bus.transaction = bus.selected.map(|address| (at, address, Vec::new(), Vec::new()));
        }
        bus.takes_register = !is_read;
        bus.selected.is_some()
    }

    fn write(&mut self, byte: u8) -> bool {
        let mut bus = self.0.borrow_mut();
        let is_register = std::mem::take(&mut bus.takes_register);
        if let Some((_, _, written, _)) = &mut bus.transaction {
            written.push(byte);
        }
        let Some(device) = bus.selected() else { return false };
        if is_register {
            device.next = byte;
        } else {
            device.registers[usize::from(device.next)] = byte;
            device.is_written[usize::from(device.next)] = true;
            device.next = device.next.wrapping_add(1);
        }
        true
    }

    fn read(&mut self) -> u8 {
        let mut bus = self.0.borrow_mut();
        let Some(device) = bus.selected() else { return 0xFF };
        let byte = device.registers[usize::from(device.next)];
        device.next = device.next.wrapping_add(1);
        if let Some((.., read)) = &mut bus.transaction {
            read.push(byte);
        }
        byte
    }

    fn stop(&mut self) {
        let mut bus = self.0.borrow_mut();
        bus.selected = None;
        bus.end();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_setting_is_an_address_and_values_from_a_register_on() {
        let parse = |text: &str| text.parse::<Setting>();
        let device = |register, values: &[u8]| {
            Ok(Setting { address: 0x48, register, values: values.to_vec() })
        };
        assert_eq!(parse("0x48"), device(0, &[]));
        assert_eq!(parse("72:254=0x19,128"), device(254, &[0x19, 128]));
        for (wrong, text) in [
            ("0x78", "from 0x08 to 0x77"),
            ("x", "from 0 to 255"),
            ("0x48:1", "0x48:0x00=0x19,0x80"),
            ("0x48:0=256", "from 0 to 255"),
            ("0x48:255=1,2", "the last register of a device is 0xFF"),
        ] {
            let error = parse(wrong).unwrap_err();
            assert!(error.contains(text), "{wrong}: {error}");
        }
    }
}
