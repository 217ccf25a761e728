/* Sends "hello" at 115200 baud (U2X, UBRR 16), and then each received byte plus 1.
 * ISR_DRIVEN: sends from the data-register-empty interrupt. SLOW: reads only every 2 ms. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/delay.h>

static const char text[] = "hello";
volatile uint8_t next;

#ifdef ISR_DRIVEN
ISR(USART_UDRE_vect)
{
    if (text[next])
        UDR0 = text[next++];
    else
        UCSR0B &= ~_BV(UDRIE0);
}
#endif

static void send(uint8_t byte)
{
    while (!(UCSR0A & _BV(UDRE0))) { }
    UDR0 = byte;
}

int main(void)
{
    UBRR0 = 16;
    UCSR0A = _BV(U2X0);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0);
#ifdef ISR_DRIVEN
    UCSR0B |= _BV(UDRIE0);
    sei();
    while (UCSR0B & _BV(UDRIE0)) { }
#else
    while (text[next])
        send(text[next++]);
#endif
    for (;;) {
#ifdef SLOW
        _delay_ms(2);
#endif
        if (UCSR0A & _BV(RXC0))
            send(UDR0 + 1);
    }
}
