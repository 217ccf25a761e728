//! Hints for the author of a program: those of [`bench::findings`], and an INT that the program
//! never looks at. [`mistakes`](super::mistakes) has the mistakes.

use bench::board::Board;
use bench::findings;
use bench::wiring::Pin;
use bench::{Cycles, F_CPU_HZ};

pub use bench::findings::Said;

/// INT that is low for this long without a look at its pin.
const INT_SETTLED: Cycles = F_CPU_HZ / 2;

/// The hints given so far.
#[derive(Debug, Default)]
pub struct Findings {
    general: findings::Findings,
    is_int_reported: bool,
    /// First byte of the boot section, if there is a bootloader. Its rate is no finding.
    boot_start: Option<usize>,
    /// True if the bootloader ran at the last check.
    was_in_loader: bool,
    /// Start of the time in which INT has been low and the program has looked at another pin.
    unseen_since: Option<Cycles>,
}

impl Findings {
    /// No hints yet. `boot_start` is the first byte of the boot section of a chip with a
    /// bootloader.
    pub fn new(boot_start: Option<usize>) -> Findings {
        Findings { boot_start, ..Findings::default() }
    }

    /// Counts the edges of pins, so that a hint can name the chip select of a program whose wiring
    /// is not known.
    pub fn watch_selects(&mut self, board: &mut Board) {
        self.general.watch_selects(board);
    }

    /// True if the program uses the pin as a chip select: then no servo is there.
    pub fn is_chip_select(&self, pin: Pin) -> bool {
        self.general.is_chip_select(pin)
    }

    /// Checks a board on a bus of `bus_rate` bits per second. Returns what is new.
    pub fn check(&mut self, board: &Board, bus_rate: u32, has_sent_serial: bool) -> Vec<Said> {
        let hints = self.general.check(board, bus_rate).into_iter().chain(self.check_int(board));
        hints.map(Said::Hint).chain(self.check_serial_rate(board, has_sent_serial)).collect()
    }

    fn check_serial_rate(&mut self, board: &Board, has_sent: bool) -> Option<Said> {
        let in_loader = self.boot_start.is_some_and(|start| board.avr().pc() as usize >= start);
        if std::mem::replace(&mut self.was_in_loader, in_loader) || in_loader || !has_sent {
            return None;
        }
        self.general.check_serial_rate(board.avr().serial_bits_per_second())
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
        let name = |pin| match pin {
            ('D', bit) => format!("D{bit}"),
            ('B', bit @ ..=5) => format!("D{}", bit + 8),
            ('C', bit @ ..=5) => format!("A{bit}"),
            (port, bit) => format!("P{port}{bit}"),
        };
        let names: Vec<String> = others.into_iter().map(name).collect();
        self.is_int_reported.then(|| {
            format!(
                "INT of the MCP2515 ({int}) is low, but the program has never looked at that pin, \
                 only at {}: is INT another pin in the program (--int)?",
                names.join(", ")
            )
        })
    }
}
