//! Commands for many actuators in transfers of many frames, back to back: only complete and valid
//! ones move the servo.

use bench::avr::Chip;
use rig::status::TRANSFER_ERRORS;
use rig::{ARRAY_COMMAND, MS, Rig, array_command, parse_frames};

/// pydronecan's ArrayCommand of 15: actuator n has (n - 8) / 8, unitless, from node 10 as
/// ArduPilot's. A golden transfer.
const FIFTEEN: &str = "0803F20A C8 B8 01 00 00 BB 02 80 | 00 00 BA 03 00 00 B9 20 | 04 00 00 B8 \
                       05 00 00 00 | B6 06 00 00 B4 07 00 20 | 00 B0 08 00 00 00 09 00 | 00 00 30 \
                       0A 00 00 34 20 | 0B 00 00 36 0C 00 00 00 | 38 0D 00 00 39 0E 00 20 | 00 3A \
                       0F 00 00 3B 40";
/// pydronecan's ArrayCommand of 8: actuator n has (n - 4) / 4, unitless, from node 1 as PX4's. A
/// golden transfer.
const EIGHT: &str = "0603F201 0E 49 00 00 00 BC 01 80 | 00 00 BA 02 00 00 B8 20 | 03 00 00 B4 04 \
                     00 00 00 | 00 05 00 00 34 06 00 20 | 00 38 07 00 00 3A 40";

fn pulse_us(value: f64) -> f64 {
    1500.0 + 500.0 * value
}

/// The frames of fifteen commands; that for actuator 1 is -1.
fn fifteen(transfer_id: u8) -> Vec<Vec<u8>> {
    let commands: Vec<_> = (1..=15).map(|id| (id, 0, if id == 1 { -1.0 } else { 0.25 })).collect();
    array_command(&commands, transfer_id)
}

fn send_all(rig: &mut Rig, source: u32, frames: &[Vec<u8>]) {
    for data in frames {
        rig.send(ARRAY_COMMAND | source, data);
    }
}

#[track_caller]
fn assert_unmoved_and_healthy_after(rig: &mut Rig) {
    assert_eq!(rig.settled_pulse_us(), 1750.0);
    send_all(rig, 10, &fifteen(30));
    assert_eq!(rig.settled_pulse_us(), 1000.0, "the next transfer is followed");
}

#[test]
fn golden_commands_of_nine_and_five_frames_back_to_back_move_the_servo() {
    let mut rig = Rig::running();
    for (frames, pulse) in [(FIFTEEN, pulse_us(-0.875)), (EIGHT, pulse_us(-0.75))] {
        for frame in parse_frames(frames) {
            rig.send_frame(frame);
        }
        assert_eq!(rig.settled_pulse_us(), pulse);
    }
}

#[test]
fn each_actuator_follows_its_command_at_any_place_in_the_list() {
    let mut rig = Rig::running();
    for id in 1..=15 {
        rig.set("OUT1_ID", id);
        for frame in parse_frames(FIFTEEN) {
            rig.send_frame(frame);
        }
        assert_eq!(rig.settled_pulse_us(), pulse_us((id as f64 - 8.0) / 8.0), "actuator {id}");
    }
    rig.set("OUT1_ID", 0);
    for frame in parse_frames(EIGHT) {
        rig.send_frame(frame);
    }
    assert_eq!(rig.settled_pulse_us(), 1000.0, "actuator 0");
}

#[test]
fn of_several_commands_for_an_actuator_the_last_is_followed() {
    let mut rig = Rig::running();
    for frame in parse_frames("1003F20A 08 1A 01 00 00 BC 02 84 | 00 00 34 01 00 00 38 64") {
        rig.send_frame(frame);
    }
    assert_eq!(rig.settled_pulse_us(), 1750.0);
    rig.send_commands(&[(1, 4, 1100.0), (1, 0, 0.0), (1, 4, 1900.0)]);
    assert_eq!(rig.settled_pulse_us(), 1900.0);
}

#[test]
fn fifteen_commands_at_400_hz_are_all_followed() {
    let mut rig = Rig::running();
    let mut t = rig.now();
    for n in 0..400u16 {
        let commands: Vec<_> = (1..=15)
            .map(|id| (id, 4, f32::from(1000 + n + 20 * (id - 1))))
            .map(|(id, unit, value)| (id as u8, unit, value))
            .collect();
        rig.send_commands(&commands);
        t += 5 * MS / 2;
        rig.run_until(t);
    }
    rig.run_ms(100);
    rig.board().avr_mut().serial_send(b"?");
    rig.wait_for_line("commands followed 400, frames refused 0", 300);
    assert_eq!(rig.pulses.last().unwrap().width_us(), 1399.0);
}

#[test]
fn a_wrong_byte_anywhere_does_not_move_the_servo() {
    let mut rig = Rig::positioned();
    for frame in 0..9 {
        for byte in [0, 3, 6] {
            let mut frames = fifteen(frame as u8);
            // The last byte of a frame is its tail byte, not payload.
            let payload = frames[frame].len() - 1;
            if byte >= payload {
                continue;
            }
            frames[frame][byte] ^= 0x10;
            send_all(&mut rig, 10, &frames);
            rig.run_ms(3);
        }
    }
    assert_eq!(rig.settled_pulse_us(), 1750.0);
    let (_, code) = rig.next_status();
    assert_eq!(code & TRANSFER_ERRORS, TRANSFER_ERRORS);
    assert_unmoved_and_healthy_after(&mut rig);
}

