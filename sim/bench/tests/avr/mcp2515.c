/* A minimal driver of the MCP2515 at 1 Mbit/s, or at 500 kbit/s with a crystal of 8 MHz. While INT is low it reads a frame and
 * answers it with a frame of standard identifier REPLY_ID, whose first data byte is the received one plus 1. It keeps the
 * value of CANSTAT after the reset instruction.
 * CS_PORT, CS_DDR, CS_BIT, INT_BIT: the pins; INT is on port D. SPI_MODE_BITS: CPOL and CPHA. */
#include <avr/io.h>
#include <util/delay.h>

#ifndef REPLY_ID
#define REPLY_ID 0x123
#endif
#ifndef SPI_MODE_BITS
#define SPI_MODE_BITS 0
#endif

#ifndef CS_BIT
#define CS_PORT PORTB
#define CS_DDR DDRB
#define CS_BIT PB1
#endif
#ifndef INT_BIT
#define INT_BIT PD2
#endif

volatile uint8_t canstat;
volatile uint8_t frames;

static uint8_t exchange(uint8_t byte)
{
    SPDR = byte;
    while (!(SPSR & _BV(SPIF))) { }
    return SPDR;
}

static void select(void) { CS_PORT &= ~_BV(CS_BIT); }
static void deselect(void) { CS_PORT |= _BV(CS_BIT); }

static void write(uint8_t address, uint8_t value)
{
    select();
    exchange(0x02);
    exchange(address);
    exchange(value);
    deselect();
}

static uint8_t read(uint8_t address)
{
    select();
    exchange(0x03);
    exchange(address);
    uint8_t value = exchange(0);
    deselect();
    return value;
}

int main(void)
{
    CS_PORT |= _BV(CS_BIT);
    CS_DDR |= _BV(CS_BIT);
    DDRB |= _BV(PB2) | _BV(PB3) | _BV(PB5);
    SPCR = _BV(SPE) | _BV(MSTR) | SPI_MODE_BITS;
    SPSR = _BV(SPI2X);
    _delay_us(50);
    select();
    exchange(0xC0);
    deselect();
    _delay_us(50);
    canstat = read(0x0E);
    write(0x2A, 0x00);
    write(0x29, 0x91);
    write(0x28, 0x01);
    write(0x60, 0x60);
    write(0x2B, 0x01);
    write(0x0F, 0x00);
    while (read(0x0E) & 0xE0) { }
    for (;;) {
        if (PIND & _BV(INT_BIT))
            continue;
        select();
        exchange(0x92);
        uint8_t first = exchange(0);
        deselect();
        frames++;
        while (read(0x30) & 0x08) { }
        select();
        exchange(0x40);
        exchange(REPLY_ID >> 3);
        exchange((REPLY_ID & 7) << 5);
        exchange(0);
        exchange(0);
        exchange(1);
        exchange(first + 1);
        deselect();
        select();
        exchange(0x81);
        deselect();
    }
}
