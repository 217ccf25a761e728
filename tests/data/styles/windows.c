// Functions that save SREG and restore it, and a stretch without interrupts that another one
// replaces on one path.
#include <avr/interrupt.h>
#include <avr/io.h>

volatile uint16_t ticks;
volatile uint8_t last;

static inline uint8_t enter(void) {
    uint8_t sreg = SREG;
    cli();
    return sreg;
}

static inline void leave(uint8_t sreg) {
    SREG = sreg;
}

ISR(TIMER0_OVF_vect) {
    uint8_t sreg = enter();
    ticks++;
    leave(sreg);
}

int main(void) {
    TCCR0B = 2;
    TIMSK0 = 1;
    sei();
    for (;;) {
        uint8_t sreg = enter();
        uint16_t now = ticks;
        if (now & 1) {
            leave(sreg);
            PORTB++;
            sreg = enter();
        }
        last = now;
        leave(sreg);
    }
}
