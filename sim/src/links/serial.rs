//! The Arduino's USB serial port on a pseudo-terminal, for avrdude, ravedude and terminal programs.
//!
//! The DTR line of the real port pulses RESET when a program opens the port and no other program
//! has it open. A pseudo-terminal has no DTR, so that opening resets the board here. Bytes pass at
//! the rate of the board's USART; if the client has set one that is more than 4 % away, both sides
//! read garbage, as on the wire.
//!
//! A bootloader gives a client a second for its next command. While the bootloader polls its UART
//! for it, simulated time passes more slowly.
//!
//! Limits: while no program has the port open, the board's output is lost, as on the real port. If
//! the board does not take a byte for a tenth of a second, because its receiver is off, the port
//! drops the bytes that wait. If a program closes the port less than a millisecond before another
//! opens it, the last bytes of the first reach the board after the reset, because the port cannot
//! know who wrote them.

use super::Link;
use super::pty::{FIRST_BAUD, Pty};
use anyhow::{Context, Result};
use bench::Bench;
use bench::avr::{ResetCause, byte_read_at, rates_match};
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

/// A bootloader that waits for a command polls its UART more often than this.
const POLL_PERIOD: Cycles = F_CPU_HZ / 1000;
/// So many bytes of garbage, and none that was read, are a wrong baud rate.
const GARBAGE_MIN: usize = 8;

/// The USB serial port of a board.
pub struct SerialPort {
    pty: Pty,
    board: usize,
    attached: bool,
    openings: u64,
    to_client: VecDeque<u8>,
    lost: u64,
    /// First byte of the board's bootloader.
    boot_section: Option<usize>,
    /// True while the bootloader waits for a client that has sent something.
    gives_time: bool,
    ignores_baud: bool,
    traffic: Traffic,
    hint: Option<String>,
    /// True if the user knows of a wrong baud rate.
    has_warned: bool,
    /// Bytes that waited for the board at the end of the last turn.
    waiting: usize,
    /// Last time at which the board had taken a byte, or none waited.
    moved_at: Cycles,
}

/// Bytes since the client opened the port.
#[derive(Clone, Copy, Debug, Default)]
struct Traffic {
    from_client: usize,
    /// In both directions, and understood by the receiver.
    read: usize,
    garbage: usize,
}

impl SerialPort {
    /// Creates the port of the board with number `board`, at `path`. The board's bootloader begins
    /// at byte `boot_section` of the flash.
    ///
    /// # Errors
    /// If `path` is in use or cannot be created; the message says what to do.
    pub fn open(
        path: &Path,
        board: usize,
        boot_section: Option<usize>,
        ignores_baud: bool,
    ) -> Result<SerialPort> {
        Ok(SerialPort {
            pty: Pty::open(path).context("--serial")?,
            board,
            attached: false,
            openings: 0,
            to_client: VecDeque::new(),
            lost: 0,
            boot_section,
            gives_time: false,
            ignores_baud,
            traffic: Traffic::default(),
            hint: None,
            has_warned: false,
            waiting: 0,
            moved_at: 0,
        })
    }

    fn reset_board(&mut self, bench: &mut Bench) {
        self.to_client.clear();
        self.traffic = Traffic::default();
        let board = bench.board(self.board);
        // The board must not take the last client's bytes for bytes of this one.
        board.avr_mut().serial_discard();
        board.reset(ResetCause::External);
    }

    /// Sends the client's bytes to the board, as fast as the board takes them.
    fn send_to_board(&mut self, bench: &mut Bench) {
        let now = bench.now();
        let avr = bench.board(self.board).avr_mut();
        let rate = self.client_rate();
        avr.set_serial_line_rate(rate);
        let waiting = avr.serial_unsent();
        if waiting < self.waiting || waiting == 0 {
            self.moved_at = now;
        } else if now - self.moved_at > BOARD_TIMEOUT {
            avr.serial_discard();
            self.lost += waiting as u64;
            self.moved_at = now;
        }
        if avr.serial_unsent() < TO_BOARD_MAX {
            let bytes = self.pty.read();
            avr.serial_send(&bytes);
            self.traffic.from_client += bytes.len();
            self.count(bytes.len(), rate, avr.serial_bits_per_second());
        }
        self.waiting = avr.serial_unsent();
        self.gives_time = self.traffic.from_client > 0
            && self.boot_section.is_some_and(|start| avr.pc() as usize >= start)
            && avr.polls_serial(now.saturating_sub(POLL_PERIOD));
    }

    /// Bits per second of the client; `None` for those of the board.
    fn client_rate(&self) -> Option<u64> {
        self.pty.baud().filter(|_| !self.ignores_baud).map(u64::from)
    }

    /// Counts bytes between a client and a board with these rates, and warns once of garbage.
    fn count(&mut self, bytes: usize, client: Option<u64>, board: u64) {
        let Some(client) = client.filter(|client| !rates_match(*client, board)) else {
            self.traffic.read += bytes;
            return;
        };
        self.traffic.garbage += bytes;
        if self.has_warned || self.traffic.read > 0 || self.traffic.garbage < GARBAGE_MIN {
            return;
        }
        self.has_warned = true;
        let path = self.pty.path().display();
        let why = if client == u64::from(FIRST_BAUD) {
            format!(", the rate of a port for which no program has set one: stty -F {path} RATE")
        } else {
            String::new()
        };
        self.hint = Some(format!(
            "--serial: the client has {client} baud{why}. The board has {board}, so both read \
             garbage"
        ));
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
                self.gives_time = false;
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

    fn serial_output(&mut self, board: usize, bytes: &[(Cycles, u8)], rate: u64) {
        if !self.attached || board != self.board {
            return;
        }
        let own = self.client_rate().unwrap_or(rate);
        self.count(bytes.len(), Some(own), rate);
        self.to_client.extend(bytes.iter().map(|(_, byte)| byte_read_at(*byte, rate, own)));
        let excess = self.to_client.len().saturating_sub(TO_CLIENT_MAX);
        self.to_client.drain(..excess);
        self.lost += excess as u64;
    }

    fn status(&self) -> String {
        let state = if self.attached { "in use" } else { "free" };
        let path = self.pty.path().display();
        format!("serial {path}: {state}, opened {} times, {} bytes lost", self.openings, self.lost)
    }

    fn take_hint(&mut self) -> Option<String> {
        self.hint.take()
    }

    fn needs_real_time(&self) -> bool {
        true
    }

    fn gives_time(&self) -> bool {
        self.gives_time
    }
}
