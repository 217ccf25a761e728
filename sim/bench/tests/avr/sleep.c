/* Sleeps between interrupts of Timer0, one per 1024 us. FOR_GOOD: sleeps with interrupts off instead. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>

volatile uint16_t ticks;
uint8_t preset = 0xC3;

ISR(TIMER0_OVF_vect)
{
    ticks++;
}

int main(void)
{
#ifndef FOR_GOOD
    TCCR0B = _BV(CS01) | _BV(CS00);
    TIMSK0 = _BV(TOIE0);
    sei();
#endif
    for (;;)
        sleep_mode();
}
