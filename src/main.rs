//! The node on its board. See `board` for the pins, and the library for everything that is not hardware.
//!
//! One loop, no operating system: each turn does one thing, and none ever waits for anything. One interrupt gets frames out of the CAN
//! controller while a turn takes long, and a second counts milliseconds. No turn takes longer than 250 us (docs/benchmarks.md).

#![cfg_attr(target_arch = "avr", no_std, no_main, feature(asm_experimental_arch, abi_avr_interrupt))]
#![deny(unsafe_op_in_unsafe_fn, clippy::undocumented_unsafe_blocks)]
// `avr_device::entry` hands the statics of `main` to it as references, once.
#![cfg_attr(target_arch = "avr", allow(static_mut_refs))]

#[cfg(target_arch = "avr")]
mod board;

/// The next frame is not kept waiting for anything else until so many have been handled without a pause.
#[cfg(target_arch = "avr")]
const FRAMES_IN_A_ROW: u8 = 8;

/// While a command of several frames is coming, its next frame is waited for so many turns, 0.2 ms, so that the last one finds nothing in
/// its way.
#[cfg(target_arch = "avr")]
const TURNS_TO_WAIT: u8 = 60;

/// What the main loop keeps in mind from one turn to the next.
#[cfg(target_arch = "avr")]
struct Pace {
    /// Frames handled without a pause.
    in_a_row: u8,
    /// Turns that are still to be spent on waiting for the rest of a command; in the first of them something else may be done.
    waiting: u8,
    /// The controller had no room for a frame: it is asked again at the next tick.
    is_full: bool,
}

#[cfg(target_arch = "avr")]
use {
    board::{Board, CAN_CRYSTAL_HZ, Clock, Servo, flash::Image, guard},
    node::can::bit_timing::BitTiming,
    node::dronecan::{kind::Kind, receive::Receiver},
    node::monitor::Monitor,
    node::node::{
        Node, condition::ResetCause, is_like_a_command, may_be_followed_at_once, parameters::Parameter, servo::Output,
    },
};

#[cfg(target_arch = "avr")]
#[avr_device::entry]
fn main() -> ! {
    // In statics and not on the stack, so that the linker counts them.
    static mut MONITOR: Monitor = Monitor::new();
    static mut RECEIVER: Receiver = Receiver::new();
    static mut NODE: Node = Node::new();
    static mut CLOCK: Option<Clock> = None;
    static mut SERVO: Option<Servo> = None;
    static mut PACE: Pace = Pace { in_a_row: 0, waiting: 0, is_full: false };

    let Board { clock, mut serial, mut bus, servo, mut adc, mut light, button, mut eeprom, mut jitter, cpu } =
        Board::new();
    NODE.start(guard::reset_cause(&cpu), &mut eeprom, || jitter.sample(), Image, MONITOR);
    let servo = SERVO.insert(servo);
    servo.set_rate(NODE.parameters.get(Parameter::SrvRate));
    let timing = BitTiming::at_rate::<CAN_CRYSTAL_HZ>(NODE.parameters.get(Parameter::CanBaudrate) as u8);
    let acceptance = NODE.acceptance(Image);
    bus.can().configure(timing, acceptance, acceptance.node.is_none());
    guard::start();

    let clock = CLOCK.insert(clock);
    loop {
        guard::check();

        // Frames come before all else, and commands before all others: 100 us after its end one of a single frame is in the servo's
        // register, whatever else the node is at.
        let is_prompt = !bus.has_frame_like(may_be_followed_at_once) && bus.receive();
        // Even of an endless flood only so many in a row: then the rest has a turn.
        if PACE.in_a_row < FRAMES_IN_A_ROW {
            if bus.handle_first(is_like_a_command, |frame| NODE.follow_at_once(frame, clock.now_ms(), MONITOR, servo)) {
                PACE.in_a_row += 1;
                continue;
            }
            let now_ms = clock.now_ms();
            if RECEIVER.has_transfer() {
                // Mostly a request: what it asks for can take long, so that is a turn of its own, or two.
                bus.meanwhile(|_| NODE.act(RECEIVER, now_ms, Image, MONITOR, servo));
                continue;
            }
            // Into its transfer, and if that is a message and whole, what it asks for.
            if bus.handle(|frame| NODE.receive(frame, RECEIVER, now_ms, Image, MONITOR)) {
                PACE.in_a_row += 1;
                if RECEIVER.awaits_command() {
                    PACE.waiting = if is_prompt { TURNS_TO_WAIT } else { TURNS_TO_WAIT - 1 };
                }
                if let Some(kind) = RECEIVER.message() {
                    // A command is not interrupted. Of what is none, if a command waits already, that comes first.
                    let is_command = kind == Kind::ARRAY_COMMAND;
                    if is_command {
                        PACE.waiting = 0;
                    }
                    if is_command || !bus.has_frame_like(is_like_a_command) {
                        bus.meanwhile_if(!is_command, |_| NODE.act(RECEIVER, now_ms, Image, MONITOR, servo));
                    }
                }
                continue;
            }
        }
        PACE.in_a_row = 0;
        if PACE.waiting != 0 {
            PACE.waiting -= 1;
            if PACE.waiting != TURNS_TO_WAIT - 1 {
                continue;
            }
        }

        let now_ms = clock.now_ms();
        // One thing a turn, the rarer first: that bounds the turn.
        if clock.ticked() {
            PACE.is_full = false;
            bus.meanwhile(|_| NODE.tick(button.is_pressed(), now_ms, &mut eeprom, MONITOR));
            servo.set(NODE.pulse());
            light.set(NODE.light());
            if NODE.takes_filters() {
                bus.can().reconfigure(NODE.acceptance(Image), false);
            }
            if NODE.is_to_restart(now_ms) {
                guard::restart(ResetCause::ASKED_FOR);
            }
            if let Some(reading) = adc.take(NODE.parameters.is_on(Parameter::TempRef)) {
                NODE.read_temperature(reading);
            }
        } else if NODE.has_chores() {
            bus.meanwhile(|_| NODE.do_chore(MONITOR));
        } else if bus.can().is_due(now_ms) {
            if let Some(notice) = bus.can().poll(now_ms) {
                NODE.notice(notice, MONITOR);
            }
            if bus.can().is_empty() {
                NODE.controller_is_empty(now_ms);
            }
        } else if bus.can().is_running() && !PACE.is_full && NODE.is_ready() {
            if bus.can().has_room() {
                bus.can().transmit(NODE.frame());
                bus.meanwhile(|_| NODE.handed_over(now_ms));
            } else {
                PACE.is_full = !bus.can().find_room();
            }
        } else if bus.can().is_running()
            && NODE.has_to_send()
            && bus.meanwhile(|counters| NODE.prepare(counters, Image, MONITOR, now_ms))
        {
            // One step nearer to the next frame.
        } else {
            if serial.receive() == Some(b'?') {
                NODE.report(MONITOR);
            }
            // A frame that has come since is not kept waiting for that.
            if serial.can_send() && !bus.has_frame() {
                bus.meanwhile(|_| serial.send(MONITOR.next_byte(Image)));
            }
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
