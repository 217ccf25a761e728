//! The node on its board. See `board` for the pins, and the library for everything that is not hardware.
//!
//! One loop, no operating system: each turn serves every part once, and none ever waits for anything. A turn must not take
//! longer than 250 us, because the CAN controller holds two frames and a frame lasts 131 us or more (docs/benchmarks.md).

#![cfg_attr(target_arch = "avr", no_std, no_main, feature(asm_experimental_arch, abi_avr_interrupt))]
#![deny(unsafe_op_in_unsafe_fn, clippy::undocumented_unsafe_blocks)]
// `avr_device::entry` hands the statics of `main` to it as references, once.
#![cfg_attr(target_arch = "avr", allow(static_mut_refs))]

#[cfg(target_arch = "avr")]
mod board;

/// The next frame is not kept waiting for anything else until so many have been handled without a pause.
#[cfg(target_arch = "avr")]
const FRAMES_IN_A_ROW: u8 = 8;

#[cfg(target_arch = "avr")]
use {
    board::{Board, CAN_CRYSTAL_HZ, CanInterrupt, CanSelect, CanSpi, flash::Image, guard},
    node::can::{bit_timing::BitTiming, mcp2515::Mcp2515},
    node::dronecan::{acceptance::NodeAcceptance, receive::Receiver},
    node::monitor::Monitor,
    node::node::{Node, condition::ResetCause, parameters::Parameter},
};

#[cfg(target_arch = "avr")]
#[avr_device::entry]
fn main() -> ! {
    // In statics and not on the stack, so that the linker counts them.
    static mut MONITOR: Monitor = Monitor::new();
    static mut RECEIVER: Receiver = Receiver::new();
    static mut NODE: Node = Node::new();
    static mut CAN: Option<Mcp2515<CanSpi, CanSelect, CanInterrupt, NodeAcceptance<Image>>> = None;

    let mut board = Board::new();
    NODE.start(guard::reset_cause(&board.cpu), &mut board.eeprom, || board.jitter.sample(), Image, MONITOR);
    board.servo.set_rate(NODE.parameters.get(Parameter::SrvRate));
    let timing = BitTiming::at_rate::<CAN_CRYSTAL_HZ>(NODE.parameters.get(Parameter::CanBaudrate) as u8);
    let acceptance = NODE.acceptance(Image);
    let can = CAN.insert(Mcp2515::new(
        board.can_spi,
        board.can_select,
        board.can_interrupt,
        timing,
        acceptance,
        acceptance.node.is_none(),
    ));
    guard::start();

    let mut frames_in_a_row = 0u8;
    // Whether the controller may have room: asked again at every tick once it had none.
    let mut may_send = true;
    loop {
        guard::check();
        let now_ms = board.clock.now_ms();

        // Frames come before all else: out of the controller, into their transfer, and what that asks for, each a turn of its
        // own, so that the next frame need not wait for all of it.
        if can.calls() {
            can.receive();
        }
        if RECEIVER.has_transfer() {
            NODE.act(RECEIVER, now_ms, Image, MONITOR);
            board.servo.set(NODE.pulse());
            continue;
        }
        // Even of an endless flood only so many in a row: then the rest has a turn.
        if frames_in_a_row < FRAMES_IN_A_ROW
            && let Some(frame) = can.frame()
        {
            frames_in_a_row += 1;
            NODE.receive(frame, RECEIVER, now_ms, Image, MONITOR);
            can.release();
            continue;
        }
        frames_in_a_row = 0;

        // One thing a turn, the rarer first: that bounds the turn.
        if board.clock.ticked() {
            may_send = true;
            NODE.tick(board.button.is_pressed(), now_ms, &mut board.eeprom, MONITOR);
            board.servo.set(NODE.pulse());
            board.light.set(NODE.light());
            if NODE.takes_filters() {
                can.reconfigure(NODE.acceptance(Image), false);
            }
            if NODE.is_to_restart(now_ms) {
                guard::restart(ResetCause::ASKED_FOR);
            }
            if let Some(reading) = board.adc.take(NODE.parameters.is_on(Parameter::TempRef)) {
                NODE.read_temperature(reading);
            }
        } else if NODE.do_chore(MONITOR) {
            // What a tick left to be done.
        } else if can.is_due(now_ms) {
            if let Some(notice) = can.poll(now_ms) {
                NODE.notice(notice, MONITOR);
            }
            if can.is_empty() {
                NODE.controller_is_empty(now_ms);
            }
        } else if can.is_running() && may_send && NODE.is_ready() {
            if can.has_room() {
                can.transmit(NODE.frame());
                NODE.handed_over(now_ms);
            } else {
                may_send = can.find_room();
            }
        } else if can.is_running() && NODE.prepare(can.counters(), Image, MONITOR, now_ms) {
            // One step nearer to the next frame.
        } else {
            if board.serial.receive() == Some(b'?') {
                NODE.report(MONITOR);
            }
            board.serial.send(|| MONITOR.next_byte(Image));
        }
    }
}

/// The firmware is for the ATmega168; on the host this only says how to build it.
#[cfg(not(target_arch = "avr"))]
fn main() {
    eprintln!(
        "This is firmware for an ATmega168. `make firmware` builds it, `make flash` uploads it, `make sim` runs it here."
    );
    std::process::exit(2);
}
