//! The main loop: the only one, on the chip, in the unit tests and in the fuzzer.
//!
//! The program has no operating system. [`Program::turn`] takes one turn: it collects the facts,
//! lets the [agenda](crate::node::agenda) choose, and does that one thing. No turn waits. The
//! hardware is a [`Board`]: `board` of the firmware on the chip, [`desk`](crate::desk) on a host.

use mcp2515_ordered::{Attempts, Configuration, Frame, Notice, State};

use crate::eeprom::Eeprom;
use crate::handover::REQUEST_LEN;
use crate::hardware::CanCounters;
use crate::hardware::{Input, OUTPUTS, ShaftPulses};
use crate::monitor::{self, Monitor, TextsAndNames};
use crate::node::Node;
use crate::node::acceptance::{Filters, NodeAcceptance};
use crate::node::agenda::{Agenda, Facts, Turn};
use crate::node::trust::{Receiver, Trust};
use crate::parts::outputs::Pulses;
use crate::progmem::Progmem;
use crate::tables::condition::ResetCause;
use crate::tables::parameters::{Descriptions, Parameter, Parameters};
use crate::tables::{Constants, bit_rate};

/// The flash with all tables of the program.
pub trait Flash: Constants + Progmem<Descriptions> + Progmem<Filters> + TextsAndNames {}

impl<F: Constants + Progmem<Descriptions> + Progmem<Filters> + TextsAndNames> Flash for F {}

/// The hardware. The program calls each method in the main loop; none of them waits.
///
/// A method whose part a build leaves out is never called by that build, and the default body does
/// nothing.
pub trait Board {
    /// Access to the tables in flash.
    type Flash: Flash;
    /// The outputs.
    type Outputs: Pulses;
    /// The EEPROM.
    type Eeprom: Eeprom;
    /// The counters of the CAN controller.
    type Counters: CanCounters;

    /// The tables in flash.
    const FLASH: Self::Flash;

    /// Why the program started. Called once, before all other methods.
    fn reset_cause(&mut self) -> ResetCause;

    /// The EEPROM, and a source of random bytes. Called once, before [`start`](Self::start).
    fn eeprom_and_noise(&mut self) -> (&mut Self::Eeprom, impl FnMut() -> u8);

    /// Starts outputs, CAN controller and interrupts.
    fn start(
        &mut self,
        parameters: &Parameters,
        controller: Configuration<NodeAcceptance<Self::Flash>>,
    );

    /// A turn of the main loop begins. The board restarts the program if none does for too long.
    fn begin_turn(&mut self) {}

    /// True if a millisecond or more has begun since the last [`tick`](Self::tick).
    fn has_ticked(&self) -> bool;

    /// Adds the milliseconds that have begun since the last call to the time. Returns their number.
    fn tick(&mut self) -> u8;

    /// Milliseconds since the start, modulo 65,536, as of the last [`tick`](Self::tick).
    fn now_ms(&self) -> u16;

    /// True if a received frame waits.
    fn has_frame(&mut self) -> bool;

    /// Calls `act` with the oldest received frame, and removes the frame from the queue.
    fn act_on_frame(&mut self, act: impl FnOnce(&Frame));

    /// The state of the CAN controller.
    fn controller(&mut self, now_ms: u16) -> State;

    /// True if the controller had no frame left to send at its last poll.
    fn is_controller_empty(&mut self) -> bool;

    /// Does the next short step of the controller's start or supervision.
    fn poll_controller(&mut self, now_ms: u16) -> Option<Notice>;

    /// Begins to give the controller other filters.
    fn set_filters(
        &mut self,
        now_ms: u16,
        acceptance: NodeAcceptance<Self::Flash>,
        attempts: Attempts,
    );

    /// Asks the controller if it has room for a frame. [`controller`](Self::controller) then tells.
    fn find_room(&mut self);

    /// Hands a frame to the controller, which has room for it.
    fn send_frame(&mut self, frame: &Frame);

    /// The counters of the controller.
    fn counters(&self) -> &Self::Counters;

    /// The outputs.
    fn outputs(&mut self) -> &mut Self::Outputs;

    /// The EEPROM.
    fn eeprom(&mut self) -> &mut Self::Eeprom;

    /// The result of a conversion of the ADC, 0 to 1023, if it is complete. The next conversion is
    /// of the input `next`, against the bandgap of 1.1 V or AVCC.
    fn reading(&mut self, against_bandgap: bool, next: Input) -> Option<u16>;

    /// True if the level of the button's pin is low.
    fn is_button_pressed(&self) -> bool {
        false
    }

    /// The pulses of the shaft since the last call. Counts the next ones if `is_on` is true.
    fn shaft_pulses(&mut self, _is_on: bool) -> ShaftPulses {
        ShaftPulses::NONE
    }

    /// Sets the brightness of the light: 0 is off, 255 is full.
    fn set_light(&mut self, _brightness: u8) {}

    /// The byte that the serial port received, if there is one.
    fn received_byte(&mut self) -> Option<u8>;

    /// True if the serial port can accept a byte now.
    fn can_send_byte(&self) -> bool;

    /// Sends a byte through the serial port, but not a 0.
    fn send_byte(&mut self, byte: u8);

    /// True if the chip has a bootloader that takes updates over the bus.
    fn has_loader(&self) -> bool {
        false
    }

    /// The program has run for a minute: its earlier restarts no longer lead to the bootloader.
    fn forget_restarts(&mut self) {}

