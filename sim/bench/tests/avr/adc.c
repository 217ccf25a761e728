/* Converts ADC0 against AVcc again and again at a prescaler of 128, and counts CPU cycles / 8 of the latest conversion. */
#include <avr/io.h>

volatile uint16_t result;
volatile uint16_t duration;

int main(void)
{
    TCCR1B = _BV(CS11);
    ADMUX = _BV(REFS0);
    ADCSRA = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
    for (;;) {
        uint16_t before = TCNT1;
        ADCSRA |= _BV(ADSC);
        while (ADCSRA & _BV(ADSC)) { }
        duration = TCNT1 - before;
        result = ADC;
    }
}
