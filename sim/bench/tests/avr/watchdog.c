/* Counts its starts in SRAM that no start-up code clears. The first start arms the watchdog for 64 ms and hangs.
 * After a watchdog reset it hangs too: as it is (so that the watchdog that runs on must end it), or with the watchdog
 * re-armed for 64 ms (REARM), or switched off (DISABLE). */
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
