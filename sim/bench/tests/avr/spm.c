/* A bootloader that executes STEPS, which call the functions below. The test reads the bytes that the steps note. */
#include <avr/boot.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <avr/wdt.h>

/* avr-libc does not define SIGRD for the ATmega168. */
#ifndef SIGRD
#define SIGRD 5
#endif

volatile uint8_t notes[8];
volatile uint8_t noted;
volatile uint8_t interrupts;
volatile uint8_t done;

ISR(SPM_READY_vect)
{
    interrupts++;
    SPMCSR &= ~_BV(SPMIE);
}

static inline void note(uint8_t value) { notes[noted++] = value; }

static inline uint8_t load(uint16_t address) { return pgm_read_byte(address); }

static inline void fill(uint16_t address, uint16_t word) { boot_page_fill(address, word); }

static inline void erase(uint16_t page) { boot_page_erase(page); }

static inline void write(uint16_t page) { boot_page_write(page); }

static inline void enable_rww(void) { boot_rww_enable(); }

static inline void wait(void) { boot_spm_busy_wait(); }

/* Fills the whole page buffer with words that count up. */
static inline void fill_all(uint16_t first)
{
    for (uint8_t i = 0; i < 64; i++) {
        boot_page_fill(2 * i, first + i);
    }
}

/* Erases a page with `nops` between OUT and SPM. */
#define erase_after(nops, page) \
    __asm__ volatile("out %0, %1\n\t" nops "spm" \
                     : : "I"(_SFR_IO_ADDR(SPMCSR)), "r"((uint8_t)(_BV(PGERS) | _BV(SELFPRGEN))), "z"((uint16_t)(page)))

/* Reads the lock bits with `nops` between OUT and LPM. */
#define lock_bits_after(nops) \
    ({ \
        uint8_t bits; \
        __asm__ volatile("out %1, %2\n\t" nops "lpm %0, Z" \
                         : "=r"(bits) \
                         : "I"(_SFR_IO_ADDR(SPMCSR)), "r"((uint8_t)(_BV(BLBSET) | _BV(SELFPRGEN))), "z"((uint16_t)1)); \
        bits; \
    })

static inline void write_eeprom(uint8_t value)
{
    EEDR = value;
    EECR |= _BV(EEMPE);
    EECR |= _BV(EEPE);
}

static inline void move_vectors(void)
{
    MCUCR = _BV(IVCE);
    MCUCR = _BV(IVSEL);
}

int main(void)
{
    STEPS
    done = 1;
    for (;;) { }
}
