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

/// While a command of several frames is coming its next frame is waited for, so that the last one finds nothing in its way: 0.1 ms at a
/// time, as long as there is patience. That comes back by so much in a millisecond: a sender that is slow, or gave up half way, leaves a
/// sixth of the time, and one other thing for each of its frames.
#[cfg(target_arch = "avr")]
const PATIENCE_PER_MS: u8 = 8;

/// What the main loop keeps in mind from one turn to the next.
#[cfg(target_arch = "avr")]
struct Pace {
    /// Frames handled without a pause.
    in_a_row: u8,
    /// 0 while no rest of a command is coming, 1 while it is waited for, 2 while that costs no patience yet, 3 while there is time for one other
    /// thing before that.
    coming: u8,
    /// How often it may still be waited for: see [`PATIENCE_PER_MS`].
    patience: u8,
    /// The controller had no room for a frame: it is asked again at the next tick.
    is_full: bool,
}

#[cfg(target_arch = "avr")]
use {
    board::{Board, CAN_CRYSTAL_HZ, Clock, Servo, flash::Image, guard},
    node::can::bit_timing::BitTiming,
    node::dronecan::{draft::translate, kind::Kind, receive::Receiver},
    node::monitor::Monitor,
    node::node::{
        Node, condition::ResetCause, is_like_a_command, is_of_service, may_be_followed_at_once, parameters::Parameter,
        servo::Output,
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
    static mut PACE: Pace = Pace { in_a_row: 0, coming: 0, patience: 0, is_full: false };

    let Board { clock, mut serial, mut bus, servo, mut adc, mut light, button, mut eeprom, mut jitter, cpu } =
        Board::new();
    NODE.start(guard::reset_cause(&cpu), &mut eeprom, || jitter.sample(), Image, MONITOR);
    let servo = SERVO.insert(servo);
    servo.set_rate(NODE.parameters.get(Parameter::OutRate));
    let timing = BitTiming::at_rate::<CAN_CRYSTAL_HZ>(NODE.parameters.get(Parameter::CanBaudrate) as u8);
    let acceptance = NODE.acceptance(Image);
    bus.can().configure(timing, acceptance, acceptance.node.is_none());
    guard::start();

    let clock = CLOCK.insert(clock);
    loop {
        guard::is_alive();

        // Frames come before all else, and commands before all others: 100 us after its end one of a single frame is in the servo's
        // register, whatever else the node is at.
        let is_prompt = !bus.has_frame_like(may_be_followed_at_once) && bus.receive();
        let now_ms = clock.now_ms();
        if NODE.hears_draft() {
            // Made into one of v0, if it is one of the draft.
            bus.prepare(|frame| translate(frame, Image));
        }
        // Even of an endless flood only so many in a row: then the rest has a turn.
        let is_their_turn = PACE.in_a_row < FRAMES_IN_A_ROW;
        if is_their_turn
            && bus.handle_first(is_like_a_command, |frame| NODE.follow_at_once(frame, now_ms, MONITOR, servo))
        {
            PACE.in_a_row = PACE.in_a_row.wrapping_add(1);
            continue;
        }
        // Something may have to be done before the next frame can be taken. A request of several frames can wait while messages pass it.
        let is_urgent = RECEIVER.has_transfer() || RECEIVER.holds_request() && bus.has_frame_like(is_of_service);
        if !is_urgent {
            // Into its transfer, and if that is a message and whole, what it asks for.
            if is_their_turn
                && bus.handle(|frame, door| NODE.receive(frame, RECEIVER, now_ms, Image, MONITOR, || door.open()))
            {
                PACE.in_a_row = PACE.in_a_row.wrapping_add(1);
                if RECEIVER.awaits_command() {
                    PACE.coming = if is_prompt { 3 } else { 2 };
                }
                if let Some(kind) = RECEIVER.message() {
                    if kind == Kind::ARRAY_COMMAND {
                        PACE.coming = 0;
                        // Until it is in the servo's register no frame is fetched. If it is late already, another may have come.
                        if !is_prompt {
                            bus.receive();
                        }
                    } else if bus.has_frame_like(is_like_a_command) {
                        // That comes first.
                        continue;
                    }
                    bus.and_then_meanwhile(|door| NODE.act(RECEIVER, now_ms, Image, MONITOR, servo, || door.open()));
                }
                continue;
            }
            // The next frame of a command is waited for, but not while the controller is off the bus for its filters.
            if PACE.coming != 0 && bus.can().is_running() {
                let coming = PACE.coming;
                if coming != 1 {
                    PACE.coming = coming.wrapping_sub(1);
                } else if PACE.patience == 0 {
                    PACE.coming = 0;
                } else {
                    PACE.patience = PACE.patience.wrapping_sub(1);
                }
                if coming != 3 {
                    PACE.in_a_row = 0;
                    bus.wait();
                    continue;
                }
            }
        }
        if RECEIVER.has_transfer() || RECEIVER.recall() {
            // Mostly a request: what it asks for can take long, so that is a turn of its own, or two.
            bus.and_then_meanwhile(|door| NODE.act(RECEIVER, now_ms, Image, MONITOR, servo, || door.open()));
            continue;
        }
        PACE.in_a_row = 0;

        // One thing a turn, the rarer first: that bounds the turn.
        let passed_ms = clock.ticked();
        if passed_ms != 0 {
            guard::check_stack();
            PACE.is_full = false;
            PACE.patience = PACE.patience.saturating_add(passed_ms.wrapping_mul(PATIENCE_PER_MS));
            bus.meanwhile(|_| NODE.tick(passed_ms, button.is_pressed(), now_ms, &mut eeprom, MONITOR));
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
                // That takes so long that one may have come.
                bus.receive();
                NODE.handed_over(now_ms);
            } else {
                PACE.is_full = !bus.can().find_room();
            }
        } else if bus.receive() {
            // What has come since the turn began is not kept waiting for what follows.
        } else if bus.can().is_running()
            && NODE.has_to_send()
            && bus.meanwhile(|counters| NODE.prepare(counters, Image, MONITOR, now_ms))
        {
            // One step nearer to the next frame.
        } else {
            if serial.receive() == Some(b'?') {
                NODE.report(MONITOR);
            } else if serial.can_send() && !bus.has_frame() {
                // A frame that has come since is not kept waiting for that.
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
