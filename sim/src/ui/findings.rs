//! Hints for the author of a program: bit rates that do not match, a chip select that is never low,
//! an INT that the program never looks at, and a frame that waits in a mode of the controller that
//! does not send. The bench gives each hint once.
//!
//! A finding is not a mistake of the program, which may fit another board.
//! [`mistakes`](super::mistakes) has the mistakes.

use bench::board::Board;
use bench::mcp2515::Mode;
use bench::{Cycles, F_CPU_HZ};

/// Largest difference of two CAN bit rates that counts as equal: just above the 1.58 % that ISO
/// 11898-1 allows at most.
const CAN_TOLERANCE_PER_MILLE: u64 = 16;
/// Largest difference of two baud rates at which a UART still receives characters of 10 bits.
const UART_TOLERANCE_PER_MILLE: u64 = 40;
/// The rate of the Arduino IDE's serial monitor, of ravedude and of this project.
const SERIAL_MONITOR_RATE: u64 = 115_200;
/// The rates that serial monitors offer.
const SERIAL_RATES: [u64; 11] =
    [300, 1_200, 2_400, 4_800, 9_600, 19_200, 38_400, 57_600, 115_200, 250_000, 1_000_000];
/// Time after power-on by which a program has configured its SPI.
const SPI_SETTLED: Cycles = F_CPU_HZ / 2;
/// INT that is low for this long without a look at its pin.
const INT_SETTLED: Cycles = F_CPU_HZ / 2;
/// A frame that waits this long for normal mode: the program has not set that mode. The start of a
/// program takes less.
const MODE_SETTLED: Cycles = F_CPU_HZ / 2;

/// The hints given so far.
#[derive(Debug, Default)]
pub struct Findings {
    bit_rate: Option<u64>,
    serial_rate: Option<u64>,
    is_cs_reported: bool,
    is_int_reported: bool,
    /// First byte of the boot section, if there is a bootloader. Its rate is no finding.
    boot_start: Option<usize>,
    /// True if the bootloader ran at the last check.
    was_in_loader: bool,
    /// Start of the time in which INT has been low and the program has looked at another pin.
    unseen_since: Option<Cycles>,
    /// Start of the time in which a frame has waited in a mode that does not send.
    stuck_since: Option<Cycles>,
}

impl Findings {
    /// No hints yet. `boot_start` is the first byte of the boot section of a chip with a
    /// bootloader.
    pub fn new(boot_start: Option<usize>) -> Findings {
        Findings { boot_start, ..Findings::default() }
    }

    /// Checks a board on a bus of `bus_rate` bits per second. Returns the new hints.
    pub fn check(&mut self, board: &Board, bus_rate: u32, has_sent_serial: bool) -> Vec<String> {
        let found = [
            self.check_can_rate(board, bus_rate),
            self.check_uart_rate(board, has_sent_serial),
            self.check_chip_select(board),
            self.check_int(board),
            self.check_mode(board),
        ];
        found.into_iter().flatten().collect()
    }

    fn check_can_rate(&mut self, board: &Board, bus_rate: u32) -> Option<String> {
        let chip = board.chip();
        let chip = chip.borrow();
        if !matches!(chip.mode(), Mode::Normal | Mode::ListenOnly) {
            return None;
        }
        let rate = chip.bit_rate();
        if self.bit_rate.replace(rate) == Some(rate)
            || is_near(rate, bus_rate.into(), CAN_TOLERANCE_PER_MILLE)
        {
            return None;
        }
        Some(format!(
            "the node is at {} kbit/s, the bus at {} kbit/s: each gets only errors from the \
             other. Set the program's bit rate, its crystal (--crystal), or the bus (--bit-rate)",
            kilo(rate),
            kilo(bus_rate.into())
        ))
    }

