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

/// The address on the bus: that of the thesis's node.
#[cfg(target_arch = "avr")]
const NODE_ID: node::dronecan::NodeId = node::dronecan::NodeId::new(120).unwrap();

#[cfg(target_arch = "avr")]
use {
    board::{Board, CanInterrupt, CanSpi, flash::Text, guard},
    node::can::{bit_timing::BitTiming, mcp2515::Mcp2515},
    node::dronecan::acceptance::NodeAcceptance,
    node::{monitor::Monitor, node::Node},
};

#[cfg(target_arch = "avr")]
const BIT_TIMING: BitTiming = BitTiming::new(board::CAN_CRYSTAL_HZ, 1_000_000);

#[cfg(target_arch = "avr")]
#[avr_device::entry]
fn main() -> ! {
    // In statics and not on the stack, so that the linker counts them.
    static mut MONITOR: Monitor = Monitor::new();
    static mut NODE: Node = Node::new(NODE_ID);
    static mut CAN: Option<Mcp2515<CanSpi, CanInterrupt, NodeAcceptance>> = None;

    // The only call, so there is always something to take.
    let Some(dp) = avr_device::atmega168::Peripherals::take() else { unreachable!() };
    NODE.start(guard::reset_cause(&dp.CPU), MONITOR);
    let Board { mut clock, mut serial, can_spi, can_interrupt, mut servo, mut adc } = Board::new(dp);
    let can = CAN.insert(Mcp2515::new(can_spi, can_interrupt, NodeAcceptance, BIT_TIMING));
    guard::start();

    let mut frames_in_a_row = 0u8;
    // Whether the controller may have room: asked again at every tick once it had none.
    let mut may_send = true;
    loop {
        guard::check();

        // Frames come before all else. Even of an endless flood of them only so many in a row: then the rest has a turn.
        if can.calls() && frames_in_a_row < FRAMES_IN_A_ROW {
            frames_in_a_row += 1;
            let Ok(received) = can.receive();
            if let Some(received) = received {
                NODE.receive(received, clock.now_ms(), MONITOR);
                servo.set(NODE.pulse());
            }
            continue;
        }
        frames_in_a_row = 0;

        // One thing a turn, the rarer first: that bounds the turn.
        if clock.ticked() {
            may_send = true;
            NODE.tick(clock.now_ms(), MONITOR);
            if let Some(reading) = adc.take() {
                NODE.read_temperature(reading);
            }
        } else if can.is_due(clock.now_ms()) {
            let Ok(notice) = can.poll(clock.now_ms());
            if let Some(notice) = notice {
                NODE.notice(notice, MONITOR);
            }
            if can.is_empty() {
                NODE.controller_is_empty(clock.now_ms());
            }
        } else if may_send && NODE.has_outgoing(clock.now_ms()) {
            if let Some((message, frame)) = NODE.outgoing(clock.now_ms()) {
                Ok(may_send) = can.transmit(&frame, clock.now_ms());
                if may_send {
                    NODE.handed_over(message, clock.now_ms());
                }
            }
        } else {
            if serial.receive() == Some(b'?') {
                NODE.report(MONITOR);
            }
            serial.send(|| MONITOR.next_byte(&Text));
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
