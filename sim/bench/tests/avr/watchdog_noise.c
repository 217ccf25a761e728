/* Counts turns of a loop in each of eight time-outs of the watchdog. Interrupts are off: the program polls the watchdog's flag,
 * and clears it by writing a one to it. */
#include <avr/io.h>

volatile uint16_t turns[8];
volatile uint8_t done;

int main(void)
{
    for (uint8_t n = 0; n < 8; n++) {
        WDTCSR = _BV(WDIF) | _BV(WDIE);
        uint16_t count = 0;
        while (!(WDTCSR & _BV(WDIF)))
            count++;
        turns[n] = count;
    }
    done = 1;
    for (;;) { }
}
