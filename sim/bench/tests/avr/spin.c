/* Counts in SRAM for ever: a busy processor. */
#include <stdint.h>

volatile uint32_t count;

int main(void)
{
    for (;;)
        count++;
}
