/* A program of a given size: CODE bytes of constants in flash, VARIABLES bytes of variables. */
#include <avr/io.h>
#include <avr/pgmspace.h>

#ifndef CODE
#define CODE 1
#endif
#ifndef VARIABLES
#define VARIABLES 1
#endif

const uint8_t constants[CODE] PROGMEM = {1};
volatile uint8_t variables[VARIABLES];

int main(void)
{
    for (;;)
        for (uint16_t i = 0; i < VARIABLES; i++)
            variables[i] = pgm_read_byte(&constants[i % CODE]);
}
