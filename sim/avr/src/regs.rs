//! Data-space addresses and bits of the registers that the simulator uses.
//!
//! The names are those of the datasheet (Atmel 2545, "Register Summary"). Bits are values, not
//! positions.

#![allow(
    missing_docs,
    reason = "the names are the documentation: see the datasheet's register summary"
)]

/// First I/O register, after R0 to R31.
pub const IO_FIRST: u16 = 0x20;
/// First byte of the internal SRAM, after the registers.
pub const RAMSTART: u16 = 0x0100;

pub const PINB: u16 = 0x23;
pub const DDRB: u16 = 0x24;
pub const PORTB: u16 = 0x25;
pub const PINC: u16 = 0x26;
pub const PIND: u16 = 0x29;
pub const DDRD: u16 = 0x2A;
pub const PORTD: u16 = 0x2B;

pub const TIFR0: u16 = 0x35;
pub const TIFR1: u16 = 0x36;
pub const TIFR2: u16 = 0x37;

pub const PCIFR: u16 = 0x3B;
pub const EIFR: u16 = 0x3C;
pub const EIMSK: u16 = 0x3D;

pub const EECR: u16 = 0x3F;
pub const EERE: u8 = 1 << 0;
pub const EEPE: u8 = 1 << 1;
pub const EEMPE: u8 = 1 << 2;
pub const EERIE: u8 = 1 << 3;
pub const EEPM: u8 = 0b11 << 4;
pub const EEDR: u16 = 0x40;
pub const EEARL: u16 = 0x41;
pub const EEARH: u16 = 0x42;

pub const GTCCR: u16 = 0x43;
pub const PSRSYNC: u8 = 1 << 0;
pub const PSRASY: u8 = 1 << 1;
pub const TSM: u8 = 1 << 7;
pub const TCCR0A: u16 = 0x44;
pub const TCCR0B: u16 = 0x45;
pub const TCNT0: u16 = 0x46;
pub const OCR0A: u16 = 0x47;
pub const OCR0B: u16 = 0x48;

pub const SPCR: u16 = 0x4C;
pub const SPIE: u8 = 1 << 7;
pub const SPE: u8 = 1 << 6;
pub const DORD: u8 = 1 << 5;
pub const MSTR: u8 = 1 << 4;
pub const CPOL: u8 = 1 << 3;
pub const CPHA: u8 = 1 << 2;
pub const SPR: u8 = 0b11;
pub const SPSR: u16 = 0x4D;
pub const SPIF: u8 = 1 << 7;
pub const WCOL: u8 = 1 << 6;
pub const SPI2X: u8 = 1 << 0;
pub const SPDR: u16 = 0x4E;

pub const SMCR: u16 = 0x53;
pub const SE: u8 = 1 << 0;
pub const MCUSR: u16 = 0x54;
pub const PORF: u8 = 1 << 0;
pub const EXTRF: u8 = 1 << 1;
pub const BORF: u8 = 1 << 2;
pub const WDRF: u8 = 1 << 3;
pub const MCUCR: u16 = 0x55;
pub const IVSEL: u8 = 1 << 1;
pub const PUD: u8 = 1 << 4;

pub const SPMCSR: u16 = 0x57;
pub const SPMIE: u8 = 1 << 7;
pub const RWWSB: u8 = 1 << 6;
pub const SIGRD: u8 = 1 << 5;
pub const RWWSRE: u8 = 1 << 4;
pub const BLBSET: u8 = 1 << 3;
pub const PGWRT: u8 = 1 << 2;
pub const PGERS: u8 = 1 << 1;
pub const SELFPRGEN: u8 = 1 << 0;

pub const SPL: u16 = 0x5D;
pub const SPH: u16 = 0x5E;
pub const SREG: u16 = 0x5F;

pub const WDTCSR: u16 = 0x60;
pub const WDIF: u8 = 1 << 7;
pub const WDIE: u8 = 1 << 6;
pub const WDCE: u8 = 1 << 4;
pub const WDE: u8 = 1 << 3;
pub const WDP: u8 = 0b10_0111;

pub const PRR: u16 = 0x64;
pub const PRTIM1: u8 = 1 << 3;
pub const PRTIM0: u8 = 1 << 5;
pub const PRTIM2: u8 = 1 << 6;
pub const PCICR: u16 = 0x68;
pub const EICRA: u16 = 0x69;
pub const ISC1: u8 = 0b11 << 2;
pub const PCMSK0: u16 = 0x6B;
pub const PCMSK2: u16 = 0x6D;
pub const TIMSK0: u16 = 0x6E;
pub const TIMSK1: u16 = 0x6F;
pub const TIMSK2: u16 = 0x70;

