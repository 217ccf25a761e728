/* A program with the section .board, which names its board. */
#ifndef CRYSTAL
#define CRYSTAL 8
#endif
#define TEXT_(x) #x
#define TEXT(x) TEXT_(x)

__asm__(".section .board,\"\",@progbits\n"
        ".ascii \"board=uno\\nshield=module\\nmcu=atmega328p\\ncs=D10\\nint=D2\\ncrystal_mhz=" TEXT(CRYSTAL) "\\n\"\n"
        ".ascii \"servo=D9\\nlight=D3\\nbutton=D4\\nsensor=A0\\npower=A4,A5\\n\"\n"
        ".text\n");

int main(void)
{
    for (;;) { }
}
