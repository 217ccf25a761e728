//! The program on a desk: a board of plain variables, for the tests and the fuzzer.
//!
//! [`Desk::turn`] takes one turn of the [program](crate::program). Time stands still during turns
//! and passes only in [`Desk::pass`]. A test can read and change all of it at any time: the node
//! and its modules in [`Desk::program`], and the board, which a desk derefs to.

use std::cell::Cell;
use std::collections::VecDeque;
use std::ops::{Deref, DerefMut};
use std::vec::Vec;

use mcp2515_ordered::{Attempts, Configuration, Counters, Frame, Notice, State};

use crate::eeprom::{Address, EEPROM_LEN, Eeprom};
use crate::handover::REQUEST_LEN;
use crate::hardware::{Input, OUTPUTS, ShaftPulses};
use crate::image::InMemory;
use crate::node::acceptance::NodeAcceptance;
use crate::node::agenda::Turn;
use crate::parts::outputs::Pulses;
use crate::parts::outputs::travel::Ticks;
use crate::program::{Board, Program};
use crate::tables::condition::ResetCause;
use crate::tables::parameters::Parameters;

/// Bytes that the UART sends in a millisecond at 115200 baud.
const BYTES_PER_MS: u32 = 11;

/// More turns than any millisecond needs. Reaching this limit means an endless loop.
const TURNS_MAX: u32 = 10_000;

/// Microseconds of a slot, in which one pulse of the shaft is counted.
const SLOT_US: u64 = ShaftPulses::SLOT_TICKS as u64 * 4;

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

/// The servos, with the last width that each output got, and the levels of relays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Servos(pub [Ticks; OUTPUTS], pub [bool; OUTPUTS]);

impl Pulses for Servos {
    fn set(&mut self, output: usize, width: Ticks) {
        self.0[output] = width;
    }

