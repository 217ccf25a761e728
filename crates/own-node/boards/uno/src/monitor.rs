//! Lines on the serial port, a character in each turn of the main loop, so that it never waits.

use arduino_hal::hal::port::{PD0, PD1};
use arduino_hal::pac::USART0;
use arduino_hal::port::Pin;
use arduino_hal::port::mode::{Input, Output};
use arduino_hal::prelude::*;
use arduino_hal::usart::Usart;
use heapless::String;
use mcp2515_ordered::{Event, Notice};
use ufmt::uwriteln;

type Serial = Usart<USART0, Pin<Input, PD0>, Pin<Output, PD1>>;

pub struct Monitor {
    serial: Serial,
    line: String<20>,
    /// The characters of the line that are sent.
    sent: u8,
    was_running: bool,
}

impl Monitor {
    pub fn new(serial: Serial) -> Self {
        Self { serial, line: String::new(), sent: 0, was_running: false }
    }

    /// Sends the next character. Prints if the node has come on the bus, or has left it. Returns
    /// true if it is on the bus.
    pub fn step(&mut self, is_running: Option<bool>) -> bool {
        let is_running = is_running == Some(true);
        if let Some(&byte) = self.line.as_bytes().get(usize::from(self.sent)) {
            if self.serial.write(byte).is_ok() {
                self.sent += 1;
            }
        } else if is_running != self.was_running {
            self.was_running = is_running;
            self.begin();
            _ = uwriteln!(self.line, "{} the bus\r", if is_running { "on" } else { "off" });
        }
        is_running
    }

    /// Prints what is wrong, unless another line is being sent.
    pub fn print(&mut self, notice: Notice) {
        if usize::from(self.sent) < self.line.len() {
            return;
        }
        let text = match notice.event {
            Event::Running => return,
            Event::NotAnswering => "no MCP2515",
            Event::IntWrong => "no INT",
            Event::AnotherRate => "other rate",
            Event::GaveUpSending => "nobody",
            _ => "error",
        };
        self.begin();
        _ = uwriteln!(self.line, "CAN: {}\r", text);
    }

    fn begin(&mut self) {
        self.line.clear();
        self.sent = 0;
    }
}
