//! Causes and ends the faults of [`fault`](super::fault) on a bench.
//!
//! A bench with an injector has one more station, the babbler. It acknowledges all frames, as a bus
//! analyser does, until the fault `babble` makes it send. So an autopilot still gets its ACKs when
//! the node's cable is pulled.

use std::cell::RefCell;
use std::rc::Rc;

use crate::Bench;
use crate::autopilot::Autopilot;
use crate::avr::ResetCause;
use crate::can::{self, Frame, PortId, SoftNode};
use crate::fault::Fault;

/// Number of the bit on the bus that a bit error inverts: in the data field of an extended frame.
const FLIPPED_BIT: u32 = 50;
const ERROR_RATE_PER_MILLION: u32 = 200;
const SPI_NOISE_PER_MILLION: u32 = 100;
const ERROR_STORM_PER_MILLION: u32 = 10_000;
const SENSOR_NOISE_MILLIVOLTS: u32 = 100;
/// Register CNF2 of the MCP2515.
const CNF2: u8 = 0x29;
/// Identifier of a NodeStatus, with sender 0.
const NODE_STATUS_ID: u32 = 0x1801_5500;
/// Fixed, so that each run has the same bus, SPI and sensor noise.
const NOISE_SEED: u64 = 1;
/// Identifier of the babbler's frame: highest priority, an unknown message type, and the node ID of
/// a tool (127).
const BABBLE_ID: u32 = 0x0000_0A7F;
/// The longest frame, with a valid tail byte, so that receivers accept it as a transfer.
const BABBLE_DATA: [u8; 8] = [0x55, 0x55, 0x55, 0x55, 0x55, 0x55, 0x55, 0xC0];

/// What a fault acts on.
pub struct Target<'a> {
    pub bench: &'a mut Bench,
    /// Number of the node's board.
    pub node: usize,
    pub autopilot: Option<&'a mut Autopilot>,
    /// Node ID for the fault `same-id`.
    pub node_id: u8,
    /// Temperature at the sensor when a fault of the sensor has ended, in degrees Celsius.
    pub sensor_c: f64,
}

/// The faults that are on, and the stations that cause faults.
pub struct Injector {
    babbler: Rc<RefCell<SoftNode>>,
    /// Node of the fault `wrong-rate`; attached when that fault begins for the first time.
    intruder: Option<(Rc<RefCell<SoftNode>>, PortId)>,
    active: Vec<Fault>,
}

impl Injector {
    /// Attaches the babbler to a bench.
    pub fn new(bench: &mut Bench) -> Injector {
        let babbler = Rc::new(RefCell::new(SoftNode::new(bench.bus().bit_rate())));
        bench.attach("babbler", babbler.clone());
        Injector { babbler, intruder: None, active: Vec::new() }
    }

    /// The babbler. Its received frames pile up until they are taken.
    pub fn babbler(&self) -> &Rc<RefCell<SoftNode>> {
        &self.babbler
    }

    /// The lasting faults that are on, in the order in which they began.
    pub fn active(&self) -> &[Fault] {
        &self.active
    }

    /// Begins a fault now; ends it if it lasts and is on. Returns true if it is on afterwards.
    /// `OtherDialect` only counts: the owner of the autopilot replaces it.
    pub fn inject(&mut self, fault: Fault, target: &mut Target) -> bool {
        let on = !self.active.contains(&fault);
        if fault.lasts() {
            self.active.retain(|active| *active != fault);
            if on {
                self.active.push(fault);
            }
        }
        if !self.disturb_bus(fault, on, target) {
            self.disturb_board(fault, on, target);
        }
        on && fault.lasts()
    }

