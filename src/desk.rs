//! The node on a desk: a board of plain variables, for the tests and the fuzzer.
//!
//! [`Desk::turn`] is the main loop of `src/main.rs`, turn by turn, with the same [`Agenda`]. Time stands still while turns are taken, and
//! passes only in [`Desk::pass`]. Whoever uses a desk looks at what is on it, and changes that at will.

use std::cell::Cell;
use std::collections::VecDeque;
use std::vec::Vec;

use crate::can::Frame;
use crate::can::mcp2515::Counters;
use crate::dronecan::acceptance::NodeAcceptance;
use crate::dronecan::receive::Receiver;
use crate::image::InMemory;
use crate::monitor::Monitor;
use crate::node::Node;
use crate::node::agenda::{Agenda, Facts, Turn};
use crate::node::condition::ResetCause;
use crate::node::servo::{Output, Ticks};
use crate::node::store::Eeprom;

/// What the UART takes in a millisecond at 115200 baud.
const BYTES_PER_MS: u32 = 11;

/// No millisecond has so many turns, unless something goes on for ever.
const TURNS_MAX: u32 = 10_000;

/// An EEPROM whose supply can fail, and that does not forgive to be used while it writes.
#[derive(Clone)]
pub struct Memory {
    /// What it holds.
    pub cells: [u8; 256],
    /// It keeps what it has and nothing else.
    pub is_broken: bool,
    /// Writes until the supply fails, and what becomes of the byte that is being written then. What comes later is lost.
    pub fails_after: Option<(u16, u8)>,
    busy_for: Cell<u8>,
}

impl Memory {
    /// How often it is asked until a byte is written: at every tick of a millisecond, and a byte takes 3.4 ms (datasheet 2545,
    /// section 8.4).
    const BUSY_FOR: u8 = 4;

    /// As it leaves the factory.
    pub fn blank() -> Self {
        Self { cells: [0xFF; 256], is_broken: false, fails_after: None, busy_for: Cell::new(0) }
    }

    /// Waits for a byte that is being written, as the board does at a start.
    pub fn settle(&mut self) {
        self.busy_for.set(0);
    }
}

impl Eeprom for Memory {
    fn read(&self, at: u8) -> u8 {
        assert_eq!(self.busy_for.get(), 0, "read while a byte is being written");
        self.cells[usize::from(at)]
    }

    fn is_busy(&self) -> bool {
        self.busy_for.set(self.busy_for.get().saturating_sub(1));
        self.busy_for.get() != 0
    }

    fn begin_write(&mut self, at: u8, byte: u8) {
        assert_eq!(self.busy_for.replace(Self::BUSY_FOR), 0, "written while a byte is being written");
        if self.is_broken {
            return;
        }
        let cell = &mut self.cells[usize::from(at)];
        match &mut self.fails_after {
            None => *cell = byte,
            Some((0, _)) => {}
            Some((left, garbage)) => {
                *left -= 1;
                *cell = if *left == 0 { *garbage } else { byte };
            }
        }
    }
}

/// The servo: the width that its output was given last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Servo(pub Ticks);

impl Output for Servo {
    fn set(&mut self, width: Ticks) {
        self.0 = width;
    }
}

/// The CAN controller. It is always on the bus, which takes each frame at once.
pub struct Controller {
    /// Received frames that wait.
    pub received: VecDeque<Frame>,
    /// What it was given to send, and when.
    pub sent: Vec<(u32, Frame)>,
    /// How many frames it has room for.
    pub room: u32,
    /// It gets rid of none.
    pub is_held: bool,
    /// What it was told to let through, after the start, and how often. It lets everything through all the same.
    pub filters: Option<NodeAcceptance<InMemory>>,
    /// See [`filters`](Self::filters).
    pub filters_set: u32,
    /// What CanStats are made of.
    pub counters: Counters,
    is_due: bool,
    is_empty: bool,
    has_found_room: bool,
}

/// See the module.
pub struct Desk {
    /// The node.
    pub node: Node,
    /// Its transfers that come in.
    pub receiver: Receiver,
    /// Its serial monitor.
    pub monitor: Monitor,
    /// What the main loop does next.
    pub agenda: Agenda,
    /// What survives a reset.
    pub memory: Memory,
    /// The servo output.
    pub servo: Servo,
    /// The CAN controller.
    pub can: Controller,
    /// Milliseconds since the start; the node's clock has the lower 16 bits of them.
    pub ms: u32,
    /// What the ADC says, in turn.
    pub readings: [u16; 2],
    /// The button.
    pub is_pressed: bool,
    /// A question mark has come on the serial port.
    pub is_asked: bool,
    /// What was told on the serial port.
    pub told: Vec<u8>,
    /// The program was to be restarted.
    pub is_to_restart: bool,
    passed_ms: u8,
}

