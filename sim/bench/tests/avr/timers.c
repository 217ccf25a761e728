/* Small programs about Timer0, 1 and 2, one for each macro. They write what they measure to `result`; `mark` toggles D7, whose
 * edges the test times. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <util/delay.h>

volatile uint16_t result[8];
volatile uint8_t done;

static inline void mark(void)
{
    PIND = _BV(PD7);
}

static inline void wait(volatile uint8_t *flags, uint8_t mask)
{
    while (!(*flags & mask)) {
    }
    *flags = mask;
}

/* Halts both prescalers, so that the next write of GTCCR starts them at 0. */
static inline void hold(void)
{
    GTCCR = _BV(TSM) | _BV(PSRASY) | _BV(PSRSYNC);
}

#if defined PRELOAD
/* A write to a stopped counter counts: 100 clocks of 64 cycles until the overflow of each 8-bit timer, 1000 of 8 of Timer1. */
static void run(void)
{
    TCNT0 = 156;
    hold();
    TCCR0B = _BV(CS01) | _BV(CS00);
    GTCCR = 0;
    mark();
    wait(&TIFR0, _BV(TOV0));
    mark();
    TCCR0B = 0;
    TCNT2 = 156;
    hold();
    TCCR2B = _BV(CS22);
    GTCCR = 0;
    mark();
    wait(&TIFR2, _BV(TOV2));
    mark();
    TCNT1 = 65536 - 1000;
    hold();
    TCCR1B = _BV(CS11);
    GTCCR = 0;
    mark();
    wait(&TIFR1, _BV(TOV1));
    mark();
}
#elif defined STOPPED
/* A counter keeps its value while it stands. */
static void run(void)
{
    TCNT0 = 12;
    TCNT1 = 3456;
    TCNT2 = 78;
    _delay_us(50);
    result[0] = TCNT0;
    result[1] = TCNT1;
    result[2] = TCNT2;
    TCCR0B = TCCR1B = TCCR2B = 1;
    _delay_us(10);
    TCCR0B = TCCR1B = TCCR2B = 0;
    result[3] = TCNT0;
    result[4] = TCNT1;
    _delay_us(50);
    result[5] = result[3] == TCNT0 && result[4] == TCNT1;
}
#elif defined PERIOD1
/* Timer1 in mode PERIOD1 marks each overflow; after the fourth, ICR1 and OCR1A get TOP2. */
static void run(void)
{
    TCCR1A = PERIOD1 & 3;
    TCCR1B = PERIOD1 >> 2 << WGM12;
    ICR1 = 1000;
    OCR1A = 1000;
    TCCR1B |= _BV(CS10);
    for (uint8_t i = 0; i < 12; i++) {
        wait(&TIFR1, _BV(TOV1));
        mark();
        if (i == 3) {
            ICR1 = 500;
            OCR1A = 500;
        }
    }
}
#elif defined MODE7
/* Timer0 with TOP in OCR0A overflows every 80 clocks of 8 cycles. The program marks the first overflow and the 201st. */
ISR(TIMER0_OVF_vect)
{
    if (result[0] == 0 || result[0] == 200) {
        mark();
    }
    result[0]++;
}
static void run(void)
{
    OCR0A = 79;
    TCCR0A = _BV(WGM01) | _BV(WGM00);
    TCCR0B = _BV(WGM02) | _BV(CS01);
    TIMSK0 = _BV(TOIE0);
    sei();
    _delay_ms(10);
    cli();
}
#elif defined CTC
/* CTC sets OCF at TOP and never TOV; with TOP in ICR1 it sets ICF1. */
static void run(void)
{
    OCR0A = OCR2A = 99;
    TCCR0A = _BV(WGM01);
    TCCR2A = _BV(WGM21);
    TCCR0B = TCCR2B = _BV(CS00);
    TCCR1B = _BV(WGM13) | _BV(WGM12);
    ICR1 = 999;
    OCR1A = 5000;
    TCCR1B |= _BV(CS10);
    _delay_ms(2);
    result[0] = TIFR0;
    result[1] = TIFR1;
    result[2] = TIFR2;
}
#elif defined PIN_CHANGE
/* The pin change interrupt sees OC1A (PB1) and OC0A (PD6), each of which toggles every millisecond; INT1 sees OC2B (PD3). */
ISR(PCINT0_vect)
{
    result[0]++;
}
ISR(PCINT2_vect)
{
    result[1]++;
}
ISR(INT1_vect)
{
    result[2]++;
}
static void run(void)
{
    DDRB = _BV(PB1);
    DDRD |= _BV(PD6) | _BV(PD3);
    PCMSK0 = _BV(PCINT1);
    PCMSK2 = _BV(PCINT22);
    PCICR = _BV(PCIE0) | _BV(PCIE2);
    EICRA = _BV(ISC11);
    EIMSK = _BV(INT1);
    OCR1A = 15999;
    TCCR1A = _BV(COM1A0);
    TCCR1B = _BV(WGM12) | _BV(CS10);
    OCR0A = 249;
    TCCR0A = _BV(COM0A0) | _BV(WGM01);
    TCCR0B = _BV(CS01) | _BV(CS00);
    OCR2A = 249;
    OCR2B = 99;
    TCCR2A = _BV(COM2B1) | _BV(WGM21) | _BV(WGM20);
    TCCR2B = _BV(WGM22) | _BV(CS22);
    sei();
    for (uint8_t i = 0; i < 41; i++) {
        _delay_us(250);
        PORTB ^= _BV(PB5) | _BV(PB1); /* PORTB1 does not reach the pin. */
    }
    cli();
}
#elif defined SYNCHRONISED
/* TSM holds the timers at the values that are written, and starts them together. */
static void run(void)
{
    TCCR0B = _BV(CS00);
    TCCR1B = _BV(CS10);
    TCCR2B = _BV(CS20);
    hold();
    TCNT0 = 0;
    TCNT1 = 0;
    TCNT2 = 0;
    _delay_us(20);
    result[0] = TCNT0 + TCNT1 + TCNT2;
    GTCCR = 0;
    _delay_us(5);
    GTCCR = _BV(TSM) | _BV(PSRASY) | _BV(PSRSYNC);
    result[1] = TCNT0;
    result[2] = TCNT1;
    result[3] = TCNT2;
    result[4] = GTCCR;
    GTCCR = 0;
    result[5] = GTCCR;
}
#elif defined PRESCALER
/* The prescaler runs on when a timer starts: with a reset of it, the first clock comes after 1024 cycles, and Timer0 and Timer1,
 * which share it, count together. */
