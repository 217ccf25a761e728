//! The SPI and the pins of a simulated chip, as the driver uses them, and a bus with that chip.

use std::cell::RefCell;
use std::convert::Infallible;
use std::rc::Rc;

use can_model::{Bus, Frame, PortId, RecordKind, SoftNode};
use embedded_hal::digital::{self, InputPin, OutputPin};
use embedded_hal::spi::{self, Operation, SpiBus, SpiDevice};
use mcp2515_model::Mcp2515 as Chip;
use sim_base::Cycles;

pub const CRYSTAL_HZ: u32 = 16_000_000;
pub const MS: Cycles = 16_000;
pub const US: Cycles = 16;
/// Time of an SPI byte on the board, including the time to the next byte.
const SPI_BYTE: Cycles = 20;
const READ: u8 = 0x03;
const WRITE: u8 = 0x02;

/// The other end of the wires.
pub trait Peripheral {
    /// Exchanges bytes on the SPI.
    fn exchange(&mut self, words: &mut [u8]);

    /// CS falls.
    fn select(&mut self);

    /// CS rises.
    fn deselect(&mut self);

    /// The level of INT.
    fn is_int_high(&self) -> bool;
}

/// The wires to a peripheral. The driver gets a clone for the SPI and for each pin.
pub struct Wire<P>(pub Rc<RefCell<P>>);

impl<P> Clone for Wire<P> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<P> spi::ErrorType for Wire<P> {
    type Error = Infallible;
}

impl<P> digital::ErrorType for Wire<P> {
    type Error = Infallible;
}

impl<P: Peripheral> SpiBus for Wire<P> {
    fn read(&mut self, words: &mut [u8]) -> Result<(), Infallible> {
        words.fill(0);
        self.transfer_in_place(words)
    }

    fn write(&mut self, words: &[u8]) -> Result<(), Infallible> {
        self.transfer_in_place(&mut words.to_vec())
    }

    fn transfer(&mut self, _read: &mut [u8], _write: &[u8]) -> Result<(), Infallible> {
        unimplemented!("the driver does not use it")
    }

    fn transfer_in_place(&mut self, words: &mut [u8]) -> Result<(), Infallible> {
        self.0.borrow_mut().exchange(words);
        Ok(())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl<P: Peripheral> OutputPin for Wire<P> {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().select();
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().deselect();
        Ok(())
    }
}

impl<P: Peripheral> InputPin for Wire<P> {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.borrow().is_int_high())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

/// The peripheral as one of several devices on its SPI.
pub struct Device<P>(pub Wire<P>);

impl<P> spi::ErrorType for Device<P> {
    type Error = Infallible;
}

impl<P: Peripheral> SpiDevice for Device<P> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        self.0.set_low()?;
        for operation in operations {
            match operation {
                Operation::TransferInPlace(words) => self.0.transfer_in_place(words)?,
                _ => unimplemented!("the driver does not use it"),
            }
        }
        self.0.set_high()
    }
}

/// A bus with the chip and a peer, which acknowledges, and a record of the SPI.
pub struct World {
    pub bus: Bus,
    pub chip: Rc<RefCell<Chip>>,
    pub peer: Rc<RefCell<SoftNode>>,
    pub chip_port: PortId,
    pub peer_port: PortId,
    pub now: Cycles,
    selects: u32,
    bytes: u32,
    /// The bytes since CS fell.
    instruction: Vec<u8>,
    /// The next byte that is written to this register arrives with a wrong bit.
    pub corrupted: Option<u8>,
    /// The byte that each READ of this register returns.
    pub misread: Option<(u8, u8)>,
    /// The level of INT, regardless of the chip; `None` for the chip's level.
    pub int_stuck: Option<bool>,
    /// The byte that the SPI reads instead of the chip's; `None` for the chip's.
    pub miso_stuck: Option<u8>,
    /// Called when INT falls.
    pub int_falls: fn(),
    /// Does not fail on violations, for a test that makes mistakes on the SPI.
    pub violations_expected: bool,
}

