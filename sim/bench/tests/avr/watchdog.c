/* Counts its starts in SRAM that the start-up code does not clear. The first start arms the watchdog for 64 ms and hangs. After
 * a watchdog reset the program hangs again. The watchdog, which is still on, resets it after the shortest time-out.
 * REARM: arms the watchdog for 64 ms after a reset. DISABLE: switches it off after a reset. */
#include <avr/io.h>
#include <avr/wdt.h>

volatile uint8_t starts __attribute__((section(".noinit")));
volatile uint8_t mcusr;

int main(void)
{
    mcusr = MCUSR;
    if (mcusr & _BV(PORF)) {
        starts = 0;
        MCUSR = 0;
        wdt_enable(WDTO_60MS);
    }
#ifdef REARM
    MCUSR = 0;
    wdt_enable(WDTO_60MS);
#endif
#ifdef DISABLE
    if (mcusr & _BV(WDRF)) {
        MCUSR = 0;
        wdt_disable();
    }
#endif
    starts++;
    for (;;) { }
}
