//! The wires between the processor and the MCP2515: CS, INT and SPI, with their faults, and the
//! probe that records them.

use std::cell::{Cell, RefCell};
use std::fmt;
use std::rc::Rc;

use crate::Cycles;
use crate::avr::{InputPin, SerialCharacter, SpiByte, SpiDevice};
use crate::mcp2515::Mcp2515;
use sim_base::Noise;

/// A mistake of the firmware that a model has detected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    /// Time of the mistake.
    pub at: Cycles,
    /// Model that detected the mistake: `AVR`, `MCP2515` or `board`.
    pub source: &'static str,
    /// Description of the mistake.
    pub text: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.source, self.text)
    }
}

/// Counters of the SPI since power-on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SpiUse {
    /// Falling edges of CS of the MCP2515.
    pub selects: u64,
    /// Bytes while CS was low.
    pub bytes: u64,
    /// Bytes while CS was high: for another device on the same SPI, or for none.
    pub bytes_elsewhere: u64,
}

/// How a program uses a pin together with the SPI.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PinUse {
    /// Falling edges.
    pub falls: u32,
    /// Low phases with a byte on the SPI.
    pub with_bytes: u32,
    /// Bytes on the SPI while the pin was high, after its first edge.
    pub bytes_high: u64,
    /// All bytes on the SPI at the last edge.
    pub at_edge: u64,
}

impl PinUse {
    /// Counts an edge, after so many bytes.
    pub fn edge(&mut self, level: bool, bytes: u64) {
        let passed = bytes - std::mem::replace(&mut self.at_edge, bytes);
        if level {
            self.with_bytes += u32::from(passed > 0);
        } else {
            self.bytes_high += passed;
            self.falls += 1;
        }
    }

    /// True for a chip select: bytes pass while it is low, each time, and never while it is high.
    pub fn is_select(self) -> bool {
        self.with_bytes > 0 && self.bytes_high == 0 && self.falls <= 2 * self.with_bytes
    }
}

/// An event that a probe on the board's wires records. A level is true if it is high.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WireEvent {
    /// New level of CS.
    Cs(bool),
    /// New level of INT, at the time at which the AVR sees it.
    Int(bool),
    /// New level of the servo's signal.
    Servo(bool),
    /// New level of output 2 or a further one.
    Output {
        /// Index in [`Wiring::outputs`](crate::wiring::Wiring::outputs).
        index: usize,
        high: bool,
    },
    /// A byte on the SPI.
    Spi {
        /// Byte that the MCP2515 receives, with its noise.
        byte: SpiByte,
        /// Byte that the AVR receives.
        miso: u8,
    },
    /// A character on TXD or RXD.
    Serial(SerialCharacter),
}

/// A wire between the processor and the MCP2515.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    Cs,
    Int,
    Si,
    So,
    Sck,
}

/// A wrong wire. A pin of the processor that nothing drives reads as its pull-up: INT has one. SO
/// has none, so its level is part of [`Board::set_wrong_wire`](super::Board::set_wrong_wire). CS of
/// the MCP2515 has one, too.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WrongWire {
    Open(Wire),
    Low(Wire),
    High(Wire),
    Swapped(Wire, Wire),
}

impl WrongWire {
    /// True if the fault is one of this wire.
    fn is_of(self, wire: Wire) -> bool {
        match self {
            WrongWire::Open(one) | WrongWire::Low(one) | WrongWire::High(one) => one == wire,
            WrongWire::Swapped(one, other) => one == wire || other == wire,
        }
    }
}

/// The wires between the two chips.
pub(super) struct Wires {
    pub chip: Rc<RefCell<Mcp2515>>,
    int: InputPin,
    pub int_level: Cell<bool>,
    pub selected: Cell<bool>,
    /// Byte that MISO reads while the MCP2515 has no power; `None` while it has power.
    pub dead_miso: Cell<Option<u8>>,
    /// Byte that MISO reads while MISO is shorted.
    pub stuck_miso: Cell<Option<u8>>,
    /// Level of INT while INT is shorted.
    pub stuck_int: Cell<Option<bool>>,
    /// The wrong wire, and the byte that SO reads while nothing drives it.
    pub wrong: Cell<Option<(WrongWire, u8)>>,
    noise_per_million: Cell<u32>,
    noise: RefCell<Noise>,
    pub violations: RefCell<Vec<Violation>>,
    pub spi_use: Cell<SpiUse>,
    /// Events since the last call of `take_wire_events`, if a probe is attached.
    pub probe: RefCell<Option<Vec<(Cycles, WireEvent)>>>,
}

/// Connects the MCP2515 to the AVR's SPI.
pub(super) struct SpiEnd(pub Rc<Wires>);

impl SpiDevice for SpiEnd {
    fn begin_byte(&mut self, at: Cycles) {
        self.0.begin_byte(at);
    }

    fn end_byte(&mut self, byte: &SpiByte) -> u8 {
        self.0.end_byte(byte)
    }
}

impl Wires {
    /// Wires to an MCP2515 whose INT drives a pin with `int`.
    pub fn new(chip: Rc<RefCell<Mcp2515>>, int: InputPin) -> Wires {
        int.drive(true);
        Wires {
            chip,
            int,
            int_level: Cell::new(true),
            selected: Cell::new(false),
            dead_miso: Cell::new(None),
            stuck_miso: Cell::new(None),
            stuck_int: Cell::new(None),
            wrong: Cell::new(None),
            noise_per_million: Cell::new(0),
            noise: RefCell::new(Noise::new(0)),
            violations: RefCell::default(),
            spi_use: Cell::default(),
            probe: RefCell::default(),
        }
    }

