/* A stack as deep as DEPTH frames of 100 bytes, beside a variable of 300 bytes, twice. With HEAP, a
   heap of so many bytes, and with TASK, a second stack in the variable, as an operating system has
   them. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <stdlib.h>

volatile char important[300];
volatile unsigned char done;
char *volatile heap;

static char __attribute__((noinline)) depth(unsigned char n) {
    volatile char frame[100];
    frame[n] = n;
    return n ? depth(n - 1) + frame[n] : 0;
}

int main(void) {
    important[0] = 1;
#ifdef HEAP
    heap = malloc(HEAP);
#endif
#ifdef TASK
    unsigned int top = (unsigned int)&important[299];
    cli();
    SPL = top & 0xFF;
    SPH = top >> 8;
#endif
    depth(DEPTH);
    done = 1;
    depth(DEPTH);
    done = 2;
    for (;;)
        ;
}
