//! The Arduino's USB serial port on a pseudo-terminal, for avrdude, ravedude and terminal programs.
//!
//! The DTR line of the real port pulses RESET when a program opens the port and no other program
//! has it open. A pseudo-terminal has no DTR, so that opening resets the board here. Bytes pass at
//! the rate of the board's USART.
//!
//! Limits: the port ignores the baud rate that a program sets, as if it always matched. While no
//! program has the port open, the board's output is lost, as on the real port. If the board does
//! not take a byte for a tenth of a second, because its receiver is off, the port drops the bytes
//! that wait. If a program closes the port less than a millisecond before another opens it, the
//! last bytes of the first reach the board after the reset, because the port cannot know who wrote
//! them.

use super::Link;
use super::pty::{Hold, Pty};
use anyhow::{Context, Result};
use bench::Bench;
use bench::avr::ResetCause;
use bench::{Cycles, F_CPU_HZ};
use std::collections::VecDeque;
use std::path::Path;

/// Most bytes that wait for a client that does not read: more than a second of output at 115,200
/// baud.
const TO_CLIENT_MAX: usize = 16 * 1024;
/// Bytes that wait for the board beside those in the kernel: the size of a USB adapter's buffer.
const TO_BOARD_MAX: usize = 128;
/// Bytes that the board has not taken for this long are dropped.
const BOARD_TIMEOUT: Cycles = F_CPU_HZ / 10;

/// The USB serial port of a board.
pub struct SerialPort {
    pty: Pty,
    board: usize,
    attached: bool,
    openings: u64,
    to_client: VecDeque<u8>,
    lost: u64,
    /// Bytes that waited for the board at the end of the last turn.
    waiting: usize,
    /// Last time at which the board had taken a byte, or none waited.
    moved_at: Cycles,
}

impl SerialPort {
    /// Creates the port of the board with number `board`, at `path`.
    ///
    /// # Errors
    /// If `path` is in use or cannot be created; the message says what to do.
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

    fn reset_board(&mut self, bench: &mut Bench) {
        self.to_client.clear();
        let board = bench.board(self.board);
        // The board must not take the last client's bytes for bytes of this one.
        board.avr_mut().serial_discard();
        board.reset(ResetCause::External);
    }

    /// Sends the client's bytes to the board, as fast as the board takes them.
    fn send_to_board(&mut self, bench: &mut Bench) {
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
        let openings = self.pty.take_openings();
        let was_attached = std::mem::replace(&mut self.attached, openings.is_open);
        if openings.count > 0 {
            if was_attached {
                // Since the last turn one client closed the port and another opened it.
                self.pty.discard_unread();
            }
            self.openings += openings.count;
            self.reset_board(bench);
        }
        if !self.attached {
            if was_attached || openings.count > 0 {
                // The client's last bytes: `echo`, for example, writes and closes at once.
                self.send_to_board(bench);
                self.pty.renew();
                self.to_client.clear();
            }
            return Ok(());
        }
        self.send_to_board(bench);
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
