//! The node on a desk: a board of plain variables, for the tests and the fuzzer.
//!
//! [`Desk::turn`] takes one turn of the main loop in `src/main.rs`, with the same [`Agenda`]. Time
//! stands still during turns and passes only in [`Desk::pass`]. A test can read and change every
//! part of the desk at any time.

use std::cell::Cell;
use std::collections::VecDeque;
use std::vec::Vec;

use mcp2515_ordered::{Counters, Frame};

use crate::hardware::{Input, OUTPUTS};
use crate::image::InMemory;
use crate::monitor::Monitor;
use crate::node::Node;
use crate::node::acceptance::NodeAcceptance;
use crate::node::agenda::{Agenda, Entry, Facts, Turn};
use crate::node::condition::ResetCause;
use crate::node::servo::{Output, Ticks};
use crate::node::store::{Address, EEPROM_LEN, Eeprom};
use crate::node::wire::Receiver;

/// Bytes that the UART sends in a millisecond at 115200 baud.
const BYTES_PER_MS: u32 = 11;

/// More turns than any millisecond needs. Reaching this limit means an endless loop.
const TURNS_MAX: u32 = 10_000;

/// An EEPROM whose supply can fail. It panics when it is read or written while a write is in
/// progress.
#[derive(Clone)]
pub struct Memory {
    /// The contents.
    pub cells: [u8; EEPROM_LEN],
    /// True if writes have no effect.
    pub is_broken: bool,
    /// Number of writes until the supply fails, and the value that the last of them leaves. Later
    /// writes have no effect.
    pub fails_after: Option<(u16, u8)>,
    busy_for: Cell<u8>,
}

impl Memory {
    /// Polls of `is_busy` until a byte is written: one at every tick of a millisecond, and a byte
    /// takes 3.4 ms (datasheet 2545, section 8.4).
    const BUSY_FOR: u8 = 4;

    /// An erased EEPROM, as delivered.
    pub fn blank() -> Self {
        Self {
            cells: [0xFF; EEPROM_LEN],
            is_broken: false,
            fails_after: None,
            busy_for: Cell::new(0),
        }
    }

    /// Waits for a byte that is being written, as the board does at a start.
    pub fn settle(&mut self) {
        self.busy_for.set(0);
    }
}

impl Eeprom for Memory {
    fn read(&self, at: Address) -> u8 {
        assert_eq!(self.busy_for.get(), 0, "read while a byte is being written");
        self.cells[usize::from(at)]
    }

    fn is_busy(&self) -> bool {
        self.busy_for.set(self.busy_for.get().saturating_sub(1));
        self.busy_for.get() != 0
    }

