// Data-space addresses and bits of the ATmega48/88/168/328P (Atmel 2545, "Register Summary") that
// avr8js does not export. The names are those of the datasheet.

export const PINB = 0x23;
export const PINC = 0x26;
export const PIND = 0x29;
export const EIFR = 0x3c;
export const EIMSK = 0x3d;
export const EECR = 0x3f;
export const EEDR = 0x40;
export const EEARL = 0x41;
export const EEARH = 0x42;
export const GTCCR = 0x43;
export const PSRSYNC = 1 << 0;
export const PSRASY = 1 << 1;
export const SPCR = 0x4c;
export const SPSR = 0x4d;
export const SPDR = 0x4e;
export const SMCR = 0x53;
export const MCUSR = 0x54;
export const PORF = 1 << 0;
export const EXTRF = 1 << 1;
export const BORF = 1 << 2;
export const WDRF = 1 << 3;
export const SREG = 0x5f;
export const SREG_I = 1 << 7;
export const WDTCSR = 0x60;
export const EICRA = 0x69;
export const ADCSRA = 0x7a;
export const ADMUX = 0x7c;
export const TCCR2A = 0xb0;
export const TCCR2B = 0xb1;
export const OCR2A = 0xb3;
export const OCR2B = 0xb4;
export const UCSR0A = 0xc0;
export const UCSR0B = 0xc1;
export const UCSR0C = 0xc2;
export const UBRR0L = 0xc4;
export const UBRR0H = 0xc5;
export const UDR0 = 0xc6;

/** First byte of the RAM, after the registers. */
export const RAMSTART = 0x100;
