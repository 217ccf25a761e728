// Enable bits that are changed by read-modify-write, SREG that is written as a register, and a loop
// whose bound is a value of RAM with a mask.
#include <avr/interrupt.h>
#include <avr/io.h>

volatile uint8_t bytes[10], count;

ISR(TIMER2_OVF_vect) {
    TIMSK2 &= ~(1 << TOIE2);
    SREG |= 0x80;
    for (uint8_t i = 0; i < 10; i++) bytes[i] += i * count;
    cli();
    TIMSK2 |= 1 << TOIE2;
}

ISR(TIMER0_OVF_vect) {
    count++;
    if (count > 200) {
        count = 0;
        uint8_t left = bytes[3] & 15;
        do PORTB ^= 1;
        while (left--);
    }
}

int main(void) {
    TCCR2B = 1;
    TIMSK2 = 1 << TOIE2;
    TCCR0B = 1;
    TIMSK0 = 1 << TOIE0;
    sei();
    for (;;) {
        TIMSK0 = 0;
        for (uint8_t i = 0; i < 4; i++) bytes[i] = count >> i;
        TIMSK0 = 1 << TOIE0;
    }
}
