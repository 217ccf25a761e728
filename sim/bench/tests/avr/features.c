/* Uses a feature of the chip, one for each macro: FEATURE is a statement. JUMP starts the program again without a reset. */
#include <avr/io.h>
#include <avr/sleep.h>
#include <util/delay.h>

volatile uint8_t starts __attribute__((section(".noinit")));

int main(void)
{
    FEATURE;
    _delay_ms(1);
#ifdef JUMP
    if (++starts != 3) {
        ((void (*)(void))0)();
    }
#endif
    for (;;) {
    }
}
