/* Converts ADC0, or ADC<CHANNEL>, against AVcc in a loop with a prescaler of 128. Measures the last conversion in CPU cycles / 8. */
#include <avr/io.h>

#ifndef CHANNEL
#define CHANNEL 0
#endif

volatile uint16_t result;
volatile uint16_t duration;

int main(void)
{
    TCCR1B = _BV(CS11);
    ADMUX = _BV(REFS0) | CHANNEL;
    ADCSRA = _BV(ADEN) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
    for (;;) {
        uint16_t before = TCNT1;
        ADCSRA |= _BV(ADSC);
        while (ADCSRA & _BV(ADSC)) { }
        duration = TCNT1 - before;
        result = ADC;
    }
}
