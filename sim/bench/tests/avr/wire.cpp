/* A sketch with Arduino's library Wire: reads two bytes of device 0x48, and calls device 0x49. */
#include <Arduino.h>
#include <Wire.h>

volatile int16_t temperature;
volatile uint8_t missing;
volatile uint8_t rounds;

void setup()
{
    Wire.begin();
}

void loop()
{
    Wire.beginTransmission(0x48);
    Wire.write(0x00);
    Wire.endTransmission(false);
    Wire.requestFrom(0x48, 2);
    uint8_t high = Wire.read();
    temperature = high << 8 | Wire.read();
    Wire.beginTransmission(0x49);
    missing = Wire.endTransmission();
    rounds++;
}
