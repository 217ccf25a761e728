//! The Arduino board of these firmwares: SPI to the MCP2515, a blocking serial port, a cycle
//! counter.
//!
//! Pins: D4 (PD4) low selects reception only. Chip select is D9 (PB1) or D10 (PB2); D10 is an
//! output so that the SPI stays master. D11 MOSI, D12 MISO, D13 SCK, D1 TXD.
//! This file knows nothing of CAN and shares no code with the node's `src/`: the firmwares that
//! check the simulator's model must be independent of the firmware for which the model was made.
//! Source: ATmega48/88/168 datasheet, sections SPI, USART0, 16-bit Timer/Counter1.

#[cfg(chip = "atmega168")]
use avr_device::atmega168::{PORTB, Peripherals, SPI, TC1, USART0};
#[cfg(chip = "atmega328p")]
use avr_device::atmega328p::{PORTB, Peripherals, SPI, TC1, USART0};
use core::convert::Infallible;
use core::marker::PhantomData;
use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};

/// Frequency of the Arduino's crystal.
const F_CPU_HZ: u32 = 16_000_000;
/// 115,200 baud with U2X0: 16 MHz / (8 * (16 + 1)) = 117,647, 2.1 % fast.
const UBRR_115200: u16 = 16;

/// The MCP2515's RESET instruction.
const RESET: u8 = 0xC0;
/// A little longer than 128 periods of 8 MHz.
const START_UP_US: u32 = 20;

/// How the MCP2515 is wired.
pub trait CanBoard {
    const CS_IS_D10: bool;
    const CRYSTAL_MHZ: u8;
}

/// The Seeed CAN-BUS shield. It reaches 1 Mbit/s.
pub struct Shield;

impl CanBoard for Shield {
    const CS_IS_D10: bool = false;
    const CRYSTAL_MHZ: u8 = 16;
}

/// The blue MCP2515 module. Its crystal allows at most 500 kbit/s.
pub struct Module;

impl CanBoard for Module {
    const CS_IS_D10: bool = true;
    const CRYSTAL_MHZ: u8 = 8;
}

/// What the firmware does.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Task {
    /// Answers and reports every frame.
    WholeJob,
    /// Reads every frame and does nothing else: the fastest loop of a driver.
    ReceiveOnly,
}

/// Sets up the board: SPI mode 0 at 8 MHz, most significant bit first; serial 115200 8N1; Timer1 at
/// 16 MHz.
pub fn take<B: CanBoard>() -> (CanSpi<B>, Serial, Clock, Task) {
    let peripherals = Peripherals::take().unwrap();

    let mut port = peripherals.PORTB;
    select::<B>(&mut port, false);
    port.ddrb.write(|w| w.pb1().set_bit().pb2().set_bit().pb3().set_bit().pb5().set_bit());
    let spi = peripherals.SPI;
    spi.spcr.write(|w| w.spe().set_bit().mstr().set_bit().spr().fosc_4_2());
    spi.spsr.write(|w| w.spi2x().set_bit());

    let usart = peripherals.USART0;
    usart.ubrr0.write(|w| w.bits(UBRR_115200));
    usart.ucsr0a.write(|w| w.u2x0().set_bit());
    usart.ucsr0b.write(|w| w.txen0().set_bit());

    let timer = peripherals.TC1;
    timer.tccr1b.write(|w| w.cs1().direct());

    let button = peripherals.PORTD;
    button.portd.write(|w| w.pd4().set_bit());
    // The pull-up needs a moment.
    avr_device::asm::delay_cycles(F_CPU_HZ / 1_000_000);
    let task =
        if button.pind.read().pd4().bit_is_set() { Task::WholeJob } else { Task::ReceiveOnly };

    (CanSpi { spi, port, board: PhantomData }, Serial { usart }, Clock { timer }, task)
}

/// The MCP2515 on its SPI bus, with chip select.
pub struct CanSpi<B> {
    spi: SPI,
    port: PORTB,
    board: PhantomData<B>,
}

impl<B> CanSpi<B> {
    fn exchange(&mut self, byte: u8) -> u8 {
        self.spi.spdr.write(|w| w.bits(byte));
        while self.spi.spsr.read().spif().bit_is_clear() {}
        self.spi.spdr.read().bits()
    }
}

impl<B> ErrorType for CanSpi<B> {
    type Error = Infallible;
}

impl<B: CanBoard> SpiDevice for CanSpi<B> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        select::<B>(&mut self.port, true);
        for operation in operations.iter_mut() {
            match operation {
                Operation::Read(words) => {
                    for word in words.iter_mut() {
                        *word = self.exchange(0);
                    }
                }
                Operation::Write(words) => {
                    for &word in words.iter() {
                        self.exchange(word);
                    }
                }
                Operation::TransferInPlace(words) => {
                    for word in words.iter_mut() {
                        *word = self.exchange(*word);
                    }
                }
                // Neither crate uses these two.
                Operation::Transfer(..) | Operation::DelayNs(_) => unreachable!(),
            }
        }
        select::<B>(&mut self.port, false);
        // `mcp25xx` continues at once after RESET, and a crystal of 8 MHz needs 16 us to start
        // again (DS20001801J 8.1).
        if B::CRYSTAL_MHZ == 8 && matches!(*operations, [Operation::Write([RESET])]) {
            avr_device::asm::delay_cycles(START_UP_US * (F_CPU_HZ / 1_000_000));
        }
        Ok(())
    }
}

/// Sets chip select: low selects the MCP2515.
fn select<B: CanBoard>(port: &mut PORTB, selected: bool) {
    if B::CS_IS_D10 {
        port.portb.modify(|_, w| w.pb2().bit(!selected));
    } else {
        port.portb.modify(|_, w| w.pb1().bit(!selected));
    }
}

/// The serial port, for output only. A write waits for room, which makes the firmwares slow while
/// they report.
pub struct Serial {
    usart: USART0,
}

impl Serial {
    pub fn write(&mut self, byte: u8) {
        while self.usart.ucsr0a.read().udre0().bit_is_clear() {}
        self.usart.udr0.write(|w| w.bits(byte));
    }
}

/// Timer1, which counts CPU cycles and overflows every 4.096 ms.
pub struct Clock {
    timer: TC1,
}

impl Clock {
    /// CPU cycles, modulo 65,536.
    pub fn cycles(&self) -> u16 {
        self.timer.tcnt1.read().bits()
    }

    /// True if the counter has overflowed since the last call.
    pub fn overflowed(&mut self) -> bool {
        let overflowed = self.timer.tifr1.read().tov1().bit_is_set();
        if overflowed {
            self.timer.tifr1.write(|w| w.tov1().set_bit());
        }
        overflowed
    }
}

/// Delays by busy waiting.
pub struct Delay;

impl DelayNs for Delay {
    fn delay_ns(&mut self, ns: u32) {
        avr_device::asm::delay_cycles(ns / (1_000_000_000 / F_CPU_HZ));
    }
}

#[panic_handler]
fn panic(_info: &core::panic::PanicInfo) -> ! {
    loop {}
}