static void run(void)
{
    TCCR0B = _BV(CS02) | _BV(CS00);
    _delay_us(30);
    GTCCR = _BV(PSRSYNC);
    TCNT0 = 0;
    _delay_us(60);
    result[0] = TCNT0;
    _delay_us(5);
    result[1] = TCNT0;
    TCCR1B = _BV(CS12) | _BV(CS10);
    uint8_t first = TCNT0;
    while (TCNT0 == first) {
    }
    result[2] = TCNT1;
    GTCCR = _BV(PSRASY);
    result[3] = GTCCR;
}
#elif defined PWM
/* Fast PWM on OC0B (PD5), updated at BOTTOM only; phase correct PWM on OC2A (PB3); fast PWM on OC2B (PD3). */
static void run(void)
{
    DDRD |= _BV(PD5) | _BV(PD3);
    DDRB = _BV(PB3);
    OCR0B = 63;
    OCR2A = 64;
    OCR2B = 32;
    TCCR0A = _BV(COM0B1) | _BV(WGM01) | _BV(WGM00);
    TCCR2A = _BV(COM2A1) | _BV(COM2B1) | _BV(WGM20);
    TCCR2B = _BV(CS21);
    TCCR0B = _BV(CS01);
    for (uint8_t i = 0; i < 50; i++) {
        _delay_us(77);
        OCR0B = i & 1 ? 63 : 127;
    }
}
#elif defined FORCE
/* FOC toggles the outputs of stopped timers, sets no flag, and reads as 0. PINx shows the compare output and not PORTx. */
static void run(void)
{
    DDRB = _BV(PB1) | _BV(PB3);
    DDRD |= _BV(PD6);
    TCCR0A = _BV(COM0A0);
    TCCR1A = _BV(COM1A0);
    TCCR2A = _BV(COM2A1) | _BV(COM2A0);
    result[0] = PINB & (_BV(PB1) | _BV(PB3));
    TCCR0B = _BV(FOC0A);
    TCCR1C = _BV(FOC1A);
    TCCR2B = _BV(FOC2A);
    result[1] = PINB & (_BV(PB1) | _BV(PB3));
    result[2] = PIND & _BV(PD6);
    result[3] = TIFR0 | TIFR1 | TIFR2 | TCCR0B | TCCR1C | TCCR2B;
    PORTB = 0;
    PORTD = 0;
    result[4] = PINB & (_BV(PB1) | _BV(PB3));
    TCCR1A = 0;
    result[5] = PINB & (_BV(PB1) | _BV(PB3));
    TCCR0A = _BV(COM0A0) | _BV(WGM00);
    TCCR0B = _BV(FOC0A);
    TCCR0A = _BV(COM0A0);
    result[6] = PIND & _BV(PD6);
}
#elif defined MASKED
/* A flag that is set while its interrupt is masked interrupts once when it is unmasked; SBI clears one flag only. */
ISR(TIMER0_COMPA_vect)
{
    result[0]++;
}
static void run(void)
{
    OCR0A = 10;
    OCR0B = 20;
    TCCR0B = _BV(CS00);
    sei();
    _delay_us(40);
    TCCR0B = 0;
    result[1] = TIFR0;
    TIFR0 |= _BV(TOV0); /* SBI */
    result[2] = TIFR0;
    TIFR0 &= ~_BV(TOV0); /* CBI */
    result[3] = TIFR0;
    TIMSK0 = _BV(OCIE0A);
    _delay_us(1);
    result[4] = TIFR0;
    /* More requests than simavr's queue has room for. */
    cli();
    for (uint8_t i = 0; i < 200; i++) {
        TCNT0 = 9;
        TCCR0B = _BV(CS00);
        wait(&TIFR0, _BV(OCF0A));
        TCCR0B = 0;
    }
    sei();
    _delay_us(1);
    result[5] = result[0];
    cli();
}
#elif defined CYCLES
/* A counter that is written by OUT has its new value at the end of the instruction, and IN reads the value at its start: the
 * NOP's clock lies between. LDS reads one cycle later than IN. */
