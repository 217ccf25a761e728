//! Moves the new output of the bench into the state, the script and the links.

use super::{ERASED, FLASH_PERIOD, Scene};
use crate::links::Link;
use crate::pins::Watched;
use crate::ui::findings::Said;
use crate::ui::state::{AutopilotState, Controller, Event};
use anyhow::Result;
use bench::autopilot::Moves;
use bench::findings;
use bench::mcp2515::{Fate, LoggedFrame};

impl Scene {
    /// Moves all new output of the bench into the state, the script and the links.
    pub(super) fn collect(&mut self) -> Result<()> {
        self.state.advance_to(self.bench.now());
        self.collect_from_board();
        self.collect_from_others();
        self.collect_from_chip();
        self.collect_from_bus()?;
        self.update_autopilot();
        Ok(())
    }

    fn collect_from_board(&mut self) {
        let now = self.state.now;
        let board = self.bench.board(self.node);
        let serial = board.avr_mut().serial_take();
        let rate = board.avr().serial_sent_rate();
        for (at, byte) in &serial {
            self.state.push_serial_byte(*at, *byte);
        }
        for said in self.findings.check(board, self.state.bus.bit_rate, !serial.is_empty()) {
            match said {
                Said::Hint(_) if self.is_chip_disturbed => {}
                Said::Hint(text) => self.state.add_hint(now, text),
                Said::Note(text) => self.state.report(now, Event::Board(text)),
            }
        }
        self.state.spi = board.spi_use();
        for link in &mut self.links {
            link.serial_output(self.node, &serial, rate);
        }
        let pulses = board.take_servo_pulses().into_iter();
        let has_servo = !self.findings.is_chip_select(board.wiring().servo);
        for pulse in pulses.filter(|_| has_servo) {
            self.state.add_pulse(pulse.start, pulse.width_cycles, pulse.period_cycles);
        }
        let outputs = board.take_output_pulses().into_iter();
        self.state.set_output_pulses(
            outputs.map(|pulses| pulses.last().map(|pulse| (pulse.start, pulse.width_cycles))),
        );
        self.state.set_light(now, board.light());
        for watched in &mut self.watched {
            for (at, text) in watched.take(now) {
                self.state.report(at, Event::Pin(text));
            }
        }
        for (at, text) in self.i2c.take_transactions() {
            self.state.report(at, Event::I2c(text));
        }
        let missing = self.i2c.missing(now).into_iter();
        missing.for_each(|address| self.state.add_hint(now, nobody_at(address)));
        self.state.i2c = self.i2c.written();
        self.state.pins = self.watched.iter().map(Watched::text).collect();
        for violation in board.take_violations() {
            if self.is_chip_disturbed {
                let text = format!("after a fault of the chip: {violation}");
                self.state.report(violation.at, Event::Fault(text));
            } else {
                self.state.add_mistake(violation.at, violation.to_string());
            }
        }
        let unmodelled = board.avr().unmodelled_after(self.unmodelled_seen);
        self.unmodelled_seen += unmodelled.len();
        for feature in unmodelled {
            self.state.add_unmodelled(feature.at, feature.text);
        }
        if let Some(address) = board.avr().erased_flash_entered() {
            let text = format!(
                "the processor ran into erased flash at {address:#06x}: no program is there. What \
                 it does until its next reset is not reported"
            );
            self.state.add_hint(now, text);
        }
        let jumps = board.avr().jumps_after(self.jumps_seen);
        self.jumps_seen += jumps.len();
        for at in jumps {
            self.state.add_jump(at, findings::after_overrun(board.avr()));
        }
        let resets = board.avr().resets_after(self.resets_seen);
        self.resets_seen += resets.len();
        for reset in resets {
            self.state.add_reset(reset.at, format!("{:?}", reset.cause));
        }
        if let Some(text) = findings::crash(board.avr()) {
            self.state.set_crash(now, text);
        }
        self.state.memory.stack = board.avr().deepest_stack().map(u32::from);
        if now < self.next_flash_at {
            return;
        }
        self.next_flash_at = now + FLASH_PERIOD;
        if let Some(end) = self.application_end {
            let programmed = board.avr().flash()[..end].iter().rposition(|byte| *byte != ERASED);
            self.state.memory.flash = programmed.map_or(0, |last| last as u32 + 1);
        }
    }