pub const ADCL: u16 = 0x78;
pub const ADCH: u16 = 0x79;
pub const ADCSRA: u16 = 0x7A;
pub const ADEN: u8 = 1 << 7;
pub const ADSC: u8 = 1 << 6;
pub const ADATE: u8 = 1 << 5;
pub const ADIF: u8 = 1 << 4;
pub const ADIE: u8 = 1 << 3;
pub const ADPS: u8 = 0b111;
pub const ADCSRB: u16 = 0x7B;
pub const ADTS: u8 = 0b111;
pub const ADMUX: u16 = 0x7C;
pub const ADLAR: u8 = 1 << 5;
pub const REFS: u8 = 0b11 << 6;
pub const MUX: u8 = 0b1111;

pub const TCCR1A: u16 = 0x80;
pub const TCCR1B: u16 = 0x81;
pub const ICES1: u8 = 1 << 6;
pub const ICNC1: u8 = 1 << 7;
pub const TCCR1C: u16 = 0x82;
pub const TCNT1L: u16 = 0x84;
pub const TCNT1H: u16 = 0x85;
pub const ICR1L: u16 = 0x86;
pub const ICR1H: u16 = 0x87;
pub const OCR1AL: u16 = 0x88;
pub const OCR1AH: u16 = 0x89;
pub const OCR1BL: u16 = 0x8A;
pub const OCR1BH: u16 = 0x8B;

pub const TCCR2A: u16 = 0xB0;
pub const TCCR2B: u16 = 0xB1;
pub const TCNT2: u16 = 0xB2;
pub const OCR2A: u16 = 0xB3;
pub const OCR2B: u16 = 0xB4;
pub const ASSR: u16 = 0xB6;
pub const AS2: u8 = 1 << 5;
pub const EXCLK: u8 = 1 << 6;

pub const TWBR: u16 = 0xB8;
pub const TWSR: u16 = 0xB9;
pub const TWPS: u8 = 0b11;
pub const TWAR: u16 = 0xBA;
pub const TWDR: u16 = 0xBB;
pub const TWCR: u16 = 0xBC;
pub const TWINT: u8 = 1 << 7;
pub const TWEA: u8 = 1 << 6;
pub const TWSTA: u8 = 1 << 5;
pub const TWSTO: u8 = 1 << 4;
pub const TWWC: u8 = 1 << 3;
pub const TWEN: u8 = 1 << 2;
pub const TWIE: u8 = 1 << 0;

pub const UCSR0A: u16 = 0xC0;
pub const RXC0: u8 = 1 << 7;
pub const TXC0: u8 = 1 << 6;
pub const UDRE0: u8 = 1 << 5;
pub const FE0: u8 = 1 << 4;
pub const DOR0: u8 = 1 << 3;
pub const U2X0: u8 = 1 << 1;
pub const MPCM0: u8 = 1 << 0;
pub const UCSR0B: u16 = 0xC1;
pub const RXCIE0: u8 = 1 << 7;
pub const TXCIE0: u8 = 1 << 6;
pub const UDRIE0: u8 = 1 << 5;
pub const RXEN0: u8 = 1 << 4;
pub const TXEN0: u8 = 1 << 3;
pub const UCSZ02: u8 = 1 << 2;
pub const UCSR0C: u16 = 0xC2;
pub const UPM0: u8 = 0b11 << 4;
pub const USBS0: u8 = 1 << 3;
pub const UBRR0L: u16 = 0xC4;
pub const UBRR0H: u16 = 0xC5;
pub const UDR0: u16 = 0xC6;

/// Address of PINx; DDRx and PORTx follow it.
pub fn pin_register(port: char) -> u16 {
    match port {
        'B' => PINB,
        'C' => PINB + 3,
        'D' => PIND,
        other => panic!("the ATmega168 has no port {other}"),
    }
}

/// Index of port B.
pub const PORT_B: usize = 0;
/// Index of port D.
pub const PORT_D: usize = 2;

/// Address of PORTx; DDRx and PINx precede it.
pub fn port_register(port: usize) -> u16 {
    PORTB + 3 * port as u16
}
