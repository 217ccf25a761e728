/* A sketch whose calls need more stack than there is RAM: they overwrite an array. */
#include <Arduino.h>

char important[300];

static int __attribute__((noinline)) depth(int n)
{
    volatile char frame[200];
    frame[0] = n;
    return n ? depth(n - 1) + frame[0] : 0;
}

void setup()
{
    for (int i = 0; i < 300; i++) important[i] = 7;
    Serial.begin(115200);
    Serial.println(depth(DEPTH));
}

void loop() { }
