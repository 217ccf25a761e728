/* A typical program for an Arduino Uno with a blue MCP2515 module: CS on D10, crystal of 8 MHz, 500 kbit/s. It sends a frame
 * each 100 ms, and a line on the serial port. It uses only avr-libc.
 * UBRR: baud rate register of the serial port. MODE: mode of the controller. LISTENER: sends no frame, and fetches those of
 * others from RXB0. SD_CARD: also sends bytes to another device on the
 * SPI, with its CS on D8. MASKS: the masks are 0, and the filters as after power-on. RXB0: value of RXB0CTRL. INT_ON_D3: the controller's INT requests an interrupt, and the program waits for it on D3. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/delay.h>

#define RESET 0xC0
#define WRITE 0x02
#define READ 0x03
#define LOAD_TXB0 0x40
#define RTS_TXB0 0x81
#define CANSTAT 0x0E
#define CANCTRL 0x0F
#define CANINTE 0x2B
#define TX0IE 0x04
#define CNF3 0x28
#define CNF2 0x29
#define CNF1 0x2A
#define TXB0CTRL 0x30
#define TXREQ 0x08
#define RXB0CTRL 0x60
#define RXM0SIDH 0x20
#define READ_RXB0 0x90
#define CANINTF 0x2C
#define RX0IF 0x01
#define ID 0x123
#ifndef UBRR
#define UBRR 8
#endif
#ifndef MODE
#define MODE 0x00
#endif

static volatile uint32_t milliseconds;

ISR(TIMER0_COMPA_vect) { milliseconds++; }
EMPTY_INTERRUPT(INT1_vect)

static uint32_t millis(void)
{
    cli();
    uint32_t now = milliseconds;
    sei();
    return now;
}

static void serial(const char *text)
{
    for (; *text; text++) {
        while (!(UCSR0A & _BV(UDRE0))) { }
        UDR0 = *text;
    }
}

static uint8_t exchange(uint8_t byte)
{
    SPDR = byte;
    while (!(SPSR & _BV(SPIF))) { }
    return SPDR;
}

static void select(void) { PORTB &= ~_BV(PB2); }
static void deselect(void) { PORTB |= _BV(PB2); }

static void instruct(uint8_t instruction)
{
    select();
    exchange(instruction);
    deselect();
}

static void write(uint8_t address, uint8_t value)
{
    select();
    exchange(WRITE);
    exchange(address);
    exchange(value);
    deselect();
}

static uint8_t read(uint8_t address)
{
    select();
    exchange(READ);
    exchange(address);
    uint8_t value = exchange(0);
    deselect();
    return value;
}

static void send(uint8_t count)
{
    while (read(TXB0CTRL) & TXREQ) { }
    select();
    exchange(LOAD_TXB0);
    exchange(ID >> 3);
    exchange((ID & 7) << 5);
    exchange(0);
    exchange(0);
    exchange(2);
    exchange(0xA5);
    exchange(count);
    deselect();
    instruct(RTS_TXB0);
}

#ifdef LISTENER
/* Fetches a frame, which frees RXB0. */
static void listen(void)
{
    if (!(read(CANINTF) & RX0IF)) { return; }
    select();
    exchange(READ_RXB0);
    for (uint8_t byte = 0; byte < 13; byte++) { exchange(0); }
    deselect();
}
#endif

static void ask_sd_card(void)
{
#ifdef SD_CARD
    PORTB &= ~_BV(PB0);
    for (uint8_t byte = 0; byte < 6; byte++) { exchange(0x40); }
    PORTB |= _BV(PB0);
#endif
}

int main(void)
{
    PORTB = _BV(PB2) | _BV(PB0);
    DDRB = _BV(PB2) | _BV(PB3) | _BV(PB5) | _BV(PB0);
    SPCR = _BV(SPE) | _BV(MSTR);
    UBRR0 = UBRR;
    UCSR0B = _BV(TXEN0);
    TCCR0A = _BV(WGM01);
    TCCR0B = _BV(CS01) | _BV(CS00);
    OCR0A = 249;
    TIMSK0 = _BV(OCIE0A);
    sei();

    _delay_ms(5);
    instruct(RESET);
    _delay_ms(5);
    /* 8 quanta of 250 ns: 1 + 1 + 3 before the sample, 3 after it. Arduino libraries use the same values. */
    write(CNF1, 0x00);
    write(CNF2, 0x90);
    write(CNF3, 0x82);
#ifdef LISTENER
    write(RXB0CTRL, 0x60);
#endif
#ifdef MASKS
    for (uint8_t address = RXM0SIDH; address < RXM0SIDH + 8; address++) { write(address, 0); }
#endif
#ifdef RXB0
    write(RXB0CTRL, RXB0);
#endif
#ifdef INT_ON_D3
    write(CANINTE, TX0IE);
    EICRA = _BV(ISC11);
    EIMSK = _BV(INT1);
#endif
    write(CANCTRL, MODE);
    while ((read(CANSTAT) & 0xE0) != MODE) { }
    serial("CAN started\n");

#ifdef LISTENER
    for (;;) { listen(); }
#endif
    uint32_t next = millis();
    for (uint8_t count = 0;; count++) {
        while ((int32_t)(millis() - next) < 0) { }
        next += 100;
        ask_sd_card();
        send(count);
        serial("sent\n");
    }
}
