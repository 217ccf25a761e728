//! The button, whose presses the node publishes, and the light, which it dims on command, in the
//! firmware that has them.

use bench::dronecan::{Button, KeyValue, LightCommand, Message};
use rig::{MS, NODE, Program, Rig};

const PROGRAM: Program = Program::Full;

const KEY_VALUE_OF_NODE: u32 = 0x183F_F200 | NODE;
// ---- button ----

/// Presses or releases the button with `bounces` bounces of a millisecond each.
fn bounce(rig: &mut Rig, pressed: bool, bounces: u32) {
    for n in 0..bounces {
        rig.board().press_button(if n % 2 == 0 { pressed } else { !pressed });
        rig.run_ms(1);
    }
    rig.board().press_button(pressed);
}

fn presses(rig: &Rig) -> Vec<f32> {
    let pressed = rig.node_messages(|message| match message {
        Message::KeyValue(KeyValue { value, key }) if key == b"btn" => Some(value),
        _ => None,
    });
    pressed.into_iter().map(|(_, value)| value).collect()
}

#[test]
fn a_press_of_the_button_publishes_the_count_once_despite_bounces() {
    let mut rig = PROGRAM.running();
    for count in 1..=5u8 {
        bounce(&mut rig, true, 9);
        rig.run_ms(200);
        assert_eq!(presses(&rig).len(), usize::from(count));
        bounce(&mut rig, false, 9);
        rig.run_ms(200);
    }
    assert_eq!(presses(&rig), [1.0, 2.0, 3.0, 4.0, 5.0]);
    let frames = rig.frames(KEY_VALUE_OF_NODE);
    // pydronecan's KeyValue(value=3.0, key="btn"); only the transfer ID differs.
    assert_eq!(frames[2].1, [0x00, 0x00, 0x40, 0x40, 0x62, 0x74, 0x6E, 0xC2]);
}

/// ArduPilot toggles its safety switch at the message with a press of ten tenths
/// (AP_BoardConfig::safety_button_handle_pressed).
#[test]
fn a_press_of_a_second_toggles_the_safety_switch_of_ardupilot_once() {
    for (ms, toggles) in [(900, 0), (1200, 1), (3000, 1)] {
        let mut rig = PROGRAM.running();
        bounce(&mut rig, true, 9);
        rig.run_ms(ms);
        bounce(&mut rig, false, 9);
        rig.run_ms(300);
        let times: Vec<u8> = rig
            .node_messages(|message| match message {
                Message::Button(Button { button: 1, tenths }) => Some(tenths),
                _ => None,
            })
            .into_iter()
            .map(|(_, tenths)| tenths)
            .collect();
        assert!(times.iter().copied().eq(1..=times.len() as u8), "{times:?}");
        assert_eq!(times.iter().filter(|&&tenths| tenths == 10).count(), toggles, "{times:?}");
    }
}

#[test]
fn a_spike_on_the_button_s_wire_is_no_press() {
    let mut rig = PROGRAM.running();
    for _ in 0..20 {
        rig.board().press_button(true);
        rig.run_ms(5);
        rig.board().press_button(false);
        rig.run_ms(30);
    }
    assert_eq!(presses(&rig), Vec::<f32>::new());
}

#[test]
fn a_button_held_at_the_start_counts_at_most_one_press_and_works_later() {
    let mut rig = PROGRAM.powered();
    rig.board().press_button(true);
    rig.run_ms(500);
    rig.board().press_button(false);
    rig.run_ms(200);
    assert!(presses(&rig).len() <= 1);
    rig.board().press_button(true);
    rig.run_ms(200);
    assert!(!presses(&rig).is_empty());
}

// ---- light ----

fn light(rig: &mut Rig, commands: &[(u8, u8, u8, u8)]) -> f64 {
    let command = |&(light, red, green, blue)| LightCommand { light, red, green, blue };
    rig.broadcast(&Message::LightsCommand(commands.iter().map(command).collect()), 0);
    rig.run_ms(20);
    rig.board().light()
}

#[test]
fn the_light_is_off_until_the_first_command() {
    let mut rig = PROGRAM.powered();
    rig.run_ms(500);
    assert_eq!(rig.board().light(), 0.0);
}

#[test]
fn a_lights_command_dims_the_light() {
    let mut rig = PROGRAM.running();
    assert_eq!(light(&mut rig, &[(0, 31, 63, 31)]), 1.0);
    assert_eq!(light(&mut rig, &[(0, 0, 0, 0)]), 0.0);
    let red: Vec<f64> = (0..=31).map(|red| light(&mut rig, &[(0, red, 0, 0)])).collect();
    assert!(red.windows(2).all(|pair| pair[0] < pair[1]), "{red:?}");
    assert!((red[16] - 0.52).abs() < 0.06, "about half: {}", red[16]);
    // The light has one colour, which stands for all three.
    for command in [(0, 31, 0, 0), (0, 0, 63, 0), (0, 0, 0, 31)] {
        assert_eq!(light(&mut rig, &[command]), 1.0, "{command:?}");
    }
}

#[test]
fn the_light_follows_only_commands_for_its_id() {
    let mut rig = PROGRAM.running();
    assert_eq!(light(&mut rig, &[(1, 31, 63, 31), (255, 31, 63, 31)]), 0.0);
    let half = light(&mut rig, &[(1, 31, 63, 31), (0, 16, 32, 16), (2, 31, 63, 31)]);
    assert!((0.4..0.6).contains(&half), "{half}");
    rig.set("LIGHT_ID", 255);
    assert_eq!(light(&mut rig, &[(0, 0, 0, 0)]), half, "the light must not follow the old ID");
    let all: Vec<_> = (236..=255).map(|id| (id, if id == 255 { 31 } else { 0 }, 0, 0)).collect();
    assert!(light(&mut rig, &all) > half, "the light must find its command among twenty");
}

#[test]
fn an_invalid_transfer_does_not_change_the_light() {
    let mut rig = PROGRAM.running();
    let half = light(&mut rig, &[(0, 16, 32, 16)]);
    rig.send(0x1804_390A, &[0, 0xFF, 0xC0]);
    rig.send(0x1804_390A, &[0x12, 0x34, 0, 0xFF, 0xFF, 1, 0xFF, 0x80]);
    rig.send(0x1804_390A, &[0xFF, 2, 0xFF, 0xFF, 0x60]);
    rig.send(0x1804_390A, &[0xC0]);
    rig.run_ms(50);
    assert_eq!(rig.board().light(), half);
    // The light must not disturb the servo's pulses, nor the servo the light.
    rig.send_command(1, 4, 1321.0);
    rig.run_ms(50);
    rig.forget();
    for n in 0..40 {
        light(&mut rig, &[(0, n % 32, 0, 0)]);
    }
    assert!(rig.pulses.iter().all(|pulse| pulse.width_us() == 1321.0));
    assert!(rig.pulses.iter().all(|pulse| pulse.period_cycles.unwrap_or(20 * MS) == 20 * MS));
}