    /// Reports the mistakes and crashes of the further boards, and drops their other output, which
    /// would pile up.
    fn collect_from_others(&mut self) {
        let now = self.state.now;
        for (index, number) in self.others.iter().enumerate() {
            let name = format!("node{}", index + 2);
            let board = self.bench.board(*number);
            let serial = board.avr_mut().serial_take();
            for link in &mut self.links {
                link.serial_output(*number, &serial, board.avr().serial_sent_rate());
            }
            board.take_servo_pulses();
            board.take_output_pulses();
            board.chip().borrow_mut().take_frame_log();
            for violation in board.take_violations() {
                self.state.add_mistake(violation.at, format!("{name}: {violation}"));
            }
            if let Some(text) = findings::crash(board.avr()) {
                self.state.set_crash(now, format!("{name}: {text}"));
            }
        }
    }

    fn collect_from_chip(&mut self) {
        let now = self.state.now;
        let chip = self.bench.board(self.node).chip();
        let mut chip = chip.borrow_mut();
        for entry in chip.take_frame_log() {
            self.state.frames_for_node += 1;
            match entry.fate {
                Fate::Cleared(at) => self.state.add_latency(at - entry.received_at),
                Fate::Lost => {
                    self.state.add_lost_frame(entry.received_at, entry.frame, lost_by(&entry));
                    let hint = findings::unwritten_filters(&chip, &entry);
                    hint.into_iter().for_each(|hint| self.state.add_hint(now, hint));
                }
            }
        }
        self.state.set_controller(Controller {
            mode: format!("{:?}", chip.mode()),
            tec: chip.tec(),
            rec: chip.rec(),
            error_state: chip.error_state(),
            overflows: u64::from(chip.rx_overflows()),
        });
    }

    fn collect_from_bus(&mut self) -> Result<()> {
        for (record, from) in self.bench.take_records() {
            let (port, station) = from.unzip();
            let station = station.as_deref();
            self.state.add_record(&record, port == Some(self.node_port), station);
            if let Some(script) = &mut self.script {
                script.record(&record, station)?;
            }
            for link in &mut self.links {
                link.record(&record, station)?;
            }
        }
        // Without this the babbler's queue of received frames would grow without bound.
        self.injector.babbler().borrow_mut().take_received();
        Ok(())
    }

    pub(super) fn update_autopilot(&mut self) {
        let now = self.state.now;
        if let Some((autopilot, _)) = &mut self.autopilot {
            for (at, text) in autopilot.take_events() {
                self.state.report(at, Event::Node(text));
            }
        }
        self.state.autopilot = self.autopilot.as_ref().map(|(autopilot, _)| AutopilotState {
            node_id: autopilot.settings().node_id.get(),
            deflection: autopilot.deflection(now),
            moves_all: autopilot.settings().moves == Moves::All,
            motors: autopilot.settings().motors,
            is_sweeping: autopilot.is_sweeping(),
            is_silent: autopilot.is_silent(),
            is_armed: autopilot.is_armed(),
            dialect: autopilot.settings().dialect,
            profile: autopilot.settings().profile.to_string(),
            command_type: autopilot.settings().command_type.to_string(),
            commands_sent: autopilot.commands_sent(),
        });
    }
}

fn nobody_at(address: u8) -> String {
    format!(
        "nobody acknowledges {address:#04X} on the two-wire bus: --i2c {address:#04X} puts a \
         device there"
    )
}

/// Why the MCP2515 lost a frame.
fn lost_by(lost: &LoggedFrame) -> &'static str {
    match (lost.buffer, lost.other_is_full) {
        (_, true) => "both receive buffers were full",
        (0, false) => "RXB0 was full, and its bit BUKT lets nothing go on to RXB1, which was empty",
        _ => "RXB1 was full, and no filter of RXB0, which was empty, passes the frame",
    }
}