impl World {
    /// A bus on which a millisecond has passed.
    pub fn new(bit_rate: u32) -> Wire<World> {
        let mut bus = Bus::new(bit_rate);
        let chip = Rc::new(RefCell::new(Chip::new(CRYSTAL_HZ)));
        let peer = Rc::new(RefCell::new(SoftNode::new(bit_rate)));
        let mut world = World {
            chip_port: bus.attach("chip", chip.clone()),
            peer_port: bus.attach("peer", peer.clone()),
            bus,
            chip,
            peer,
            now: 0,
            selects: 0,
            bytes: 0,
            instruction: vec![],
            corrupted: None,
            misread: None,
            int_stuck: None,
            miso_stuck: None,
            int_falls: || {},
            violations_expected: false,
        };
        world.run(MS);
        Wire(Rc::new(RefCell::new(world)))
    }

    /// Calls `int_falls` if INT falls meanwhile.
    fn observe<T>(&mut self, what: impl FnOnce(&mut Self) -> T) -> T {
        let was_high = self.is_int_high();
        let result = what(self);
        if was_high && !self.is_int_high() {
            (self.int_falls)();
        }
        result
    }

    pub fn run(&mut self, time: Cycles) {
        self.now += time;
        self.observe(|world| world.bus.run_until(world.now));
    }

    /// Connects the peer, or unplugs it, so that nobody acknowledges.
    pub fn connect_peer(&mut self, is_connected: bool) {
        self.bus.connect(self.peer_port, is_connected);
    }

    /// The complete frames of the chip and the number of error frames since the last call.
    pub fn take_traffic(&mut self) -> (Vec<Frame>, usize) {
        let (mut frames, mut errors) = (vec![], 0);
        for record in self.bus.take_records() {
            match record.kind {
                RecordKind::Frame { frame, from, .. } if from == Some(self.chip_port) => {
                    frames.push(frame);
                }
                RecordKind::Frame { .. } => {}
                RecordKind::ErrorFrame { .. } => errors += 1,
            }
        }
        (frames, errors)
    }

    /// The chip selects and the bytes since the last call.
    pub fn take_cost(&mut self) -> (u32, u32) {
        (std::mem::take(&mut self.selects), std::mem::take(&mut self.bytes))
    }
}

impl Peripheral for World {
    fn exchange(&mut self, words: &mut [u8]) {
        for word in words {
            self.chip.borrow_mut().begin_byte(self.now);
            self.run(SPI_BYTE);
            self.bytes += 1;
            if self.corrupted.is_some_and(|address| self.instruction == [WRITE, address]) {
                self.corrupted = None;
                *word ^= 1;
            }
            self.instruction.push(*word);
            let miso = self.observe(|world| world.chip.borrow_mut().end_byte(*word, world.now));
            *word = self.miso_stuck.unwrap_or(miso);
            if let (Some((register, value)), [READ, first, _, more @ ..]) =
                (self.misread, &self.instruction[..])
                && usize::from(*first) + more.len() == usize::from(register)
            {
                *word = value;
            }
        }
    }

    fn select(&mut self) {
        self.selects += 1;
        self.instruction.clear();
        self.chip.borrow_mut().select(self.now);
    }

    fn deselect(&mut self) {
        self.run(4);
        self.chip.borrow_mut().deselect(self.now);
    }

    fn is_int_high(&self) -> bool {
        self.int_stuck.unwrap_or_else(|| self.chip.borrow().int_pin())
    }
}

impl Drop for World {
    fn drop(&mut self) {
        if !std::thread::panicking() && !self.violations_expected {
            let violations = self.chip.borrow_mut().take_violations();
            assert!(violations.is_empty(), "driver mistakes: {violations:#?}");
        }
    }
}
