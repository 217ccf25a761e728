// A handler that sorts a table on its stack, with loops whose bounds depend on each other, and a
// function with arguments on the stack.
#include <avr/interrupt.h>
#include <avr/io.h>

volatile uint16_t words[40];
volatile uint8_t shift;

__attribute__((noinline)) static uint32_t mix(uint32_t a, uint32_t b, uint32_t c, uint16_t d,
                                              uint8_t e, uint8_t f) {
    return (a << (e & 7)) ^ (b >> (f & 15)) ^ c * d;
}

ISR(TIMER1_OVF_vect) {
    uint16_t table[40];
    for (uint8_t i = 0; i < 40; i++) table[i] = words[39 - i];
    for (uint8_t i = 0; i < 39; i++) {
        for (uint8_t k = 0; k < 39 - i; k++) {
            if (table[k] > table[k + 1]) {
                uint16_t before = table[k];
                table[k] = table[k + 1];
                table[k + 1] = before;
            }
        }
    }
    for (uint16_t i = 0; i < 300; i++) words[i % 40] += table[i % 40];
    shift = mix(table[0], table[1], table[2], table[3], shift, table[4]);
}

int main(void) {
    TCCR1B = 2;
    TIMSK1 = 1 << TOIE1;
    sei();
    for (uint16_t seed = 1;;) {
        seed = seed * 25173 + 13849;
        words[seed % 40] = seed;
    }
}
