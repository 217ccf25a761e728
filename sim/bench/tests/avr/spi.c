/* Sends 1, 2, 3, 4 to the SPI device with the clock of SPCR_BITS and SPSR_BITS, and keeps the bytes that it receives.
 * COLLIDE: writes SPDR once more during the first byte. NO_SS: leaves SS an input. */
#include <avr/io.h>

#ifndef SPCR_BITS
#define SPCR_BITS 0
#endif
#ifndef SPSR_BITS
#define SPSR_BITS _BV(SPI2X)
#endif

volatile uint8_t received[4];
volatile uint8_t status;
volatile uint8_t done;

int main(void)
{
    PORTB = _BV(PB1);
#ifdef NO_SS
    DDRB = _BV(PB1) | _BV(PB3) | _BV(PB5);
#else
    DDRB = _BV(PB1) | _BV(PB2) | _BV(PB3) | _BV(PB5);
#endif
    SPCR = _BV(SPE) | _BV(MSTR) | SPCR_BITS;
    SPSR = SPSR_BITS;
    PORTB &= ~_BV(PB1);
    for (uint8_t i = 0; i < 4; i++) {
        SPDR = i + 1;
#ifdef COLLIDE
        if (i == 0)
            SPDR = 0x99;
#endif
        while (!(SPSR & _BV(SPIF))) { }
        if (i == 0)
            status = SPSR;
        received[i] = SPDR;
    }
    PORTB |= _BV(PB1);
    done = 1;
    for (;;) { }
}
