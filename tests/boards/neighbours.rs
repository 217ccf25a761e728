//! Other nodes on the bus: some send too much, some do not end their transfers. The node must still
//! follow the commander and answer other clients.

use bench::Noise;
use bench::can::{Frame, Id};
use bench::dronecan::{Message, ParameterRequest};
use rig::{ARRAY_COMMAND, MS, Program, Rig, US, array_command, has_all_features, is_from_node};

/// The autopilot's command, node 10, in nine frames: `n` microseconds for actuator 1.
fn long_command(n: u16) -> Vec<Vec<u8>> {
    let commands: Vec<_> = (1..=15).map(|id| (id, 4, f32::from(1000 + n))).collect();
    array_command(&commands, n as u8 & 31)
}

fn first_frame(source: u32) -> Frame {
    Frame::extended(ARRAY_COMMAND | source, &[0x12, 0xF3, 1, 0, 0, 0x38, 2, 0x80])
}

/// The peer sends commands at 50 Hz, nine frames each; `mix` sends each frame and puts others in
/// between. Each command has its own width, and a pulse must have it.
#[track_caller]
fn assert_all_are_followed(rig: &mut Rig, mut mix: impl FnMut(&mut Rig, usize)) {
    // A command in several frames: from now on the commander completes what it begins.
    for data in long_command(0) {
        rig.send(ARRAY_COMMAND | 10, &data);
    }
    rig.run_ms(100);
    rig.forget();
    for n in 0..100 {
        for (at, data) in long_command(n).iter().enumerate() {
            rig.send(ARRAY_COMMAND | 10, data);
            mix(rig, at);
        }
        rig.run_ms(20);
    }
    rig.run_ms(50);
    let widths: Vec<f64> = rig.pulses.iter().map(|pulse| pulse.width_us()).collect();
    let missed: Vec<u16> = (0..100).filter(|&n| !widths.contains(&f64::from(1000 + n))).collect();
    // A pulse begins every 20 ms, so now and then two commands arrive between two pulses.
    assert!(missed.len() <= 2, "not followed: {missed:?}");
    let longest =
        rig.pulses.windows(2).filter(|pair| pair[0].width_us() == pair[1].width_us()).count();
    assert!(longest <= 4, "{longest} pulses had the width of an older command");
}

#[test]
fn incomplete_commands_of_others_do_not_stop_the_commander() {
    // A first frame after each of the commander's frames, or one a second, or from many nodes, or
    // after each from a node that is trusted at first, because it has completed a list.
    for pattern in 0..4 {
        let mut rig = Rig::running();
        if pattern == 3 {
            for data in long_command(500) {
                rig.send(ARRAY_COMMAND | 11, &data);
            }
        }
        let mut n = 0;
        assert_all_are_followed(&mut rig, |rig, at| {
            n += 1;
            match pattern {
                0 | 3 => rig.send_frame(first_frame(11)),
                1 if n % 450 == 3 => rig.send_frame(first_frame(11)),
                2 if at == 4 => (11..30).for_each(|source| rig.send_frame(first_frame(source))),
                _ => {}
            }
        });
    }
}

#[test]
fn commands_of_others_for_other_actuators_do_not_stop_the_commander() {
    let mut rig = Rig::running();
    let others: Vec<_> = (21..=35).map(|id| (id, 0, 0.5)).collect();
    let others = array_command(&others, 3);
    // The two commands alternate frame by frame.
    assert_all_are_followed(&mut rig, |rig, at| rig.send(ARRAY_COMMAND | 11, &others[at]));
}

/// The other node's command occupies the lane before the commander's begins.
#[test]
fn the_commander_s_command_replaces_another_node_s_incomplete_one() {
    for pause_us in [0, 150, 1000, 19_000] {
        let mut rig = Rig::running();
        for data in long_command(100) {
            rig.send(ARRAY_COMMAND | 10, &data);
        }
        rig.run_ms(50);
        rig.send_frame(first_frame(11));
        rig.run_until(rig.now() + pause_us * US);
        for data in long_command(300) {
            rig.send(ARRAY_COMMAND | 10, &data);
        }
        assert_eq!(rig.settled_pulse_us(), 1300.0, "{pause_us} us");
    }
}

