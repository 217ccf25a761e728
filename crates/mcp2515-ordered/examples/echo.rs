//! Runs the driver on a host, with a model of the chip of a hundred lines. Sends all received
//! frames back, in order.
//!
//!     cargo run --example echo

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;

use embedded_hal::digital::{self, InputPin, OutputPin};
use embedded_hal::spi::{self, SpiBus};
use mcp2515_ordered::{Attempts, BitTiming, Configuration, Filters, Frame, Mcp2515};

fn main() {
    let pins = Pins(Rc::new(RefCell::new(Chip { registers: [0; 128], instruction: vec![] })));
    let configuration = Configuration {
        timing: const { BitTiming::new(16_000_000, 500_000) },
        acceptance: Filters::ALL_EXTENDED,
        attempts: Attempts::UntilSent,
    };
    let mut can = Mcp2515::new(pins.clone(), pins.clone(), pins.clone(), configuration);
    let mut replies: VecDeque<Frame> = VecDeque::new();
    let mut frame = Frame::EMPTY;

    // A turn takes a millisecond here. The turns of a real main loop are much shorter.
    for now_ms in 0..80u16 {
        if can.state(now_ms).is_due
            && let Some(notice) = can.poll(now_ms)
        {
            println!("{now_ms:2} ms  {:?}, {:#04X}", notice.event, notice.value);
        }
        if can.is_running() && now_ms % 10 == 0 {
            pins.0.borrow_mut().arrives([0x10, 0, 0, now_ms as u8], b"one");
            pins.0.borrow_mut().arrives([0x10, 0, 0, now_ms as u8], b"two");
        }
        while can.has_frame() && can.receive(&mut frame) {
            println!("{now_ms:2} ms  received {}", text(frame.id, frame.data()));
            frame.id[1] = 0xEC;
            replies.push_back(frame);
        }
        while !replies.is_empty() {
            can.find_room();
            if !can.state(now_ms).has_room {
                break;
            }
            replies.pop_front().iter().for_each(|reply| can.transmit(reply));
        }
        for (id, data) in pins.0.borrow_mut().sends() {
            println!("{now_ms:2} ms  sent     {}", text(id, &data));
        }
    }
}

fn text(id: [u8; 4], data: &[u8]) -> String {
    format!("{:08X} {}", u32::from_be_bytes(id), String::from_utf8_lossy(data))
}

/// A model of the MCP2515 that is sufficient for the driver: no bus, no errors, and modes that
/// change at once.
struct Chip {
    registers: [u8; 128],
    /// The bytes of the instruction since CS fell.
    instruction: Vec<u8>,
}

const CANSTAT: usize = 0x0E;
const CANCTRL: usize = 0x0F;
const CANINTF: usize = 0x2C;
const TXBNCTRL: [usize; 3] = [0x30, 0x40, 0x50];
const TXREQ: u8 = 0x08;
const RXBNSIDH: [usize; 2] = [0x61, 0x71];
const CONFIGURATION_MODE: u8 = 0x80;

impl Chip {
    /// Puts an arriving frame in the first free buffer.
    fn arrives(&mut self, [b3, b2, b1, b0]: [u8; 4], data: &[u8]) {
        let Some(n) = (0..2).find(|n| self.registers[CANINTF] & 1 << n == 0) else { return };
        let buffer = &mut self.registers[RXBNSIDH[n]..][..13];
        buffer[..4].copy_from_slice(&[b3 << 3 | b2 >> 5, (b2 << 3) & 0xE0 | 0x08 | b2 & 3, b1, b0]);
        buffer[4] = data.len() as u8;
        buffer[5..][..data.len()].copy_from_slice(data);
        self.registers[CANINTF] |= 1 << n;
    }

    /// Sends the frames that wait: the highest priority first, and at equal priority the highest
    /// buffer first.
    fn sends(&mut self) -> Vec<([u8; 4], Vec<u8>)> {
        let mut frames = vec![];
        loop {
            let waiting = TXBNCTRL.into_iter().filter(|&at| self.registers[at] & TXREQ != 0);
            let Some(at) = waiting.max_by_key(|&at| (self.registers[at] & 3, at)) else {
                return frames;
            };
            self.registers[at] &= !TXREQ;
            let [sidh, sidl, eid8, eid0, dlc] = self.registers[at + 1..at + 6] else {
                unreachable!()
            };
            let id = [sidh >> 3, sidh << 5 | (sidl >> 3) & 0x1C | sidl & 3, eid8, eid0];
            frames.push((id, self.registers[at + 6..][..usize::from(dlc)].to_vec()));
        }
    }

    /// Takes one byte of an instruction (DS20001801J table 12-1), and returns the answer to it.
    fn exchange(&mut self, byte: u8) -> u8 {
        self.instruction.push(byte);
        let n = self.instruction.len() - 1;
        match self.instruction[0] {
            0xC0 => {
                self.registers = [0; 128];
                self.registers[CANSTAT] = CONFIGURATION_MODE;
            }
            0x02 if n >= 2 => {
                let at = usize::from(self.instruction[1]) + n - 2;
                self.registers[at] = byte;
                if at == CANCTRL {
                    self.registers[CANSTAT] = byte & 0xE0;
                }
            }
            0x03 if n >= 2 => return self.registers[usize::from(self.instruction[1]) + n - 2],
            0xA0 if n >= 1 => {
                let [first, second, third] =
                    TXBNCTRL.map(|at| u8::from(self.registers[at] & TXREQ != 0));
                return self.registers[CANINTF] & 3 | first << 2 | second << 4 | third << 6;
            }
            0x81..=0x87 => {
                for (_, at) in TXBNCTRL.into_iter().enumerate().filter(|(n, _)| byte & 1 << n != 0)
                {
                    self.registers[at] |= TXREQ;
                }
            }
            0x90 | 0x94 if n >= 1 => return self.registers[RXBNSIDH[self.buffer_read()] + n - 1],
            _ => {}
        }
        0
    }

    /// The number of the receive buffer that READ RX BUFFER selects.
    fn buffer_read(&self) -> usize {
        usize::from(self.instruction[0] == 0x94)
    }

    fn deselect(&mut self) {
        if matches!(self.instruction[..], [0x90 | 0x94, ..]) {
            self.registers[CANINTF] &= !(1 << self.buffer_read());
        }
        self.instruction.clear();
    }
}

/// The SPI, CS and INT of the chip.
#[derive(Clone)]
struct Pins(Rc<RefCell<Chip>>);

impl spi::ErrorType for Pins {
    type Error = Infallible;
}

impl SpiBus for Pins {
    fn read(&mut self, words: &mut [u8]) -> Result<(), Infallible> {
        words.fill(0);
        self.transfer_in_place(words)
    }

    fn write(&mut self, words: &[u8]) -> Result<(), Infallible> {
        self.transfer_in_place(&mut words.to_vec())
    }

    fn transfer(&mut self, _read: &mut [u8], _write: &[u8]) -> Result<(), Infallible> {
        unimplemented!("the driver does not use it")
    }

    fn transfer_in_place(&mut self, words: &mut [u8]) -> Result<(), Infallible> {
        words.iter_mut().for_each(|word| *word = self.0.borrow_mut().exchange(*word));
        Ok(())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl digital::ErrorType for Pins {
    type Error = Infallible;
}

impl OutputPin for Pins {
    fn set_low(&mut self) -> Result<(), Infallible> {
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0.borrow_mut().deselect();
        Ok(())
    }
}

impl InputPin for Pins {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        self.is_low().map(|low| !low)
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.borrow().registers[CANINTF] & 3 != 0)
    }
}
