/* D8 follows D7, which has its pull-up. D5 is high while the voltage at A1 is above 2 V. D6 has a tone: it toggles each
   millisecond while D4 is low. */
#include <avr/io.h>
#include <util/delay.h>

int main(void)
{
    DDRB = _BV(PB0);
    DDRD = _BV(PD5) | _BV(PD6);
    PORTD = _BV(PD7) | _BV(PD4);
    ADMUX = _BV(REFS0) | 1;
    ADCSRA = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
    for (;;) {
        if (PIND & _BV(PD7))
            PORTB |= _BV(PB0);
        else
            PORTB &= ~_BV(PB0);
        ADCSRA |= _BV(ADSC);
        while (ADCSRA & _BV(ADSC))
            ;
        if (ADC > 2 * 1024 / 5)
            PORTD |= _BV(PD5);
        else
            PORTD &= ~_BV(PD5);
        if (!(PIND & _BV(PD4)))
            PIND = _BV(PD6);
        _delay_us(880);
    }
}
