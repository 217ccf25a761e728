/* PB0 follows PD2; the pull-ups of PD3 and PD4 are on; an interrupt counts falling edges of PD2, and is masked while PD3 is low;
   PB1 toggles for ever. */
#include <avr/interrupt.h>
#include <avr/io.h>

volatile uint8_t falls;
volatile uint8_t pind;

ISR(INT0_vect)
{
    falls++;
}

int main(void)
{
    DDRB = _BV(PB0) | _BV(PB1);
    PORTD = _BV(PD3) | _BV(PD4);
    EICRA = _BV(ISC01);
    EIMSK = _BV(INT0);
    EIFR = _BV(INTF0);
    sei();
    for (;;) {
        pind = PIND;
        if (pind & _BV(PD2))
            PORTB |= _BV(PB0);
        else
            PORTB &= ~_BV(PB0);
        if (pind & _BV(PD3))
            EIMSK |= _BV(INT0);
        else
            EIMSK &= ~_BV(INT0);
        PINB = _BV(PB1);
    }
}
