/* Sends "ready", and then each byte that it receives, at 115,200 baud. */
#include <avr/io.h>

static void put(char byte)
{
    loop_until_bit_is_set(UCSR0A, UDRE0);
    UDR0 = byte;
}

int main(void)
{
    UCSR0A = _BV(U2X0);
    UBRR0 = 16;
    UCSR0B = _BV(RXEN0) | _BV(TXEN0);
    for (const char *text = "ready\n"; *text; text++)
        put(*text);
    for (;;) {
        loop_until_bit_is_set(UCSR0A, RXC0);
        put(UDR0);
    }
}
