//! The serial monitor over the bus (feature `tunnel`): tunnel.Targetted, as ArduPilot's nodes and
//! the DroneCAN GUI Tool use it.

use bench::F_CPU_HZ;
use bench::dronecan::{CanId, Transfer, TunnelTargetted};
use rig::{NODE, Program, Rig};

const PROGRAM: Program = Program::With("tunnel");

/// tunnel.Targetted of node 126, priority 16.
const TARGETTED: u32 = 0x100B_B97E;
const ASKER: u8 = 126;

/// Sends the node a Targetted with these characters and this transfer ID, which asks it for its
/// output.
fn ask(rig: &mut Rig, target: u8, characters: &[u8], transfer_id: u8) {
    let header = [2, target << 1 | 1, 0xF0, 0, 0xC2, 1];
    let tail = [0xC0 | transfer_id];
    rig.send(TARGETTED, &[&header, characters, &tail].concat());
}

/// The node's Targetted messages.
fn messages(rig: &Rig) -> impl Iterator<Item = &Transfer> {
    let transfers = rig.transfers.iter().map(|(_, transfer)| transfer);
    transfers.filter(|transfer| {
        matches!(
            transfer.id,
            CanId::Message { type_id: 3001, source, .. } if u32::from(source.get()) == NODE
        )
    })
}

/// The text that the node has sent to the requesting node.
fn tunnel_text(rig: &Rig) -> String {
    let buffers = messages(rig).flat_map(|transfer| {
        let message = TunnelTargetted::decode(&transfer.payload).expect("a Targetted");
        assert_eq!((message.target.get(), message.protocol, message.serial_port), (ASKER, 2, 0));
        message.buffer
    });
    buffers.map(char::from).collect()
}

#[test]
fn a_node_that_asks_receives_the_output_of_the_serial_monitor() {
    let mut rig = PROGRAM.running();
    rig.run_ms(500);
    assert_eq!(tunnel_text(&rig), "", "the node must send nothing before a request");
    rig.serial.clear();
    ask(&mut rig, NODE as u8, b"", 0);
    rig.run_ms(2500);
    let tunnel_text = tunnel_text(&rig);
    assert!(
        tunnel_text.contains("rx Targetted from 126 tid 0")
            && tunnel_text.contains("temperature +20.0 C"),
        "{tunnel_text}"
    );
    // The same text as on the serial port, except for incomplete lines at the beginning and at the
    // end.
    assert!(
        rig.serial.contains(tunnel_text.trim_end_matches(|c| c != '\n')),
        "{tunnel_text}\nis not in\n{}",
        rig.serial
    );
}

#[test]
fn a_question_mark_over_the_tunnel_prints_the_counters() {
    let mut rig = PROGRAM.running();
    ask(&mut rig, NODE as u8, b"?", 0);
    rig.run_ms(500);
    let tunnel_text = tunnel_text(&rig);
    assert!(tunnel_text.contains("refused"), "{tunnel_text}");
}

#[test]
fn the_tunnel_closes_three_seconds_after_the_last_request() {
    let mut rig = PROGRAM.running();
    for transfer_id in 0..4 {
        ask(&mut rig, NODE as u8, b"", transfer_id);
        rig.run_ms(1000);
    }
    rig.run_ms(2500);
    rig.forget();
    rig.run_ms(3000);
    assert_eq!(tunnel_text(&rig), "");
}

#[test]
fn a_message_for_another_node_does_not_open_the_tunnel() {
    let mut rig = PROGRAM.running();
    ask(&mut rig, NODE as u8 + 1, b"?", 0);
    rig.run_ms(1500);
    assert_eq!(tunnel_text(&rig), "");
}

#[test]
fn while_the_tunnel_is_open_commands_are_followed_and_the_bus_is_not_flooded() {
    let mut rig = PROGRAM.running();
    ask(&mut rig, NODE as u8, b"", 0);
    let start = rig.now();
    for n in 0..200 {
        rig.send_command(1, 4, if n % 2 == 0 { 1200.0 } else { 1800.0 });
        rig.run_ms(10);
    }
    let count = messages(&rig).count();
    let seconds = (rig.now() - start) as f64 / F_CPU_HZ as f64;
    assert!(tunnel_text(&rig).contains("pulse 1800.0 us"));
    assert!((count as f64) < 101.0 * seconds, "{count} transfers in {seconds} s");
    assert_eq!(rig.settled_pulse_us(), 1800.0);
}
