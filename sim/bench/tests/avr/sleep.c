/* Sleeps between interrupts. Without a macro those of Timer0, one per 1024 us. FOR_GOOD: sleeps with interrupts off instead.
 * MODE: the sleep mode. WATCHDOG: interrupts of the watchdog, one per 64 ms, too. INT0_SENSE: INT0, too. PIN_CHANGE: changes of
 * PD4, too. CONVERSION: with the interrupt of the ADC. `rounds` counts the sleeps, and `moved` the clocks of Timer1 in the last one. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

volatile uint16_t ticks;
volatile uint16_t rounds;
volatile uint16_t moved;
volatile uint16_t others;

ISR(TIMER0_OVF_vect)
{
    ticks++;
}

ISR(WDT_vect)
{
    others++;
}

ISR(INT0_vect)
{
    others++;
    EIMSK = 0;
}

ISR(PCINT2_vect)
{
    others++;
}

ISR(ADC_vect)
{
    others++;
}

int main(void)
{
#ifndef FOR_GOOD
    TCCR0B = _BV(CS01) | _BV(CS00);
    TIMSK0 = _BV(TOIE0);
    TCCR1B = _BV(CS10);
#ifdef WATCHDOG
    MCUSR = 0;
    WDTCSR = _BV(WDCE) | _BV(WDE);
    WDTCSR = _BV(WDIE) | WDTO_60MS;
#endif
#ifdef INT0_SENSE
    EICRA = INT0_SENSE;
    EIMSK = _BV(INT0);
#endif
#ifdef PIN_CHANGE
    PCMSK2 = _BV(PCINT20);
    PCICR = _BV(PCIE2);
#endif
#ifdef CONVERSION
    ADCSRA = _BV(ADEN) | _BV(ADIE) | 7;
#endif
    sei();
#endif
#ifdef MODE
    set_sleep_mode(MODE);
#endif
    for (;;) {
        uint16_t before = TCNT1;
        sleep_mode();
        moved = TCNT1 - before;
        rounds++;
    }
}