    /// True if the MCP2515 has power.
    pub fn has_power(&self) -> bool {
        self.dead_miso.get().is_none()
    }

    /// Flips each bit on MOSI and on MISO with this probability; 0 ends the noise.
    pub fn set_noise(&self, per_million: u32, seed: u64) {
        self.noise_per_million.set(per_million);
        self.noise.replace(Noise::new(seed));
    }

    pub fn record(&self, at: Cycles, event: WireEvent) {
        if let Some(probe) = self.probe.borrow_mut().as_mut() {
            probe.push((at, event));
        }
    }

    pub fn update_int(&self, at: Cycles) {
        let level = self.dead_miso.get().is_some() || self.chip.borrow().int_pin();
        let level = match self.wrong.get() {
            Some((WrongWire::Low(Wire::Int), _)) => false,
            Some((wrong, _)) if wrong.is_of(Wire::Int) => true,
            _ => self.stuck_int.get().unwrap_or(level),
        };
        if self.int_level.replace(level) != level {
            self.record(at, WireEvent::Int(level));
            self.int.drive(level);
        }
    }

    pub fn chip_select(&self, level: bool, at: Cycles) {
        let was_selected = self.selected.replace(!level);
        let so_far = self.spi_use.get();
        self.spi_use
            .set(SpiUse { selects: so_far.selects + u64::from(!level && !was_selected), ..so_far });
        self.record(at, WireEvent::Cs(level));
        self.select(level, at);
    }

    /// Gives CS of the MCP2515 the level that its wire has if the processor's pin has this level.
    pub fn select(&self, level: bool, at: Cycles) {
        let level = match self.wrong.get() {
            Some((WrongWire::Low(Wire::Cs), _)) => false,
            // A line that changes within each byte selects the chip for no whole byte.
            Some((wrong, _)) if wrong.is_of(Wire::Cs) => true,
            _ => level,
        };
        if self.dead_miso.get().is_none() {
            let mut chip = self.chip.borrow_mut();
            if level {
                chip.deselect(at)
            } else {
                chip.select(at)
            }
            drop(chip);
            self.update_int(at);
        }
    }

    fn begin_byte(&self, at: Cycles) {
        if self.dead_miso.get().is_none() && self.has_clock() {
            self.chip.borrow_mut().begin_byte(at);
        }
    }

    fn end_byte(&self, byte: &SpiByte) -> u8 {
        let so_far = self.spi_use.get();
        self.spi_use.set(match self.selected.get() {
            true => SpiUse { bytes: so_far.bytes + 1, ..so_far },
            false => SpiUse { bytes_elsewhere: so_far.bytes_elsewhere + 1, ..so_far },
        });
        let byte = SpiByte { mosi: self.with_noise(byte.mosi), ..*byte };
        let miso = self.answer(&byte);
        self.record(byte.start, WireEvent::Spi { byte, miso });
        miso
    }

    /// The byte on MISO for a byte on MOSI.
    fn answer(&self, byte: &SpiByte) -> u8 {
        if let Some(miso) = self.dead_miso.get() {
            return miso;
        }
        if self.selected.get() && !matches!(byte.mode, 0 | 3) {
            let text = format!("SPI mode {}: the MCP2515 takes 0 and 3 only", byte.mode);
            self.violations.borrow_mut().push(Violation { at: byte.end, source: "board", text });
            return 0xFF;
        }
        let Some((wrong, undriven)) = self.wrong.get() else {
            let miso = self.chip.borrow_mut().end_byte(byte.mosi, byte.end);
            self.update_int(byte.end);
            return self.with_noise(self.stuck_miso.get().unwrap_or(miso));
        };
        if !self.has_clock() {
            return undriven;
        }
        let mosi = match wrong {
            WrongWire::Low(Wire::Si) => 0x00,
            WrongWire::High(Wire::Si) => 0xFF,
            wrong if wrong.is_of(Wire::Si) => undriven,
            _ => byte.mosi,
        };
        let miso = self.chip.borrow_mut().end_byte(mosi, byte.end);
        self.update_int(byte.end);
        match wrong {
            WrongWire::Low(Wire::So) => 0x00,
            WrongWire::High(Wire::So) => 0xFF,
            // INT is high unless the chip, which works, has received a frame.
            WrongWire::Swapped(Wire::Int, Wire::So) if self.chip.borrow().int_pin() => 0xFF,
            WrongWire::Swapped(Wire::Int, Wire::So) => 0x00,
            wrong if wrong.is_of(Wire::So) || wrong.is_of(Wire::Si) => undriven,
            wrong if wrong.is_of(Wire::Cs) && wrong != WrongWire::Low(Wire::Cs) => undriven,
            _ => miso,
        }
    }

    /// True if the MCP2515 gets a clock.
    fn has_clock(&self) -> bool {
        !self.wrong.get().is_some_and(|(wrong, _)| wrong.is_of(Wire::Sck))
    }

    fn with_noise(&self, byte: u8) -> u8 {
        let per_million = self.noise_per_million.get();
        if per_million == 0 {
            return byte;
        }
        let mut noise = self.noise.borrow_mut();
        (0..8)
            .fold(byte, |byte, bit| if noise.chance(per_million) { byte ^ 1 << bit } else { byte })
    }
}
