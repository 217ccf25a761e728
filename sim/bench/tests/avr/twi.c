/* Writes two registers of device 0x48 on the TWI, reads them back after a repeated START, and then calls device 0x49. Notes the status after each step, and the time in CPU cycles / 8 of the first byte. */
#include <avr/io.h>

volatile uint8_t status[14];
volatile uint8_t received[2];
volatile uint16_t ticks;
volatile uint8_t done;

static uint8_t step;

static void act(uint8_t control)
{
    TWCR = control | _BV(TWINT) | _BV(TWEN);
    while (!(TWCR & _BV(TWINT))) {
    }
    status[step++] = TWSR & 0xF8;
}

static void send(uint8_t byte)
{
    TWDR = byte;
    act(0);
}

static void stop(void)
{
    TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
    while (TWCR & _BV(TWSTO)) {
    }
}

int main(void)
{
    TWBR = 72; /* 100 kHz */
    TCCR1B = _BV(CS11);
    act(_BV(TWSTA));
    uint16_t start = TCNT1;
    send(0x48 << 1);
    ticks = TCNT1 - start;
    send(0x10);
    send(0xA5);
    send(0x5A);
    act(_BV(TWSTA));
    send(0x48 << 1);
    send(0x10);
    act(_BV(TWSTA));
    send(0x48 << 1 | 1);
    act(_BV(TWEA));
    received[0] = TWDR;
    act(0);
    received[1] = TWDR;
    stop();
    act(_BV(TWSTA));
    send(0x49 << 1);
    stop();
    done = 1;
    for (;;) {
    }
}
