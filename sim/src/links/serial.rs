//! The Arduino's USB serial port on a pseudo-terminal: what avrdude, ravedude and terminal programs talk to.
//!
//! The real port's DTR line pulses RESET when a program opens it and no other has it open. A pseudo-terminal has no DTR, so
//! such an opening itself resets the board. Bytes pass at the pace of the board's USART, both ways.
//!
//! Limits: the baud rate that a program sets is not looked at, as if it always matched. While nobody has the port open,
//! what the board says is lost, as on the real port. Bytes that the board does not take for a tenth of a second, because
//! its receiver is off, are dropped. Of a program that closes the port less than a millisecond before the next one opens it,
//! the last bytes go to the board after the reset, because it is unknown which program they are for.

use super::Link;
use super::pty::{Hold, Pty};
use anyhow::{Context, Result};
use bench::Bench;
use bench::avr::ResetCause;
use bench::{Cycles, F_CPU_HZ};
use std::collections::VecDeque;
use std::path::Path;

/// Bytes that wait for a client that does not read; more than a second of the monitor's output at its fastest.
const TO_CLIENT_MAX: usize = 16 * 1024;
/// Bytes taken from the client ahead of the board, beyond what the kernel holds: what a USB adapter's buffer has.
const TO_BOARD_MAX: usize = 128;
const BOARD_TIMEOUT: Cycles = F_CPU_HZ / 10;

/// See the module.
pub struct SerialPort {
    pty: Pty,
    board: usize,
    attached: bool,
    openings: u64,
    to_client: VecDeque<u8>,
    lost: u64,
    /// Bytes waiting for the board when last looked at, and when there were fewer than before.
    waiting: usize,
    moved_at: Cycles,
}

impl SerialPort {
    /// Makes the port of that board, at `path`.
    ///
    /// # Errors
    /// If `path` cannot be had; the message says what to do.
    pub fn open(path: &Path, board: usize) -> Result<SerialPort> {
        Ok(SerialPort {
            pty: Pty::open(path, Hold::Released).context("--serial")?,
            board,
            attached: false,
            openings: 0,
            to_client: VecDeque::new(),
            lost: 0,
            waiting: 0,
            moved_at: 0,
        })
    }

    fn opened(&mut self, times: u64, bench: &mut Bench) {
        self.openings += times;
        self.to_client.clear();
        let board = bench.board(self.board);
        // What the last client wrote must not be taken for the first words of this one.
        board.avr_mut().serial_discard();
        board.reset(ResetCause::External);
    }

    /// Gives the board what the client wrote, as fast as it takes it.
    fn feed(&mut self, bench: &mut Bench) {
        let now = bench.now();
        let avr = bench.board(self.board).avr_mut();
        let waiting = avr.serial_unsent();
        if waiting < self.waiting || waiting == 0 {
            self.moved_at = now;
        } else if now - self.moved_at > BOARD_TIMEOUT {
            avr.serial_discard();
            self.lost += waiting as u64;
            self.moved_at = now;
        }
        if avr.serial_unsent() < TO_BOARD_MAX {
            avr.serial_send(&self.pty.read());
        }
        self.waiting = avr.serial_unsent();
    }
}

impl Link for SerialPort {
    fn serve(&mut self, bench: &mut Bench) -> Result<()> {
        let visits = self.pty.visits();
        let was_attached = std::mem::replace(&mut self.attached, visits.present);
        if visits.begun > 0 {
            if was_attached {
                // One closed it and the next opened it since the last look.
                self.pty.discard_unread();
            }
            self.opened(visits.begun, bench);
        }
        if !self.attached {
            if was_attached || visits.begun > 0 {
                // The last words of the client, such as `echo` leaves them.
                self.feed(bench);
                self.pty.renew();
                self.to_client.clear();
            }
            return Ok(());
        }
        self.feed(bench);
        while !self.to_client.is_empty() {
            let taken = self.pty.write(self.to_client.make_contiguous());
            self.to_client.drain(..taken);
            if taken == 0 {
                break;
            }
        }
        Ok(())
    }

    fn serial_output(&mut self, board: usize, bytes: &[(Cycles, u8)]) {
        if !self.attached || board != self.board {
            return;
        }
        self.to_client.extend(bytes.iter().map(|(_, byte)| byte));
        let excess = self.to_client.len().saturating_sub(TO_CLIENT_MAX);
        self.to_client.drain(..excess);
        self.lost += excess as u64;
    }

    fn status(&self) -> String {
        let state = if self.attached { "in use" } else { "free" };
        let path = self.pty.path().display();
        format!("serial {path}: {state}, opened {} times, {} bytes lost", self.openings, self.lost)
    }

    fn needs_real_time(&self) -> bool {
        true
    }
}
