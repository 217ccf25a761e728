/* Counts in SRAM for ever. */
#include <stdint.h>

volatile uint32_t count;

int main(void)
{
    for (;;)
        count++;
}