    fn check_uart_rate(&mut self, board: &Board, has_sent: bool) -> Option<String> {
        let rate = board.avr().serial_bits_per_second();
        let in_loader = self.boot_start.is_some_and(|start| board.avr().pc() as usize >= start);
        if std::mem::replace(&mut self.was_in_loader, in_loader) || in_loader {
            return None;
        }
        if !has_sent || self.serial_rate.replace(rate) == Some(rate) {
            return None;
        }
        if is_near(rate, SERIAL_MONITOR_RATE, UART_TOLERANCE_PER_MILLE) {
            return None;
        }
        let usual =
            SERIAL_RATES.into_iter().find(|usual| is_near(rate, *usual, UART_TOLERANCE_PER_MILLE));
        Some(match usual {
            Some(usual) => format!("the UART is at {usual} baud: set the serial monitor to that"),
            None => {
                format!(
                    "the UART is at {rate} baud, which no serial monitor has: is the program for \
                     another clock?"
                )
            }
        })
    }

    fn check_chip_select(&mut self, board: &Board) -> Option<String> {
        let passed = board.spi_use();
        let is_silent = passed.selects == 0 && passed.bytes_elsewhere > 0;
        if self.is_cs_reported || !is_silent || board.now() < SPI_SETTLED {
            return None;
        }
        self.is_cs_reported = true;
        let cs = board.wiring().cs;
        Some(format!(
            "{} bytes on the SPI, but CS of the MCP2515 ({cs}) has never been low: is it another \
             pin in the program (--cs)?",
            passed.bytes_elsewhere
        ))
    }

    /// INT is low, the program has never looked at its pin, but waits for the interrupt of another
    /// one. A program without any such interrupt can poll the chip over the SPI.
    fn check_int(&mut self, board: &Board) -> Option<String> {
        let int = board.wiring().int;
        let avr = board.avr();
        let others = avr.interrupt_pins();
        let is_unseen = !board.chip().borrow().int_pin()
            && !others.is_empty()
            && !avr.observes_pin(int.port(), int.bit());
        if self.is_int_reported || !is_unseen {
            self.unseen_since = None;
            return None;
        }
        let since = *self.unseen_since.get_or_insert(board.now());
        self.is_int_reported = board.now() - since >= INT_SETTLED;
        let name = |(port, bit): (char, u8)| format!("P{port}{bit}");
        let names: Vec<String> = others.into_iter().map(name).collect();
        self.is_int_reported.then(|| {
            format!(
                "INT of the MCP2515 ({int}) is low, but the program has never looked at that pin, \
                 only at {}: is INT another pin in the program (--int)?",
                names.join(", ")
            )
        })
    }

    fn check_mode(&mut self, board: &Board) -> Option<String> {
        let chip = board.chip();
        let chip = chip.borrow();
        let name = match chip.mode() {
            Mode::Configuration => "configuration",
            Mode::ListenOnly => "listen-only",
            _ => "",
        };
        if name.is_empty() || !chip.has_frame_to_send() {
            self.stuck_since = None;
            return None;
        }
        let since = *self.stuck_since.get_or_insert(board.now());
        (board.now() - since >= MODE_SETTLED).then(|| {
            format!(
                "a frame waits to be sent, but the MCP2515 is in {name} mode: it sends in normal \
                 mode only (CANCTRL)"
            )
        })
    }
}

fn is_near(rate: u64, other: u64, per_mille: u64) -> bool {
    rate.abs_diff(other) * 1000 <= other * per_mille
}

/// `rate` in thousands, with one decimal unless it is 0: "500", "83.3".
fn kilo(rate: u64) -> String {
    if rate.is_multiple_of(1000) {
        format!("{}", rate / 1000)
    } else {
        format!("{:.1}", rate as f64 / 1000.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_within_the_tolerance_of_a_receiver_are_equal() {
        assert!(
            is_near(117_647, SERIAL_MONITOR_RATE, UART_TOLERANCE_PER_MILLE),
            "16 MHz / 8 / 17, as Arduinos have it"
        );
        assert!(!is_near(9_615, SERIAL_MONITOR_RATE, UART_TOLERANCE_PER_MILLE));
        assert!(is_near(9_615, 9_600, UART_TOLERANCE_PER_MILLE));
        assert!(!is_near(500_000, 1_000_000, CAN_TOLERANCE_PER_MILLE));
        assert_eq!((kilo(500_000), kilo(83_333)), (String::from("500"), String::from("83.3")));
    }
}
