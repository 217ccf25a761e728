//! Timing of the shipped ELF in cycles of its AVR, and the speed of the simulator. Prints docs/benchmarks.md and writes it.
//!
//! The main loop resets the watchdog once a turn, so the time between two WDR instructions is a turn. The controller's model
//! logs when each accepted frame was complete and when its RXnIF was cleared.

#[path = "../tests/rig/mod.rs"]
mod rig;

use std::fmt::Write as _;
use std::time::Instant;

use rig::{MS, Rig};
use sim::Cycles;
use sim::mcp2515::Fate;

/// What the bus is full of while the node is measured.
struct Load {
    name: &'static str,
    feed: fn(&mut Rig, u32),
}

const LOADS: [Load; 5] = [
    Load { name: "nothing but its own messages", feed: |_, _| {} },
    Load {
        name: "an autopilot: commands at 50 Hz, status at 1 Hz",
        feed: |rig, ms| {
            if ms % 20 == 0 {
                rig.send_command(1, 0, 0.3);
            }
            if ms % 1000 == 7 {
                rig.send_status_from(1);
            }
        },
    },
    Load {
        name: "commands at 400 Hz, ten statuses a second",
        feed: |rig, ms| {
            if ms % 5 < 2 {
                rig.send_command(1, 4, 1500.0);
            }
            if ms % 100 == 7 {
                rig.send_status_from(1);
            }
        },
    },
    Load {
        name: "commands back to back (8,500 a second)",
        feed: |rig, _| {
            while rig.peer.borrow().queued() < 12 {
                rig.send_command(1, 0, -0.7);
            }
        },
    },
    Load {
        name: "a bus full of messages for others",
        feed: |rig, _| {
            while rig.peer.borrow().queued() < 10 {
                rig.send(0x1804_562A, &[0xA5; 8]);
            }
        },
    },
];

/// What was measured under a load, in cycles.
#[derive(Default)]
struct Turns {
    worst: Cycles,
    sum: Cycles,
    count: u64,
    frames: u64,
    served_worst: Cycles,
    served_sum: Cycles,
    lost: u32,
}

/// The watchdog reset in the main loop: the last WDR (0x95A8) of the program.
fn loop_head(rig: &mut Rig) -> u32 {
    let flash = rig.board().avr().flash();
    (0x68..0x3800).step_by(2).rfind(|&at| flash[at..at + 2] == [0xA8, 0x95]).expect("a main loop") as u32
}

fn measure(load: &Load, duration_ms: u32) -> Turns {
    let mut rig = Rig::running();
    rig.overflows_expected = true;
    let head = loop_head(&mut rig);
    rig.board().chip().borrow_mut().take_frame_log();
    let mut turns = Turns::default();
    let mut last = None;
    for ms in 0..duration_ms {
        (load.feed)(&mut rig, ms);
        let end = rig.now() + MS;
        while rig.now() < end {
            // One cycle at a time stops at each instruction.
            let next = rig.now() + 1;
            rig.bench.run_until(next);
            let avr = rig.bench.board(0).avr();
            if avr.pc() == head && last.is_none_or(|last| avr.now() > last + 2) {
                if let Some(last) = last {
                    turns.worst = turns.worst.max(avr.now() - last);
                    turns.sum += avr.now() - last;
                    turns.count += 1;
                }
                last = Some(avr.now());
            }
        }
        rig.peer.borrow_mut().take_received();
        rig.bench.bus().take_records();
        rig.board().avr_mut().serial_take();
    }
    let chip = rig.board().chip();
    for entry in chip.borrow_mut().take_frame_log() {
        if let Fate::Cleared(at) = entry.fate {
            turns.frames += 1;
            turns.served_worst = turns.served_worst.max(at - entry.received_at);
            turns.served_sum += at - entry.received_at;
        }
    }
    turns.lost = chip.borrow().rx_overflows();
    turns
}

fn us(cycles: Cycles) -> f64 {
    cycles as f64 / 16.0
}

/// Simulated seconds a second, with an autopilot at work.
fn speed() -> f64 {
    let mut rig = Rig::running();
    let started = Instant::now();
    for ms in 0..5000 {
        (LOADS[1].feed)(&mut rig, ms);
        rig.run_ms(1);
    }
    5.0 / started.elapsed().as_secs_f64()
}

fn main() {
    // Cargo asks bench targets for their tests, too.
    if std::env::args().any(|argument| argument == "--list") {
        return;
    }
    let mut page = String::from(
        "# Benchmarks\n\n\
         Measured by `make bench`, which writes this page: the shipped ELF in the simulator, in cycles of the 16 MHz AVR (16 cycles are\n\
         a microsecond). A turn is one round of the main loop. *Served* is the time from the end of a frame (RXnIF set) until the\n\
         driver has taken it out of the controller (RXnIF cleared).\n\n\
         | on the bus | worst turn | mean turn | frames | served, worst | served, mean | lost |\n\
         | --- | ---: | ---: | ---: | ---: | ---: | ---: |\n",
    );
    for load in &LOADS {
        let turns = measure(load, 3000);
        let _ = writeln!(
            page,
            "| {} | {} cycles, {:.0} us | {} cycles | {} | {:.0} us | {:.0} us | {} |",
            load.name,
            turns.worst,
            us(turns.worst),
            turns.sum / turns.count.max(1),
            turns.frames,
            us(turns.served_worst),
            us(turns.served_sum) / turns.frames.max(1) as f64,
            turns.lost,
        );
    }
    let _ = writeln!(
        page,
        "\nThe limit for a turn is 250 us, because the controller holds two frames and a full one lasts 131 us or more at 1 Mbit/s.\n\n\
         The simulator runs this board with an autopilot at {:.1} times real time on one core of the machine that this was measured on.",
        speed()
    );
    print!("{page}");
    std::fs::write(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/benchmarks.md"), page)
        .expect("docs/benchmarks.md can be written");
}