impl Desk {
    /// A node that has just started, with this EEPROM.
    pub fn start(mut memory: Memory, cause: ResetCause) -> Self {
        memory.settle();
        let mut desk = Self {
            node: Node::new(),
            receiver: Receiver::new(),
            monitor: Monitor::new(),
            agenda: Agenda::new(),
            memory,
            servo: Servo(0),
            can: Controller {
                received: VecDeque::new(),
                sent: Vec::new(),
                room: u32::MAX,
                is_held: false,
                filters: None,
                filters_set: 0,
                counters: Counters::new(),
                is_due: false,
                is_empty: true,
                has_found_room: false,
            },
            ms: 0,
            // An average of 51.5 is 25.15 degrees Celsius from an LM35.
            readings: [51, 52],
            is_pressed: false,
            is_asked: false,
            told: Vec::new(),
            is_to_restart: false,
            passed_ms: 0,
        };
        let mut noise = 7u8;
        let jitter = || {
            noise = noise.wrapping_mul(37).wrapping_add(11);
            noise
        };
        desk.node.start(cause, &mut desk.memory, jitter, InMemory, &mut desk.monitor);
        desk
    }

    /// The node's clock.
    pub fn now_ms(&self) -> u16 {
        self.ms as u16
    }

    /// A turn of the main loop; which one it was.
    pub fn turn(&mut self) -> Turn {
        let now_ms = self.now_ms();
        let Self { node, receiver, monitor, can, memory, servo, .. } = self;
        let is_empty = can.is_empty;
        let turn = self.agenda.next(!can.received.is_empty(), || Facts {
            has_ticked: self.passed_ms != 0,
            has_chore: node.has_chore(),
            is_controller_due: can.is_due,
            wants_filters: node.wants_filters(is_empty, receiver),
            is_on_bus: true,
            has_room: can.has_found_room,
            has_frame_to_send: node.is_ready(),
            has_to_send: node.has_to_send(),
        });
        match turn {
            Turn::TakeFrame => {
                if let Some(frame) = can.received.pop_front() {
                    node.receive(&frame, receiver, now_ms, InMemory, monitor, servo);
                }
            }
            Turn::Tick => {
                let passed_ms = core::mem::take(&mut self.passed_ms);
                can.is_due = true;
                node.expire(receiver, now_ms, monitor);
                node.tick(passed_ms, now_ms, memory, monitor);
                servo.set(node.pulse());
                #[cfg(feature = "button")]
                node.read_button(self.is_pressed, passed_ms, monitor);
                node.read_temperature(self.readings[(self.ms & 1) as usize]);
                self.is_to_restart |= node.is_to_restart(now_ms);
            }
            Turn::DoChore => node.do_chore(monitor),
            Turn::PollController => {
                can.is_due = false;
                if is_empty {
                    node.controller_is_empty(now_ms);
                }
                if !can.is_held {
                    can.is_due = !is_empty;
                    can.is_empty = true;
                }
            }
            Turn::SetFilters => {
                can.filters = Some(node.acceptance(InMemory));
                can.filters_set += 1;
                node.filters_are_set();
            }
            Turn::FindRoom => can.has_found_room = can.room != 0,
            Turn::SendFrame => {
                can.has_found_room = false;
                if can.room != u32::MAX {
                    can.room = can.room.saturating_sub(1);
                }
                can.sent.push((self.ms, *node.frame()));
                can.is_empty = false;
                // Frames leave at once, so it is looked at again at once.
                can.is_due = true;
                node.handed_over(now_ms);
            }
            Turn::PrepareFrame if node.prepare(&can.counters, InMemory, monitor, now_ms) => {}
            Turn::PrepareFrame | Turn::Monitor => {
                if core::mem::take(&mut self.is_asked) {
                    node.report(monitor);
                } else {
                    let byte = monitor.next_byte(InMemory);
                    if byte != 0 {
                        self.told.push(byte);
                    }
                }
                return Turn::Monitor;
            }
        }
        turn
    }

    /// Takes turns for as long as there are received frames or what was left over.
    pub fn settle(&mut self) {
        let mut turns = 0;
        while !self.can.received.is_empty() || self.node.has_chore() {
            self.turn();
            turns += 1;
            assert!(turns < TURNS_MAX, "it goes on for ever");
        }
    }

    /// Takes turns until there is nothing more to do than to tell on the serial monitor, and then for as much of that as a millisecond has time
    /// for.
    pub fn idle(&mut self) {
        let (mut turns, mut told) = (0, 0);
        while told < BYTES_PER_MS {
            told += u32::from(self.turn() == Turn::Monitor);
            turns += 1;
            assert!(turns < TURNS_MAX, "it goes on for ever");
        }
    }

    /// A frame comes, and the node acts on it.
    pub fn hear(&mut self, frame: &Frame) {
        self.can.received.push_back(*frame);
        self.settle();
    }

    /// So many milliseconds pass, of which the main loop hears at once.
    pub fn pass(&mut self, ms: u8) {
        self.passed_ms = ms;
        self.idle();
        self.ms += u32::from(ms);
    }
}