    fn begin_write(&mut self, at: Address, byte: u8) {
        assert_eq!(
            self.busy_for.replace(Self::BUSY_FOR),
            0,
            "written while a byte is being written"
        );
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

/// The servos, with the last width that each output got.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Servos(pub [Ticks; OUTPUTS]);

impl Output for Servos {
    fn set(&mut self, output: usize, width: Ticks) {
        self.0[output] = width;
    }
}

/// The CAN controller. It is always on the bus, and the bus takes each frame at once.
pub struct Controller {
    /// Received frames that wait in the queue.
    pub received: VecDeque<Frame>,
    /// Frames handed over to send, with the time in milliseconds.
    pub sent: Vec<(u32, Frame)>,
    /// Number of frames that it has room for.
    pub room: u32,
    /// True if it sends no frames.
    pub is_held: bool,
    /// The last filters set after the start. They have no effect: every frame passes.
    pub filters: Option<NodeAcceptance<InMemory>>,
    /// How often [`filters`](Self::filters) were set.
    pub filters_set: u32,
    /// The counters for CanStats.
    pub counters: Counters,
    is_due: bool,
    is_empty: bool,
    has_found_room: bool,
}

/// The node and its board. See the module.
pub struct Desk {
    /// The node.
    pub node: Node,
    /// The node's incoming transfers.
    pub receiver: Receiver,
    /// The node's log.
    pub monitor: Monitor,
    /// Chooses the next turn of the main loop.
    pub agenda: Agenda,
    /// The EEPROM, which survives a reset.
    pub memory: Memory,
    /// The outputs.
    pub servos: Servos,
    /// The CAN controller.
    pub can: Controller,
    /// Milliseconds since the start; the node's clock has the lower 16 bits.
    pub ms: u32,
    /// Readings of the temperature sensor, used alternately.
    pub readings: [u16; 2],
    /// Readings of the circuit's voltage and current.
    #[cfg(feature = "power")]
    pub circuit: [u16; 2],
    /// The input that the ADC measures.
    input: Input,
    /// True while the button is pressed.
    pub is_pressed: bool,
    /// True if a question mark was received on the serial port.
    pub is_asked: bool,
    /// The bytes logged on the serial port.
    pub log: Vec<u8>,
    /// True once the node asked for a restart of the program.
    pub is_to_restart: bool,
    passed_ms: u8,
}

impl Desk {
    /// Starts a node with this EEPROM.
    pub fn start(mut memory: Memory, cause: ResetCause) -> Self {
        memory.settle();
        let mut desk = Self {
            node: Node::new(),
            receiver: Receiver::new(),
            monitor: Monitor::new(),
            agenda: Agenda::new(),
            memory,
            servos: Servos([0; OUTPUTS]),
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
            // The average of 51.5 is 25.15 degrees Celsius for an LM35.
            readings: [51, 52],
            #[cfg(feature = "power")]
            circuit: [0; 2],
            input: Input::Sensor,
            is_pressed: false,
            is_asked: false,
            log: Vec::new(),
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

    /// Takes one turn of the main loop. Returns the turn.
    pub fn turn(&mut self) -> Turn {
        let now_ms = self.now_ms();
        let Self { node, receiver, monitor, can, memory, servos, .. } = self;
        let is_empty = can.is_empty;
        let turn = self.agenda.next(!can.received.is_empty(), node.entry(), || Facts {
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
                    node.receive(
                        &frame,
                        receiver,
                        now_ms,
                        || !can.received.is_empty(),
                        InMemory,
                        monitor,
                        servos,
                    );
                }
            }
            Turn::Tick => {
                let passed_ms = core::mem::take(&mut self.passed_ms);
                can.is_due = true;
                node.expire(receiver, now_ms, monitor);
                node.tick(passed_ms, now_ms, memory, monitor);
                node.show(servos);
                #[cfg(feature = "button")]
                node.read_button(self.is_pressed, passed_ms, monitor);
                let next = node.next_input();
                let reading = match core::mem::replace(&mut self.input, next) {
                    Input::Sensor => self.readings[(self.ms & 1) as usize],
                    #[cfg(feature = "power")]
                    Input::Voltage => self.circuit[0],
                    #[cfg(feature = "power")]
                    Input::Current => self.circuit[1],
                };
                node.read_input(reading, next);
                self.is_to_restart |= node.is_to_restart(now_ms);
            }
            #[cfg(feature = "outputs")]
            Turn::Follow => node.follow_next(now_ms, monitor, servos),
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
                // A frame leaves at once, so the next turn polls the controller again.
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
                        self.log.push(byte);
                    }
                }
                return Turn::Monitor;
            }
        }
        turn
    }

    /// Takes turns until no received frame and no chore is left.
    pub fn settle(&mut self) {
        let mut turns = 0;
        while !self.can.received.is_empty()
            || self.node.entry() != Entry::None
            || self.node.has_chore()
        {
            self.turn();
            turns += 1;
            assert!(turns < TURNS_MAX, "it goes on for ever");
        }
    }

    /// Takes turns until only logging is left, and then logs as many bytes as the UART sends in a
    /// millisecond.
    pub fn idle(&mut self) {
        let (mut turns, mut log) = (0, 0);
        while log < BYTES_PER_MS {
            log += u32::from(self.turn() == Turn::Monitor);
            turns += 1;
            assert!(turns < TURNS_MAX, "it goes on for ever");
        }
    }

    /// Receives a frame; the node acts on it.
    pub fn hear(&mut self, frame: &Frame) {
        self.can.received.push_back(*frame);
        self.settle();
    }

    /// Lets `ms` milliseconds pass. The main loop gets them as one tick.
    pub fn pass(&mut self, ms: u8) {
        self.passed_ms = ms;
        self.idle();
        self.ms += u32::from(ms);
    }
}