    /// Restarts the program, or hands a request for an update to the bootloader.
    fn restart(&mut self, request: Option<&[u8; REQUEST_LEN]>);
}

/// The program: all state that is not the board's.
pub struct Program {
    /// The node.
    pub node: Node,
    /// The node's incoming transfers.
    pub receiver: Receiver,
    /// The node's log.
    pub monitor: Monitor,
    agenda: Agenda,
}

impl Program {
    /// A program before [`start`](Self::start).
    pub const fn new() -> Self {
        Self {
            node: Node::new(),
            receiver: Receiver::with_policy(Trust::NONE),
            monitor: Monitor::new(),
            agenda: Agenda::new(),
        }
    }

    /// Starts the node and its board. Call it once, before the first turn.
    pub fn start<B: Board>(&mut self, board: &mut B) {
        let Self { node, monitor, .. } = self;
        let cause = board.reset_cause();
        let has_loader = board.has_loader();
        let (eeprom, noise) = board.eeprom_and_noise();
        node.start(cause, has_loader, eeprom, noise, B::FLASH, monitor);
        let timing = bit_rate::timing(node.parameters.get(Parameter::CanBaudrate) as u8);
        let (acceptance, attempts) = (node.acceptance(B::FLASH), node.attempts());
        board.start(&node.parameters, Configuration { timing, acceptance, attempts });
    }

    /// Takes one turn. Returns the turn; [`Turn::Monitor`] if there was nothing to prepare.
    #[inline(always)]
    pub fn turn<B: Board>(&mut self, board: &mut B) -> Turn {
        board.begin_turn();
        let now_ms = board.now_ms();
        let Self { node, receiver, monitor, agenda } = self;
        let turn = agenda.next(board.has_frame(), node.has_entry(), || {
            let controller = board.controller(now_ms);
            Facts {
                has_ticked: board.has_ticked(),
                has_chore: node.has_chore(),
                is_controller_due: controller.is_due,
                wants_filters: node.wants_filters(controller.is_empty),
                is_on_bus: controller.is_running,
                has_room: controller.has_room,
                has_frame_to_send: node.is_ready(),
                has_to_send: node.has_to_send(),
            }
        });
        match turn {
            Turn::ActOnFrame => {
                board.act_on_frame(|frame| {
                    node.receive(frame, receiver, now_ms, B::FLASH, monitor);
                });
            }
            Turn::Follow => node.follow_next(now_ms, monitor, board.outputs()),
            Turn::Tick => self.tick(board),
            Turn::DoChore => node.do_chore(receiver, now_ms, monitor),
            Turn::PollController => self.poll_controller(board),
            Turn::SetFilters => {
                board.set_filters(now_ms, node.acceptance(B::FLASH), node.attempts());
                node.filters_are_set();
            }
            Turn::FindRoom => board.find_room(),
            Turn::SendFrame => {
                board.send_frame(node.frame());
                node.handed_over(now_ms);
            }
            Turn::PrepareFrame if node.prepare(board.counters(), B::FLASH, monitor, now_ms) => {}
            // A message that is due may have to wait. The serial monitor then uses the turn.
            Turn::PrepareFrame | Turn::Monitor => {
                if OUTPUTS > 1 {
                    node.step_store(board.eeprom(), B::FLASH);
                }
                self.monitor(board);
                return Turn::Monitor;
            }
        }
        turn
    }

    /// Does the work of each millisecond.
    #[inline(always)]
    fn tick<B: Board>(&mut self, board: &mut B) {
        let Self { node, receiver, monitor, .. } = self;
        let passed_ms = board.tick();
        let now_ms = board.now_ms();
        node.expire(receiver, now_ms, B::FLASH, monitor);
        node.tick(passed_ms, now_ms, board.eeprom(), B::FLASH, monitor);
        node.show(board.outputs());
        board.set_light(node.light());
        node.read_button(board.is_button_pressed(), passed_ms, monitor);
        let next = node.next_input();
        if let Some(reading) = board.reading(node.parameters.is_on(Parameter::TempRef), next) {
            node.read_input(reading, next);
        }
        let pulses = board.shaft_pulses(node.counts_pulses());
        node.read_shaft(pulses, now_ms, monitor);
        if node.has_run_a_minute() {
            board.forget_restarts();
        }
    }

    /// Polls the controller. Restarts when it has sent what comes before.
    #[inline(always)]
    fn poll_controller<B: Board>(&mut self, board: &mut B) {
        let Self { node, monitor, .. } = self;
        let now_ms = board.now_ms();
        if let Some(notice) = board.poll_controller(now_ms) {
            node.notice(notice);
        }
        let is_empty = board.is_controller_empty();
        if is_empty {
            node.controller_is_empty(now_ms);
        }
        if node.is_to_restart(now_ms, is_empty) && !node.calls_off_update(monitor) {
            let request = node.hand_over(board.eeprom());
            board.restart(request);
        }
    }

    /// Receives or sends a byte of the serial monitor.
    #[inline(always)]
    fn monitor<B: Board>(&mut self, board: &mut B) {
        let Self { node, monitor, .. } = self;
        if !monitor::IS_THERE {
            return;
        }
        if board.received_byte() == Some(b'?') {
            node.report(monitor);
        } else if board.can_send_byte() && node.takes_character() {
            node.begin_log_message(board.now_ms(), monitor);
            let character = monitor.next_byte(B::FLASH);
            if !node.keep_character(character) {
                board.send_byte(character);
            }
        }
    }
}