    fn set_level(&mut self, output: usize, is_high: bool) {
        self.1[output] = is_high;
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

/// The board.
pub struct Table {
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
    pub circuit: [u16; 2],
    /// The brightness of the light.
    pub light: u8,
    /// True while the button is pressed.
    pub is_pressed: bool,
    /// Microseconds from a pulse of the shaft to the next one; 0 while it stands still.
    pub pulse_us: u64,
    /// True if a question mark was received on the serial port.
    pub is_asked: bool,
    /// The bytes logged on the serial port.
    pub log: Vec<u8>,
    /// True if the chip has a bootloader for updates over the bus.
    pub has_loader: bool,
    /// True once the node asked for a restart of the program.
    pub is_to_restart: bool,
    /// The request that the bootloader got.
    pub request: Option<[u8; REQUEST_LEN]>,
    cause: ResetCause,
    noise: u8,
    /// The input that the ADC measures.
    input: Input,
    passed_ms: u8,
    /// Time of the shaft's next pulse.
    next_pulse_us: u64,
    /// The slot of the last pulse that was counted.
    last_slot: u64,
    counts_pulses: bool,
}

impl Board for Table {
    type Flash = InMemory;
    type Outputs = Servos;
    type Eeprom = Memory;
    type Counters = Counters;

    const FLASH: InMemory = InMemory;

    fn reset_cause(&mut self) -> ResetCause {
        self.cause
    }

    fn eeprom_and_noise(&mut self) -> (&mut Memory, impl FnMut() -> u8) {
        let Self { memory, noise, .. } = self;
        (memory, || {
            *noise = noise.wrapping_mul(37).wrapping_add(11);
            *noise
        })
    }

    fn start(&mut self, _: &Parameters, _: Configuration<NodeAcceptance<InMemory>>) {}

    fn has_ticked(&self) -> bool {
        self.passed_ms != 0
    }

    fn tick(&mut self) -> u8 {
        self.can.is_due = true;
        core::mem::take(&mut self.passed_ms)
    }

    fn now_ms(&self) -> u16 {
        self.ms as u16
    }

    fn has_frame(&mut self) -> bool {
        !self.can.received.is_empty()
    }

    fn act_on_frame(&mut self, act: impl FnOnce(&Frame)) {
        if let Some(frame) = self.can.received.pop_front() {
            act(&frame);
        }
    }

    fn controller(&mut self, _now_ms: u16) -> State {
        let Controller { is_due, is_empty, has_found_room, .. } = self.can;
        State { is_due, is_running: true, is_empty, has_room: has_found_room }
    }

    fn is_controller_empty(&mut self) -> bool {
        self.can.is_empty
    }

    fn poll_controller(&mut self, _now_ms: u16) -> Option<Notice> {
        self.can.is_due = false;
        if !self.can.is_held {
            self.can.is_empty = true;
        }
        None
    }

    fn set_filters(&mut self, _: u16, acceptance: NodeAcceptance<InMemory>, _: Attempts) {
        self.can.filters = Some(acceptance);
        self.can.filters_set += 1;
    }

    fn find_room(&mut self) {
        self.can.has_found_room = self.can.room != 0;
    }

    fn send_frame(&mut self, frame: &Frame) {
        let can = &mut self.can;
        can.has_found_room = false;
        if can.room != u32::MAX {
            can.room = can.room.saturating_sub(1);
        }
        can.sent.push((self.ms, *frame));
        can.is_empty = false;
        // A frame leaves at once, so the next turn polls the controller again.
        can.is_due = true;
    }

    fn counters(&self) -> &Counters {
        &self.can.counters
    }

    fn outputs(&mut self) -> &mut Servos {
        &mut self.servos
    }

    fn eeprom(&mut self) -> &mut Memory {
        &mut self.memory
    }

    fn reading(&mut self, _against_bandgap: bool, next: Input) -> Option<u16> {
        Some(match core::mem::replace(&mut self.input, next) {
            Input::Sensor => self.readings[(self.ms & 1) as usize],
            Input::Voltage => self.circuit[0],
            Input::Current => self.circuit[1],
        })
    }

    fn is_button_pressed(&self) -> bool {
        self.is_pressed
    }

    fn shaft_pulses(&mut self, is_on: bool) -> ShaftPulses {
        let mut pulses = ShaftPulses::NONE;
        let now_us = u64::from(self.ms) * 1000;
        if self.pulse_us == 0 {
            self.next_pulse_us = now_us;
        }
        while self.pulse_us != 0 && self.next_pulse_us <= now_us {
            let slot = self.next_pulse_us / SLOT_US;
            if self.counts_pulses && slot != self.last_slot {
                self.last_slot = slot;
                pulses = ShaftPulses {
                    count: pulses.count + 1,
                    ms: (self.next_pulse_us / 1000) as u8,
                    ticks: (self.next_pulse_us % 1000 / 4) as u8,
                };
            }
            self.next_pulse_us += self.pulse_us;
        }
        self.counts_pulses = is_on;
        pulses
    }

    fn set_light(&mut self, brightness: u8) {
        self.light = brightness;
    }

    fn received_byte(&mut self) -> Option<u8> {
        core::mem::take(&mut self.is_asked).then_some(b'?')
    }

    fn can_send_byte(&self) -> bool {
        true
    }

    fn send_byte(&mut self, byte: u8) {
        if byte != 0 {
            self.log.push(byte);
        }
    }

    fn has_loader(&self) -> bool {
        self.has_loader
    }

    fn restart(&mut self, request: Option<&[u8; REQUEST_LEN]>) {
        self.is_to_restart = true;
        self.request = request.copied();
    }
}

/// The program and its board. See the module.
pub struct Desk {
    /// The program.
    pub program: Program,
    /// The board.
    pub board: Table,
}

impl Deref for Desk {
    type Target = Table;

    fn deref(&self) -> &Table {
        &self.board
    }
}

impl DerefMut for Desk {
    fn deref_mut(&mut self) -> &mut Table {
        &mut self.board
    }
}

impl Desk {
    /// Starts a program with this EEPROM.
    pub fn start(memory: Memory, cause: ResetCause) -> Self {
        Self::start_with_loader(memory, cause, false)
    }

    /// The same on a chip that may have a bootloader for updates over the bus.
    pub fn start_with_loader(mut memory: Memory, cause: ResetCause, has_loader: bool) -> Self {
        memory.settle();
        let mut desk = Self {
            program: Program::new(),
            board: Table {
                memory,
                servos: Servos([0; OUTPUTS], [false; OUTPUTS]),
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
                circuit: [0; 2],
                light: 0,
                is_pressed: false,
                pulse_us: 0,
                is_asked: false,
                log: Vec::new(),
                has_loader,
                is_to_restart: false,
                request: None,
                cause,
                noise: 7,
                input: Input::Sensor,
                passed_ms: 0,
                next_pulse_us: 0,
                last_slot: 0,
                counts_pulses: false,
            },
        };
        desk.program.start(&mut desk.board);
        desk
    }

    /// The program's clock.
    pub fn now_ms(&self) -> u16 {
        self.board.now_ms()
    }

    /// Takes one turn of the program. Returns the turn.
    pub fn turn(&mut self) -> Turn {
        self.program.turn(&mut self.board)
    }

    /// Takes turns until no received frame, no entry and no chore is left.
    pub fn settle(&mut self) {
        let mut turns = 0;
        while !self.can.received.is_empty()
            || self.program.node.has_entry()
            || self.program.node.has_chore()
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
