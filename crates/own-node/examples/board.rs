//! The node of a board on a model of its CAN controller, with a bus of this PC:
//! `cargo run -p own-node --example board -- rp2040 mcast:0`, or `stm32f103`.
//!
//! The bus between them is simulated bit by bit, in real time.

use std::cell::RefCell;
use std::fmt::Debug;
use std::rc::Rc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use can_model::SoftNode;
use dronecan_host::link::Bus;
use embedded_can::nb::Can;
use own_node::{Action, Node};

#[path = "../tests/models/mod.rs"]
mod models;
#[path = "../boards/rp2040/src/can.rs"]
mod rp2040;

use models::{BIT_RATE, Controller, MS, Memory, Wires, World};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let board = arguments.next().context("which board? rp2040 or stm32f103")?;
    let bus = arguments.next().context("which bus? For example mcast:0")?;
    let mut link = Bus::new(bus.parse().map_err(anyhow::Error::msg)?, BIT_RATE, None);
    link.open(Duration::ZERO)?;
    println!("{board} on {bus}");
    let world = World::new();
    match board.as_str() {
        "rp2040" => {
            let (wires, _) = Wires::new(&world);
            // The crystal of the chip starts.
            world.run(MS);
            let clock = world.clone();
            let now_ms = move || clock.now_ms() as u16;
            run(&world, link, rp2040::driver(wires.clone(), wires, now_ms))
        }
        "stm32f103" => run(&world, link, Controller::new(&world).0),
        other => bail!("no board {other}: rp2040 or stm32f103"),
    }
}

fn run<C: Can<Error: Debug>>(world: &World, mut link: Bus, can: C) -> Result<()> {
    let peers = Rc::new(RefCell::new(SoftNode::new(BIT_RATE)));
    world.attach("PC", peers.clone());
    let mut node = Node::new(can, Memory::default(), *b"own-node, models");
    let start = Instant::now();
    loop {
        let elapsed = start.elapsed();
        while u128::from(world.now()) < elapsed.as_micros() * u128::from(MS) / 1000 {
            match node.turn(world.now_ms(), 300 * 32) {
                Ok(Some(Action::Move(thousandths))) => {
                    println!("move to {thousandths} thousandths")
                }
                Ok(Some(Action::Restart)) => println!("restart"),
                Ok(None) => {}
                Err(error) => println!("{error:?}"),
            }
            world.run(MS / 20);
        }
        let received = peers.borrow_mut().take_received();
        received.into_iter().for_each(|(_, frame)| link.send(elapsed, frame));
        link.serve(elapsed).into_iter().for_each(|frame| peers.borrow_mut().send(frame));
        std::thread::sleep(Duration::from_millis(1));
    }
}