static void run(void)
{
    uint8_t next, after_nop, later, restarted;
    TCCR0B = _BV(CS00);
    asm volatile("ldi r18, 0x30\n out %[tcnt], r18\n in %[next], %[tcnt]\n"
                 "out %[tcnt], r18\n nop\n in %[nop], %[tcnt]\n"
                 "out %[tcnt], r18\n nop\n lds %[later], %[address]\n"
                 "out %[tccr], __zero_reg__\n out %[tcnt], r18\n ldi r18, 1\n out %[tccr], r18\n nop\n in %[restarted], %[tcnt]\n"
                 : [next] "=r"(next), [nop] "=r"(after_nop), [later] "=r"(later), [restarted] "=r"(restarted)
                 : [tcnt] "I"(_SFR_IO_ADDR(TCNT0)), [tccr] "I"(_SFR_IO_ADDR(TCCR0B)), [address] "n"(_SFR_MEM_ADDR(TCNT0))
                 : "r18");
    result[0] = next;
    result[1] = after_nop;
    result[2] = later;
    result[3] = restarted;
}
#elif defined TEMP
/* TCNT1 is read and written as one value while it runs over the edge of its low byte. */
static void run(void)
{
    TCCR1B = _BV(CS10);
    uint16_t before = TCNT1;
    for (uint16_t i = 0; i < 5000; i++) {
        uint16_t now = TCNT1;
        if ((uint16_t)(now - before) > 200) {
            result[0]++;
        }
        before = now;
    }
    TCCR1B = 0;
    TCNT1 = 0xABCD;
    result[1] = TCNT1;
    OCR1A = 0x1234;
    result[2] = OCR1A;
    ICR1 = 0x5678; /* Not in a mode with TOP in ICR1. */
    result[3] = ICR1;
}
#elif defined CAPTURE
/* An edge on ICP1 (PB0), which the program drives itself, copies TCNT1 to ICR1; with the noise canceler four cycles later. */
ISR(TIMER1_CAPT_vect)
{
    result[4]++;
}
static void run(void)
{
    DDRB = _BV(PB0);
    TIMSK1 = _BV(ICIE1);
    TCCR1B = _BV(ICES1) | _BV(CS10);
    sei();
    TCNT1 = 0;
    PORTB = _BV(PB0);
    _delay_us(2);
    result[0] = ICR1;
    TCCR1B = _BV(ICNC1) | _BV(CS10);
    TCNT1 = 0;
    PORTB = 0;
    _delay_us(2);
    result[1] = ICR1;
    TCNT1 = 1000;
    PORTB = _BV(PB0); /* Not the edge that ICES1 selects. */
    _delay_us(2);
    result[2] = ICR1;
    PORTB = 0; /* Too short for the noise canceler. */
    PORTB = _BV(PB0);
    _delay_us(2);
    result[3] = ICR1;
}
#elif defined REFUSED
/* Clocks that the simulator has not. */
static void run(void)
{
    TCCR0B = _BV(CS02) | _BV(CS01);
    TCCR1B = _BV(CS12) | _BV(CS11) | _BV(CS10);
    TCCR2B = _BV(CS20);
    ASSR = _BV(AS2);
    TCNT2 = 0;
    _delay_us(10);
    result[0] = TCNT0 + TCNT1 + TCNT2;
    ASSR = 0;
    _delay_us(10);
    result[1] = TCNT2;
}
#elif defined POWER
/* PRR stops a timer, whose registers can then not be written, and lets it go on where it was. */
static void run(void)
{
    TCCR2B = _BV(CS20);
    _delay_us(3);
    PRR = _BV(PRTIM2);
    TCNT2 = 200;
    _delay_us(50);
    PRR = 0;
    result[0] = TCNT2;
    _delay_us(1);
    result[1] = TCNT2;
}
#elif defined BLOCKED
/* A write of TCNT0 blocks the match of the next clock, so that a preset counter does not match at its start (15.5.2). */
static void run(void)
{
    OCR0A = 50;
    OCR0B = 51;
    TCNT0 = 50;
    TCCR0B = _BV(CS01) | _BV(CS00);
    _delay_us(7);
    result[0] = TIFR0;
    _delay_us(4);
    result[1] = TIFR0;
}
#elif defined SLEEPING
/* The interrupt of a timer wakes the processor; Timer1 with TOP in OCR1A, which is changed while it runs. */
ISR(TIMER1_COMPA_vect)
{
    mark();
    if (++result[0] == 4) {
        OCR1A = 7999;
    }
}
static void run(void)
{
    OCR1A = 15999;
    TCCR1B = _BV(WGM12) | _BV(CS10);
    TIMSK1 = _BV(OCIE1A);
    sei();
    while (result[0] < 10) {
        set_sleep_mode(SLEEP_MODE_IDLE);
        sleep_mode();
    }
    cli();
}
#endif

int main(void)
{
    DDRD = _BV(PD7);
    run();
    done = 1;
    for (;;) {
    }
}
