//! The firmware: runs the node on its board. `board` has the pins and all hardware access; the
//! library has everything else.
//!
//! The firmware has one main loop and no operating system. Each turn of the loop does one thing and
//! never waits. [`firmware::node::agenda`] decides what the next turn does. INT0 moves frames from the
//! CAN controller to a queue, and Timer0 counts milliseconds: normal operation needs no
//! other interrupt. Timer1 makes the servo pulse without software.

#![cfg_attr(
    target_arch = "avr",
    no_std,
    no_main,
    feature(asm_experimental_arch, abi_avr_interrupt)
)]
#![deny(unsafe_op_in_unsafe_fn, clippy::undocumented_unsafe_blocks)]
// `avr_device::entry` calls `main` once and gives it a `&mut` reference to each of its statics.
#![cfg_attr(target_arch = "avr", allow(static_mut_refs))]

#[cfg(target_arch = "avr")]
mod board;

#[cfg(all(target_arch = "avr", feature = "update"))]
use board::loader;
#[cfg(target_arch = "avr")]
use {
    board::{Board, flash::Image, guard},
    firmware::monitor::{self, Monitor},
    firmware::node::agenda::{Agenda, Facts, Turn},
    firmware::node::{
        Node, bit_rate, condition::ResetCause, parameters::Parameter, wire::Receiver,
    },
    mcp2515_ordered::Configuration,
};

#[cfg(target_arch = "avr")]
#[avr_device::entry]
fn main() -> ! {
    // These are statics and not on the stack, so that the linker counts their RAM.
    static mut MONITOR: Monitor = Monitor::new();
    static mut RECEIVER: Receiver = Receiver::new();
    static mut NODE: Node = Node::new();
    static mut AGENDA: Agenda = Agenda::new();
    static mut BOARD: Option<Board> = None;
    let (monitor, receiver, node, agenda) = (MONITOR, RECEIVER, NODE, AGENDA);

    let board = BOARD.insert(Board::new());
    node.start(
        guard::reset_cause(&board.cpu),
        &mut board.eeprom,
        || board.jitter.sample(),
        Image,
        monitor,
    );
    board.servo.start(&node.parameters);
    let timing = bit_rate::timing(node.parameters.get(Parameter::CanBaudrate) as u8);
    let (acceptance, attempts) = (node.acceptance(Image), node.attempts());
    board.bus.controller(|can| can.configure(Configuration { timing, acceptance, attempts }));
    #[cfg(feature = "update")]
    {
        node.update.has_loader = loader::is_there();
    }
    guard::start();

    loop {
        guard::is_alive();
        let now_ms = board.clock.now_ms();
        let turn = agenda.next(board.bus.has_frame(), node.entry(), || {
            let controller = board.bus.controller(|can| can.state(now_ms));
            Facts {
                has_ticked: board.clock.has_ticked(),
                has_chore: node.has_chore(),
                is_controller_due: controller.is_due,
                wants_filters: node.wants_filters(controller.is_empty, receiver),
                is_on_bus: controller.is_running,
                has_room: controller.has_room,
                has_frame_to_send: node.is_ready(),
                has_to_send: node.has_to_send(),
            }
        });
        match turn {
            Turn::TakeFrame => {
                let has_backlog = board::has_backlog;
                board.bus.take_frame(|frame| {
                    node.receive(
                        frame,
                        receiver,
                        now_ms,
                        has_backlog,
                        Image,
                        monitor,
                        &mut board.servo,
                    );
                });
            }
            Turn::Tick => {
                let passed_ms = board.clock.tick();
                let now_ms = board.clock.now_ms();
                guard::check_stack();
                node.expire(receiver, now_ms, monitor);
                node.tick(passed_ms, now_ms, &mut board.eeprom, monitor);
                node.show(&mut board.servo);
                #[cfg(feature = "lights")]
                board.light.set(node.light());
                #[cfg(feature = "button")]
                node.read_button(board.button.is_pressed(), passed_ms, monitor);
                let next = node.next_input();
                if let Some(reading) =
                    board.adc.take(node.parameters.is_on(Parameter::TempRef), next)
                {
                    node.read_input(reading, next);
                }
                #[cfg(feature = "update")]
                if node.has_run_a_minute() {
                    loader::forget_restarts();
                }
                if node.is_to_restart(now_ms) {
                    #[cfg(feature = "update")]
                    if let Some(request) = node.hand_over(&mut board.eeprom) {
                        loader::enter(Some(request));
                    }
                    guard::restart(ResetCause::ASKED_FOR);
                }
            }
            #[cfg(feature = "outputs")]
            Turn::Follow => node.follow_next(now_ms, monitor, &mut board.servo),
            Turn::DoChore => node.do_chore(monitor),
            Turn::PollController => {
                if let Some(notice) = board.bus.controller(|can| can.poll(now_ms)) {
                    node.notice(notice, monitor);
                }
                if board.bus.controller(|can| can.state(now_ms).is_empty) {
                    node.controller_is_empty(now_ms);
                }
            }
            Turn::SetFilters => {
                let acceptance = node.acceptance(Image);
                let attempts = node.attempts();
                board.bus.controller(|can| {
                    can.reconfigure(now_ms, |configuration| {
                        configuration.acceptance = acceptance;
                        configuration.attempts = attempts;
                    });
                });
                node.filters_are_set();
            }
            Turn::FindRoom => board.bus.controller(|can| can.find_room()),
            Turn::SendFrame => {
                board.bus.controller(|can| can.transmit(node.frame()));
                node.handed_over(now_ms);
            }
            Turn::PrepareFrame if node.prepare(&board.bus, Image, monitor, now_ms) => {}
            // A message that is due may have to wait. The serial monitor then uses the turn.
            Turn::PrepareFrame | Turn::Monitor if monitor::IS_THERE => {
                if board.serial.receive() == Some(b'?') {
                    node.report(monitor);
                } else if board.serial.can_send() && node.takes_character() {
                    let character = monitor.next_byte(Image);
                    board.serial.send(character);
                    node.take_character(character);
                }
            }
            Turn::PrepareFrame | Turn::Monitor => {}
        }
    }
}

/// Prints how to flash and how to simulate: the firmware runs on an Arduino and not on the host.
#[cfg(not(target_arch = "avr"))]
fn main() {
    eprintln!(
        "This is firmware for an Arduino: `make flash PORT=/dev/ttyUSB0` uploads it, `make sim` runs it here."
    );
    std::process::exit(2);
}