    /// Causes or ends a fault of the bus or of its stations. Returns false for other faults.
    fn disturb_bus(&mut self, fault: Fault, on: bool, target: &mut Target) -> bool {
        let port = target.bench.port(target.node);
        let bus = target.bench.bus();
        match fault {
            Fault::BitError => bus.inject(can::Fault::FlipBit { bit: FLIPPED_BIT }),
            Fault::ErrorRate | Fault::ErrorStorm => {
                let per_million = self.latest_effect(|fault| match fault {
                    Fault::ErrorRate => Some(ERROR_RATE_PER_MILLION),
                    Fault::ErrorStorm => Some(ERROR_STORM_PER_MILLION),
                    _ => None,
                });
                let per_million = per_million.unwrap_or(0);
                bus.inject(can::Fault::BitErrorRate { per_million, seed: NOISE_SEED });
            }
            Fault::LoseFrame => bus.inject(can::Fault::LoseNextFrame { port }),
            Fault::NoAck => bus.inject(can::Fault::NoAck(on)),
            Fault::AckDestroyed => bus.inject(can::Fault::AckDestroyed(on)),
            Fault::StuckDominant => bus.inject(can::Fault::StuckDominant(on)),
            Fault::DestroyFrames => bus.inject(can::Fault::DestroyFrames(on)),
            Fault::Cable => bus.connect(port, !on),
            Fault::Babble => {
                let frame = on.then(|| Frame::extended(BABBLE_ID, &BABBLE_DATA));
                self.babbler.borrow_mut().babble(frame);
            }
            Fault::WrongRate => self.connect_intruder(target.bench, on),
            Fault::SameId => {
                let id = NODE_STATUS_ID | u32::from(target.node_id);
                let frame = Frame::extended(id, &[1, 0, 0, 0, 0, 0, 0, 0xC0]);
                self.babbler.borrow_mut().send(frame);
            }
            Fault::Silence | Fault::Disarm => {
                if let Some(autopilot) = &mut target.autopilot {
                    match fault {
                        Fault::Silence => autopilot.set_silent(on),
                        _ => autopilot.set_armed(!on),
                    }
                }
            }
            _ => return false,
        }
        true
    }

    /// Causes or ends a fault of the board.
    fn disturb_board(&self, fault: Fault, on: bool, target: &mut Target) {
        let board = target.bench.board(target.node);
        match fault {
            Fault::ChipReset => board.chip_reset(),
            Fault::SpiNoise => {
                board.set_spi_noise(if on { SPI_NOISE_PER_MILLION } else { 0 }, NOISE_SEED);
            }
            Fault::ChipGarbage => board.chip_brown_out(NOISE_SEED),
            Fault::ChipRegister => board.chip_flip_bits(CNF2, 1),
            Fault::ChipSleep => board.chip_fall_asleep(),
            Fault::ChipHeld => board.chip_hold_in_configuration(on),
            Fault::MisoLow | Fault::MisoHigh => {
                board.set_stuck_miso(self.latest_effect(|fault| match fault {
                    Fault::MisoLow => Some(0x00),
                    Fault::MisoHigh => Some(0xFF),
                    _ => None,
                }));
            }
            Fault::IntLow | Fault::IntHigh => {
                board.set_stuck_int(self.latest_effect(|fault| match fault {
                    Fault::IntLow => Some(false),
                    Fault::IntHigh => Some(true),
                    _ => None,
                }));
            }
            Fault::SensorNoise => {
                let millivolts = if on { SENSOR_NOISE_MILLIVOLTS } else { 0 };
                board.set_sensor_noise_millivolts(millivolts, NOISE_SEED);
            }
            Fault::SensorShort if on => board.set_sensor_millivolts(0),
            Fault::SensorShort => board.set_temperature_c(target.sensor_c),
            Fault::BrownOut => board.reset(ResetCause::BrownOut),
            Fault::ChipPower if on => board.chip_power_off(0xFF),
            Fault::ChipPower => board.chip_power_on(),
            Fault::Reset => board.reset(ResetCause::External),
            _ => {}
        }
    }

    /// The effect of the active fault that began last, among those for which `effect` is not
    /// `None`. Faults of one kind, such as two bit error rates, replace each other. When the
    /// last one ends, the one before it is in force again.
    fn latest_effect<T>(&self, effect: impl Fn(Fault) -> Option<T>) -> Option<T> {
        self.active.iter().rev().find_map(|fault| effect(*fault))
    }

    /// Lets a node of half the bit rate babble, or disconnects it. The simulation is slower while
    /// the node is connected.
    fn connect_intruder(&mut self, bench: &mut Bench, on: bool) {
        let bit_rate = bench.bus().bit_rate() / 2;
        let (node, port) = self.intruder.get_or_insert_with(|| {
            let node = Rc::new(RefCell::new(SoftNode::new(bit_rate)));
            let port = bench.attach("intruder", node.clone());
            (node, port)
        });
        node.borrow_mut().babble(on.then(|| Frame::extended(BABBLE_ID, &BABBLE_DATA)));
        bench.bus().connect(*port, on);
    }
}
