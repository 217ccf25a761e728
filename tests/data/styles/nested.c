// A handler that masks itself and lets others interrupt it, floating point, and a frame on the
// stack whose address is passed on.
#include <avr/interrupt.h>
#include <avr/io.h>

volatile float level;
volatile uint8_t out;

__attribute__((noinline)) static uint8_t hash(const uint8_t *bytes, uint8_t length) {
    uint8_t crc = 0;
    while (length--) {
        crc ^= *bytes++;
        for (uint8_t bit = 0; bit < 8; bit++) crc = crc & 0x80 ? crc << 1 ^ 7 : crc << 1;
    }
    return crc;
}

ISR(TIMER2_COMPA_vect) { out++; }

ISR(TIMER0_COMPA_vect) {
    TIMSK0 = 0;
    sei();
    uint8_t bytes[12];
    for (uint8_t i = 0; i < sizeof bytes; i++) bytes[i] = out + i;
    out = hash(bytes, sizeof bytes);
    cli();
    TIMSK0 = 1 << OCIE0A;
}

int main(void) {
    TCCR0A = 1 << WGM01;
    TCCR0B = 2;
    OCR0A = 250;
    TIMSK0 = 1 << OCIE0A;
    TCCR2A = 1 << WGM21;
    TCCR2B = 1;
    OCR2A = 199;
    TIMSK2 = 1 << OCIE2A;
    sei();
    for (;;) {
        level = level * 0.9f + out;
        if (level > 100) level = level / 3;
    }
}
