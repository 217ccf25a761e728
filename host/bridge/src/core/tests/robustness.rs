//! Tests with invalid input.

use super::rig::*;

/// Random frames and messages must not cause a panic or use up memory.
#[test]
fn random_input_from_both_sides_causes_no_panic() {
    let mut rig = Rig::with_node(5);
    let mut seed = 0x1234_5678_9ABC_DEF1_u64;
    let mut random = move || {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        seed
    };
    for round in 0..20_000 {
        let data = random().to_le_bytes();
        let mut id = random() as u32 & 0x1FFF_FFFF;
        if round % 2 == 0 {
            // A response to the bridge, or a status.
            id = if round % 4 == 0 { 0x1E0B_7EAA } else { 0x1801_552A };
        }
        rig.bridge.frame(rig.now, &Frame::extended(id, &data[..(random() % 9) as usize]));
        let request = match random() % 6 {
            0 => Request::ParameterList,
            1 => Request::ParameterRead { index: Some(random() as u16), name: String::new() },
            2 => Request::ParameterRead { index: None, name: "PARAM_1".into() },
            3 => Request::ParameterSet {
                name: "PARAM_2".into(),
                value: f32::from_bits(random() as u32),
                kind: random() as u8,
            },
            4 => Request::Command(Command {
                number: [245, 246, 512, 519, 520, 5200, 32_000, random() as u16]
                    [(random() % 8) as usize],
                params: [
                    f32::from_bits(random() as u32),
                    (random() % 5) as f32,
                    f32::NAN,
                    f32::INFINITY,
                    -1.0,
                    1e30,
                    0.0,
                ],
            }),
            _ => Request::Frame(CAN_FRAME_DATA {
                id: random() as u32,
                len: random() as u8,
                bus: 0,
                ..CAN_FRAME_DATA::default()
            }),
        };
        let component = [0, 42, 126, random() as u8][(random() % 4) as usize];
        rig.send_request((1, component), request);
        if round % 100 == 0 {
            rig.run_ms(5);
            rig.posts.clear();
        }
    }
    rig.run_ms(20_000);
    rig.sent_messages();
    rig.list(42);
    rig.run_ms(2000);
    assert_eq!(rig.parameters().len(), 5);
    assert!(rig.bridge.commands.is_idle());
}
