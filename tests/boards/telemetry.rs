//! The position of the servo in actuator.Status, and the rates of the node's messages.

use bench::Cycles;
use bench::can::Id;
use bench::dronecan::{ActuatorStatus, Message};
use rig::{NODE, Rig};

const ACTUATOR_STATUS_OF_NODE: u32 = 0x1803_F300 | NODE;
const POWER_UNKNOWN: u8 = 127;

fn positions(rig: &Rig) -> Vec<(Cycles, ActuatorStatus)> {
    rig.node_messages(|message| match message {
        Message::ActuatorStatus(status) => Some(status),
        _ => None,
    })
}

#[test]
fn its_frames_leave_in_order_without_other_messages_in_between() {
    let mut rig = Rig::running();
    rig.set("TELEM_RATE", 50);
    rig.set("TEMP_RATE", 50);
    rig.forget();
    for n in 0..60u16 {
        rig.send_status_from(1);
        rig.run_ms(1);
        rig.request(&Message::NodeInfoRequest);
        rig.run_ms(1);
        rig.send_command(1, 4, f32::from(1200 + n));
        rig.run_ms(15);
    }
    assert!(rig.broken.is_empty(), "{:?}", rig.broken);
    assert!(positions(&rig).len() >= 45);
    assert_eq!(rig.answers().len(), 60);
    let frames = rig.frames(ACTUATOR_STATUS_OF_NODE);
    let numbers: Vec<u8> = frames.iter().map(|(_, data)| data.last().unwrap() & 0x1F).collect();
    assert!(numbers.windows(2).all(|w| w[0] == w[1] || (w[0] + 1) % 32 == w[1]), "{numbers:?}");
    // Between the frames of a transfer the node must send no other message.
    let own: Vec<u32> = rig
        .traffic
        .iter()
        .filter_map(|(_, frame)| match frame.id {
            Id::Extended(id) if id & 0x7F == NODE => Some((id, *frame.data().last().unwrap())),
            _ => None,
        })
        .scan(None, |open, (id, tail)| {
            if let Some(expected) = *open {
                assert_eq!(id, expected, "a frame of another transfer in between");
            }
            *open = (tail & 0x40 == 0).then_some(id);
            Some(id)
        })
        .collect();
    assert!(own.len() > 500);
}

#[test]
fn the_position_is_the_pulse_in_radians() {
    let mut rig = Rig::running();
    let quarter = std::f32::consts::FRAC_PI_4;
    for (command_type, value, radians) in [
        (0, 0.5, quarter / 2.0),
        (0, -1.0, -quarter),
        (1, 0.5, 0.5),
        (1, -0.25, -0.25),
        (4, 1500.0, 0.0),
        (4, 1900.0, 0.8 * quarter),
        (1, 3.0, quarter),
    ] {
        rig.send_command(1, command_type, value);
        rig.run_ms(20);
        rig.forget();
        rig.run_ms(250);
        let (_, status) = positions(&rig).pop().expect("a status");
        let position = status.position.to_f32();
        assert!(
            (position - radians).abs() < 0.002,
            "{position} rad for type {command_type}, {value}"
        );
        assert_eq!((status.actuator, status.power_percent), (1, POWER_UNKNOWN));
        assert!(
            status.force.is_nan() && status.speed.is_nan(),
            "the node does not measure force or speed"
        );
    }
    rig.set("OUT1_ID", 77);
    rig.set("OUT1_RANGE", 180);
    rig.set("OUT1_REVERSED", 1);
    rig.send_command(77, 0, 0.5);
    rig.run_ms(20);
    rig.forget();
    rig.run_ms(250);
    let (_, status) = positions(&rig).pop().unwrap();
    assert_eq!(status.actuator, 77);
    assert!(
        (status.position.to_f32() - quarter).abs() < 0.004,
        "the position must be that of an equal command: {status}"
    );
}

#[test]
fn unknown_values_are_nan() {
    let mut rig = Rig::running();
    rig.run_ms(500);
    let reported = positions(&rig);
    assert!(
        reported.len() >= 4 && reported.iter().all(|(_, status)| status.position.is_nan()),
        "without a pulse the position must be NaN"
    );
    // pydronecan's NaN, or that of IEEE 754 without the sign. Other receivers may not recognise
    // other NaNs.
    for (_, status) in reported {
        for value in [status.position, status.force, status.speed] {
            assert!([0x7E00, 0x7FFF].contains(&value.to_bits()), "{:#06x}", value.to_bits());
        }
    }
    rig.set("OUT1_FS", 3);
    rig.set("OUT1_TIMEOUT", 200);
    rig.send_command(1, 0, 0.0);
    rig.run_ms(150);
    assert_eq!(positions(&rig).last().unwrap().1.position.to_f32(), 0.0);
    rig.run_ms(400);
    assert!(
        positions(&rig).last().unwrap().1.position.is_nan(),
        "after the failsafe ended the pulses the position must be NaN"
    );
}
