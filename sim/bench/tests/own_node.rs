//! The nodes of crates/own-node/boards, each on a model of its CAN controller, and an ArduPilot.

use std::f64::consts::TAU;
use std::fmt::Debug;

use bench::autopilot::{Autopilot, Profile, Settings};
use can_model::RecordKind;
use embedded_can::nb::Can;
use own_node::{Action, Node};

#[path = "../../../crates/own-node/tests/models/mod.rs"]
mod models;
#[path = "../../../crates/own-node/boards/rp2040/src/can.rs"]
mod rp2040;

use models::{BIT_RATE, Controller, MS, Memory, Wires, World};

/// Each 20 ms ArduPilot commands 15 actuators in nine frames.
const PERIOD: u64 = 20 * MS;
const COMMANDS: u64 = 150;

/// Asserts that the node follows each command, that no frame is lost, and that the autopilot knows
/// the node's name.
#[track_caller]
fn assert_follows_ardupilot<C: Can<Error: Debug>>(world: &World, can: C) {
    // The autopilot starts when the node is ready.
    let settings = Settings::of(Profile::Ardupilot);
    let sweep = settings.sweep_period as f64;
    let mut autopilot = Autopilot::powered(settings, BIT_RATE, PERIOD);
    world.attach("autopilot", autopilot.station());
    let mut node = Node::new(can, Memory::default(), *b"0123456789ABCDEF");
    let (mut moves, mut planned) = (vec![], PERIOD);
    while autopilot.commands_sent() < COMMANDS || world.now() < planned + PERIOD / 2 {
        if world.now() >= planned && autopilot.commands_sent() < COMMANDS {
            planned += MS;
            autopilot.advance(planned);
        }
        match node.turn(world.now_ms(), 300 * 32).expect("no frame is lost") {
            Some(Action::Move(thousandths)) => moves.push(thousandths),
            Some(Action::Restart) => panic!("a restart that nobody asked for"),
            None => {}
        }
        world.run(MS / 20);
    }
    assert_eq!(moves.len() as u64, COMMANDS);
    for (number, thousandths) in moves.into_iter().enumerate() {
        // The first command is due after 5 ms.
        let time = (5 * MS + PERIOD * number as u64) as f64;
        let expected = 1000.0 * (TAU * time / sweep).sin();
        assert!((f64::from(thousandths) - expected).abs() < 2.0, "{number}: {thousandths}");
    }
    let events = autopilot.take_events();
    assert!(events.iter().any(|(_, text)| text.contains("org.example.own-node")), "{events:?}");
    let records = world.take_records();
    assert!(!records.iter().any(|record| matches!(record.kind, RecordKind::ErrorFrame { .. })));
}

#[test]
fn the_node_of_the_rp2040_follows_ardupilot() {
    let world = World::new();
    let (wires, _) = Wires::new(&world);
    // The crystal of the chip starts.
    world.run(MS);
    let clock = world.clone();
    let driver = rp2040::driver(wires.clone(), wires.clone(), move || clock.now_ms() as u16);
    assert_follows_ardupilot(&world, driver);
    let violations = wires.take_violations();
    assert!(violations.is_empty(), "driver mistakes: {violations:#?}");
}

#[test]
fn the_node_of_the_stm32f103_follows_ardupilot() {
    let world = World::new();
    let (controller, _) = Controller::new(&world);
    assert_follows_ardupilot(&world, controller);
}
