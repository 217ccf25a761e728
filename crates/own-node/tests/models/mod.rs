//! The bus, the CAN controllers and the storage on which tests and examples run the node.

// Each program uses a part of it.
#![allow(dead_code)]

use std::cell::RefCell;
use std::collections::{HashMap, VecDeque};
use std::convert::Infallible;
use std::rc::Rc;

use can_model::{Bus, Frame, PortId, Record, SoftNode, StationRef};
use embedded_can::ErrorKind;
use embedded_can::nb::Can;
use embedded_hal::digital::{self, InputPin};
use embedded_hal::spi::{self, Operation, SpiDevice};
use mcp2515_model::{Mcp2515, Violation};
use own_node::{PARAMETERS, Storage};

/// A millisecond in cycles of the models, which have 16 MHz.
pub const MS: u64 = 16_000;
/// A byte on an SPI of 6.4 MHz, in cycles.
const SPI_BYTE: u64 = 20;
/// The crystal of the MCP2515.
pub const CRYSTAL_HZ: u32 = 16_000_000;
pub const BIT_RATE: u32 = 1_000_000;

/// A simulated bus and its time.
#[derive(Clone)]
pub struct World {
    bus: Rc<RefCell<Bus>>,
    now: Rc<RefCell<u64>>,
}

impl World {
    pub fn new() -> Self {
        Self { bus: Rc::new(RefCell::new(Bus::new(BIT_RATE))), now: Rc::default() }
    }

    pub fn attach(&self, name: &str, station: StationRef) -> PortId {
        self.bus.borrow_mut().attach(name, station)
    }

    /// The time in cycles.
    pub fn now(&self) -> u64 {
        *self.now.borrow()
    }

    pub fn now_ms(&self) -> u32 {
        (self.now() / MS) as u32
    }

    pub fn run(&self, cycles: u64) {
        *self.now.borrow_mut() += cycles;
        self.bus.borrow_mut().run_until(self.now());
    }

    pub fn take_records(&self) -> Vec<Record> {
        self.bus.borrow_mut().take_records()
    }
}

/// The SPI and the INT pin of an MCP2515.
#[derive(Clone)]
pub struct Wires {
    world: World,
    chip: Rc<RefCell<Mcp2515>>,
}

impl Wires {
    /// Attaches a chip to the bus.
    pub fn new(world: &World) -> (Self, PortId) {
        let chip = Rc::new(RefCell::new(Mcp2515::new(CRYSTAL_HZ)));
        let port = world.attach("node", chip.clone());
        (Self { world: world.clone(), chip }, port)
    }

    /// What the driver did and the data sheet forbids.
    pub fn take_violations(&self) -> Vec<Violation> {
        self.chip.borrow_mut().take_violations()
    }
}

impl spi::ErrorType for Wires {
    type Error = Infallible;
}

impl SpiDevice for Wires {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        self.chip.borrow_mut().select(self.world.now());
        for operation in operations {
            let Operation::TransferInPlace(bytes) = operation else { unimplemented!() };
            for byte in bytes.iter_mut() {
                self.chip.borrow_mut().begin_byte(self.world.now());
                self.world.run(SPI_BYTE);
                *byte = self.chip.borrow_mut().end_byte(*byte, self.world.now());
            }
        }
        self.chip.borrow_mut().deselect(self.world.now());
        Ok(())
    }
}

impl digital::ErrorType for Wires {
    type Error = Infallible;
}

impl InputPin for Wires {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.chip.borrow().int_pin())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

/// A CAN controller in a microcontroller, with the limits of the bxCAN of an STM32 and its driver
/// `bxcan`. It keeps three received frames. It accepts no frame while another waits to be sent;
/// `bxcan` accepts one of a higher priority.
pub struct Controller {
    station: Rc<RefCell<SoftNode>>,
    received: VecDeque<Frame>,
}

impl Controller {
    const RECEIVED_MAX: usize = 3;

    /// Attaches a controller to the bus.
    pub fn new(world: &World) -> (Self, PortId) {
        let station = Rc::new(RefCell::new(SoftNode::new(BIT_RATE)));
        let port = world.attach("node", station.clone());
        (Self { station, received: VecDeque::new() }, port)
    }
}

/// A frame was lost, because three others waited.
#[derive(Debug)]
pub struct Overrun;

impl embedded_can::Error for Overrun {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Overrun
    }
}

impl Can for Controller {
    type Frame = Frame;
    type Error = Overrun;

    fn transmit(&mut self, frame: &Frame) -> nb::Result<Option<Frame>, Overrun> {
        let mut station = self.station.borrow_mut();
        if station.queued() > 0 {
            return Err(nb::Error::WouldBlock);
        }
        station.send(*frame);
        Ok(None)
    }

    fn receive(&mut self) -> nb::Result<Frame, Overrun> {
        let frames = self.station.borrow_mut().take_received();
        self.received.extend(frames.into_iter().map(|(_, frame)| frame));
        if self.received.len() > Self::RECEIVED_MAX {
            self.received.truncate(Self::RECEIVED_MAX);
            return Err(nb::Error::Other(Overrun));
        }
        self.received.pop_front().ok_or(nb::Error::WouldBlock)
    }
}

/// A storage, which outlives the node.
#[derive(Clone, Default)]
pub struct Memory(Rc<RefCell<HashMap<usize, i32>>>);

impl Storage for Memory {
    fn load(&mut self, at: usize) -> Option<i32> {
        self.0.borrow().get(&at).copied()
    }

    fn store(&mut self, values: &[i32; PARAMETERS.len()]) -> bool {
        *self.0.borrow_mut() = values.iter().copied().enumerate().collect();
        true
    }
}
