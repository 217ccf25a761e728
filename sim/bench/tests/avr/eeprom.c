/* Writes 0x5A to EEPROM cell 7, measures how long EEPE stays set, in CPU cycles / 8, and reads the cell.
 * HASTY: reads and writes again during the first write. */
#include <avr/io.h>

volatile uint16_t duration;
volatile uint8_t read_back;
volatile uint8_t done;

static void write(uint8_t value)
{
    EEDR = value;
    EECR |= _BV(EEMPE);
    EECR |= _BV(EEPE);
}

int main(void)
{
    TCCR1B = _BV(CS11);
    EEAR = 7;
    write(0x5A);
    uint16_t start = TCNT1;
#ifdef HASTY
    EECR |= _BV(EERE);
    write(0x33);
#endif
    while (EECR & _BV(EEPE)) { }
    duration = TCNT1 - start;
    EECR |= _BV(EERE);
    read_back = EEDR;
    done = 1;
    for (;;) { }
}