#[test]
fn an_incomplete_request_does_not_stop_other_clients() {
    let mut rig = Rig::running();
    // The first frame of a GetSet request, from node 126.
    let half = Frame::extended(0x1E0B_F8FE, &[0xC1, 0x45, 0x00, 0x01, 0x20, 0xA1, 0x07, 0x82]);
    assert_eq!(rig.parameter("OUT1_TIMEOUT").name, b"OUT1_TIMEOUT");
    for n in 0..50 {
        rig.send_frame(half);
        rig.run_until(rig.now() + n * 100 * US);
        // Panics if the answer takes longer than ANSWER_TIMEOUT_MS.
        assert_eq!(rig.parameter("OUT1_TIMEOUT").name, b"OUT1_TIMEOUT");
    }
}

/// An ATmega328P can assemble two transfers at a time.
#[test]
fn two_alternating_senders_are_both_received_on_an_atmega328p() {
    let mut rig = Program::With("full").powered();
    rig.wait_until_up();
    let (low, high) = (long_command(100), long_command(200));
    for (first, second) in [(10, 11), (11, 10)] {
        rig.forget();
        for (a, b) in low.iter().zip(&high) {
            rig.send(ARRAY_COMMAND | first, a);
            rig.send(ARRAY_COMMAND | second, b);
        }
        rig.run_ms(50);
        assert!(!rig.serial.contains("refused"), "{}", rig.serial);
        assert_eq!(rig.settled_pulse_us(), 1200.0, "the command that ended last");
    }
    // The same with two requests by name.
    let request = |name: &str, source: u32| -> Vec<Frame> {
        let request = ParameterRequest { name: name.into(), ..ParameterRequest::default() };
        let (data_type, payload) = Message::ParameterRequest(request).encode().expect("a request");
        let frames = bench::dronecan::split(
            &payload,
            bench::dronecan::TransferId::new(5),
            data_type.seed.expect("known"),
        );
        frames.iter().map(|data| Frame::extended(0x1E0B_F880 | source, data)).collect()
    };
    rig.forget();
    for (a, b) in request("OUT1_TIMEOUT", 126).into_iter().zip(request("OUT1_REVERSED", 127)) {
        rig.send_frame(a);
        rig.send_frame(b);
    }
    rig.run_ms(50);
    for client in [126, 127] {
        let is_answer =
            |frame: &Frame| matches!(frame.id, Id::Extended(id) if id == 0x1E0B_00F8 | client << 8);
        let frames = rig.traffic.iter().filter(|(_, frame)| is_answer(frame)).count();
        assert_eq!(frames, 8, "an answer to {client}");
    }
}

/// When the failsafe begins, the node writes the filters again, for which the controller leaves the
/// bus. The node must wait until no frame is in progress, so that it interrupts none of its own
/// frames and loses none that it has acknowledged.
fn set_filters_at_many_moments(phases: u64) {
    let mut rig = Rig::running();
    rig.set("OUT1_TIMEOUT", 40);
    rig.set("TELEM_RATE", 50);
    rig.set("TEMP_RATE", 50);
    let mut random = Noise::new(18);
    let mut times_told = 0;
    rig.forget();
    for phase in 0..phases {
        rig.send_command(1, 0, 0.1);
        rig.run_until(rig.now() + 36 * MS + random.below(8000) * US);
        let mut asked = 0;
        for _ in 0..6 {
            // An answer of eleven frames, or one to a request of three.
            if random.below(2) == 0 {
                rig.request(&Message::NodeInfoRequest);
            } else {
                let request = ParameterRequest {
                    name: b"OUT1_TIMEOUT".to_vec(),
                    ..ParameterRequest::default()
                };
                rig.request(&Message::ParameterRequest(request));
            }
            asked += 1;
            rig.run_until(rig.now() + random.below(2500) * US);
        }
        // The monitor goes last.
        rig.run_ms(80);
        assert_eq!(rig.answers().len(), asked, "phase {phase}\n{}", rig.serial);
        let broken: Vec<_> =
            rig.broken.iter().filter(|(_, frame, _)| is_from_node(frame)).collect();
        assert!(broken.is_empty(), "phase {phase}: {broken:?}");
        times_told += rig.serial.matches("CAN: running").count();
        assert_eq!(rig.board().chip().borrow().rx_overflows(), 0);
        rig.forget();
    }
    // Once a second; a phase takes 120 ms. With all features the lines of the requests fill the
    // monitor's queue.
    let least = if has_all_features() { 1 } else { phases as usize / 20 };
    assert!(times_told >= least, "{times_told} times on the bus again");
}

#[test]
fn setting_the_filters_interrupts_and_loses_no_frame() {
    set_filters_at_many_moments(40);
}

#[test]
#[ignore = "takes long: make test-all"]
fn setting_the_filters_at_a_thousand_moments_interrupts_and_loses_no_frame() {
    set_filters_at_many_moments(1000);
}
