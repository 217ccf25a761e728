/* A program to debug: a loop with nested calls, and an interrupt each 1.024 ms. */
#include <avr/interrupt.h>
#include <avr/io.h>

volatile uint16_t rounds;
volatile uint8_t ticks;

ISR(TIMER0_OVF_vect)
{
    ticks++;
}

__attribute__((noinline)) static void inner(uint8_t depth)
{
    PORTB = depth;
    rounds++;
}

__attribute__((noinline)) static void outer(uint8_t depth)
{
    inner(depth + 1);
    PORTC = depth;
}

int main(void)
{
    TCCR0B = _BV(CS01) | _BV(CS00);
    TIMSK0 = _BV(TOIE0);
    sei();
    for (;;)
        outer(6);
}
