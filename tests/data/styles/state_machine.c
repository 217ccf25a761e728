// A table of jumps, soft division, and handlers in the usual style of avr-gcc.
#define F_CPU 16000000UL
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/delay.h>

volatile uint8_t step;
volatile uint16_t samples[8], average;
volatile uint32_t ticks;

ISR(TIMER0_COMPA_vect) { ticks++; }

ISR(TIMER1_COMPA_vect) {
    uint32_t sum = 0;
    for (uint8_t i = 0; i < 8; i++) sum += samples[i];
    average = sum / (step + 1);
}

static void advance(void) {
    switch (step) {
        case 0: samples[0] = ticks; step = 1; break;
        case 1: samples[1] = average % 10; step = 2; break;
        case 2: PORTB ^= 1; step = 3; break;
        case 3: samples[3] += 3; step = 4; break;
        case 4: samples[4] = samples[3] * 7; step = 5; break;
        case 5: samples[5] = ticks >> 3; step = 6; break;
        case 6: samples[6]--; step = 7; break;
        default: step = 0;
    }
}

int main(void) {
    DDRB = 1;
    TCCR0A = 1 << WGM01;
    TCCR0B = 3;
    OCR0A = 24;
    TIMSK0 = 1 << OCIE0A;
    TCCR1B = 1 << WGM12 | 1;
    OCR1A = 4001;
    TIMSK1 = 1 << OCIE1A;
    sei();
    for (;;) {
        cli();
        uint32_t now = ticks;
        sei();
        if (now & 1) advance();
        uint8_t saved = SREG;
        cli();
        for (uint8_t i = 0; i < 5; i++) samples[i] ^= i;
        SREG = saved;
        _delay_us(20);
    }
}