#[test]
fn wrong_toggle_bits_do_not_move_the_servo() {
    for wrong in 0..9 {
        let mut rig = Rig::positioned();
        let mut frames = fifteen(5);
        *frames[wrong].last_mut().unwrap() ^= 0x20;
        send_all(&mut rig, 10, &frames);
        assert_unmoved_and_healthy_after(&mut rig);
    }
}

/// Slow buses and adapters take 5 to 12 ms per frame.
#[test]
fn a_transfer_with_a_pause_above_50_ms_is_dropped() {
    for (pause_ms, pulse) in [(12, 1000.0), (45, 1000.0), (60, 1750.0)] {
        let mut rig = Rig::positioned();
        rig.set("OUT1_TIMEOUT", 0);
        for frame in fifteen(5) {
            send_all(&mut rig, 10, &[frame]);
            rig.run_until(rig.now() + pause_ms * MS);
        }
        assert_eq!(rig.settled_pulse_us(), pulse, "{pause_ms} ms");
        send_all(&mut rig, 10, &fifteen(6));
        assert_eq!(rig.settled_pulse_us(), 1000.0);
    }
}

/// Sends two commands of nine frames, for 1000 us and for 1950 us, alternating frame by frame.
fn send_alternately(rig: &mut Rig, first: u32, second: u32) {
    let low = fifteen(1);
    let high = array_command(&(1..=15).map(|id| (id, 0, 0.9)).collect::<Vec<_>>(), 9);
    for (a, b) in low.iter().zip(&high) {
        rig.send(ARRAY_COMMAND | first, a);
        rig.send(ARRAY_COMMAND | second, b);
    }
}

/// True if the node assembles commands of two senders at a time (`lanes` in avr-specs/boards.toml).
fn has_two_lanes() -> bool {
    rig::board().chip == Chip::Atmega328p
}

/// A sender is trusted if its last command of several frames was complete. With two lanes the node
/// follows both senders.
#[test]
fn of_two_simultaneous_senders_the_trusted_one_or_both_are_followed() {
    for is_first in [true, false] {
        let mut rig = Rig::positioned();
        send_all(&mut rig, 10, &fifteen(0));
        if is_first {
            send_alternately(&mut rig, 10, 11);
        } else {
            // The trusted sender's command replaces a transfer that has begun.
            send_alternately(&mut rig, 11, 10);
        }
        // The second sender's command is complete last.
        let pulse_us = if is_first && !has_two_lanes() { 1000.0 } else { 1950.0 };
        assert_eq!(rig.settled_pulse_us(), pulse_us);
        let (_, code) = rig.next_status();
        assert_eq!(
            code & TRANSFER_ERRORS != 0,
            !has_two_lanes(),
            "the status says what was refused"
        );
        // Both are followed if one comes after the other.
        let (low, high) = (fifteen(2), array_command(&[(1, 0, 0.9), (2, 0, 0.0)], 10));
        send_all(&mut rig, 11, &high);
        assert_eq!(rig.settled_pulse_us(), 1950.0);
        send_all(&mut rig, 10, &low);
        assert_eq!(rig.settled_pulse_us(), 1000.0);
    }
}

/// Also that of a sender whose last command was complete.
#[test]
fn an_incomplete_transfer_delays_other_senders_for_at_most_4_ms() {
    for (silent, other, wait_ms, pulse) in
        [(11, 10, 5, 1000.0), (10, 11, 5, 1000.0), (10, 11, 40, 1000.0)]
    {
        let mut rig = Rig::positioned();
        let high = array_command(&[(1, 0, 0.9), (2, 0, 0.0)], 10);
        send_all(&mut rig, 10, &high);
        rig.set("OUT1_TIMEOUT", 0);
        send_all(&mut rig, silent, &fifteen(3)[..4]);
        rig.run_ms(wait_ms);
        send_all(&mut rig, other, &fifteen(4));
        assert_eq!(
            rig.settled_pulse_us(),
            pulse,
            "{silent} is silent, {other} sends after {wait_ms} ms"
        );
    }
}

/// DSDL 1010.ArrayCommand.uavcan: at most 15 commands.
#[test]
fn a_list_of_sixteen_commands_is_rejected() {
    let commands = |count: u8| (1..=count).map(|id| (id, 0, -1.0)).collect::<Vec<_>>();
    let mut rig = Rig::positioned();
    send_all(&mut rig, 10, &array_command(&commands(16), 3));
    assert_eq!(rig.settled_pulse_us(), 1750.0);
    rig.wait_for_line("refused: type 1010 from 10 tid 0, wrong length", 50);
    assert_eq!(rig.next_status().1 & TRANSFER_ERRORS, TRANSFER_ERRORS);
    send_all(&mut rig, 10, &array_command(&commands(15), 4));
    assert_eq!(rig.settled_pulse_us(), 1000.0);
}

#[test]
fn an_invalid_command_in_a_long_transfer_does_not_move_the_servo() {
    let mut rig = Rig::positioned();
    for (unit, value) in [(0, f32::NAN), (0, f32::INFINITY), (4, 0.0), (2, 0.5), (3, 0.5), (9, 0.5)]
    {
        rig.send_commands(&[(2, 0, 0.5), (1, unit, value), (3, 0, 0.5)]);
        assert_eq!(rig.settled_pulse_us(), 1750.0, "type {unit}, {value}");
    }
}
