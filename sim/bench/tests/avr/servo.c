/* Servo pulses on OC1B, or with ON_OC1A on OC1A, like the node's: fast PWM, TOP in ICR1, 0.5 us per tick. The period is 5 ms to
 * keep the test short. The program changes the pulse between 1000 and 4000 ticks at times that are independent of the period. */
#include <avr/io.h>
#include <util/delay.h>

#ifdef ON_OC1A
#define PIN PB1
#define COM COM1A1
#define OCR OCR1A
#else
#define PIN PB2
#define COM COM1B1
#define OCR OCR1B
#endif

volatile uint16_t ticks = 1000;

int main(void)
{
    DDRB = _BV(PIN);
    TCCR1A = _BV(COM) | _BV(WGM11);
    TCCR1B = _BV(WGM13) | _BV(WGM12);
    ICR1 = 9999;
    OCR = 999;
    TCCR1B |= _BV(CS11);
    for (;;) {
        _delay_us(1237);
        ticks = ticks == 4000 ? 1000 : ticks + 500;
        OCR = ticks - 1;
    }
}
