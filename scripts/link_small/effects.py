"""What each instruction of the AVR reads and writes of registers and flags (AVR Instruction Set Manual, DS40002198).

Sets of registers and flags are numbers: bit n is register n, and the flags of SREG follow from bit 32.
"""

import functools

CARRY, ZERO, NEGATIVE, OVERFLOW, SIGN, HALF, TRANSFER, INTERRUPT = (1 << 32 + n for n in range(8))
REGISTERS = (1 << 32) - 1
FLAGS = 0xFF << 32
EVERYTHING = REGISTERS | FLAGS
# What logic says of its result; what shifts and adiw add to that; and what arithmetic adds to that.
LOGIC = ZERO | NEGATIVE | OVERFLOW | SIGN
SHIFT = LOGIC | CARRY
ARITHMETIC = SHIFT | HALF
X, Y, Z = 26, 28, 30
SREG, SPL, SPH = 0x3F, 0x3D, 0x3E


def bit(register):
    return 1 << register


def pair(register):
    return 3 << register


class Effect:
    """`kind` is "plain" if the instruction does nothing but write registers and flags; "acts" if it does something else too;
    or else how it goes on: branch, skip, jump, call, return, push, pop."""

    def __init__(self, kind, uses=0, sets=0, register=None):
        self.kind, self.uses, self.sets, self.register = kind, uses, sets, register


def low_register(word):
    """The one of 32 that is in bits 0 to 3 and 9."""
    return word & 15 | word >> 5 & 16


def high_register(word):
    """The one of 32 that is in bits 4 to 8."""
    return word >> 4 & 31


def two_registers(word):
    d, r = high_register(word), low_register(word)
    both = bit(d) | bit(r)
    match word >> 10:
        case 0x01 | 0x05:  # cpc, cp
            return Effect("plain", both | (CARRY | ZERO if word >> 10 == 1 else 0), ARITHMETIC)
        case 0x02:  # sbc
            return Effect("plain", both | CARRY | ZERO, ARITHMETIC | bit(d))
        case 0x07:  # adc
            return Effect("plain", both | CARRY, ARITHMETIC | bit(d))
        case 0x03:  # add
            return Effect("plain", both, ARITHMETIC | bit(d))
        case 0x06:  # sub; of a register from itself it is a constant
            return Effect("plain", both if d != r else 0, ARITHMETIC | bit(d))
        case 0x04:
            return Effect("skip", both)
        case 0x08 | 0x0A:  # and, or; of a register with itself they are tests
            return Effect("plain", both, LOGIC | (bit(d) if d != r else 0))
        case 0x09:  # eor
            return Effect("plain", both if d != r else 0, LOGIC | bit(d))
        case 0x0B:  # mov
            return Effect("plain", bit(r), bit(d))
        case 0x27:  # mul
            return Effect("plain", both, pair(0) | CARRY | ZERO)
    return None


def with_constant(word):
    d = bit(16 + (word >> 4 & 15))
    match word >> 12:
        case 0x3:  # cpi
            return Effect("plain", d, ARITHMETIC)
        case 0x4:  # sbci
            return Effect("plain", d | CARRY | ZERO, ARITHMETIC | d)
        case 0x5:  # subi
            return Effect("plain", d, ARITHMETIC | d)
        case 0x6 | 0x7:  # ori, andi
            return Effect("plain", d, LOGIC | d)
        case 0xE:  # ldi
            return Effect("plain", 0, d)
    return None


def memory(word):
    """Loads and stores by pointers, and what else begins with 1001 00."""
    d, store = high_register(word), word & 0x0200
    mode = word & 15
    if mode == 15:
        return Effect("push", bit(d), 0, d) if store else Effect("pop", 0, bit(d), d)
    if mode == 0:  # lds, sts
        return Effect("acts", bit(d), 0, d) if store else Effect("acts", 0, bit(d), d)
    if not store and mode in (4, 5):  # lpm
        return Effect("plain", pair(Z), bit(d) | (pair(Z) if mode == 5 else 0), d)
    pointer = {0xC: X, 0xD: X, 0xE: X, 0x9: Y, 0xA: Y, 0x1: Z, 0x2: Z}.get(mode)
    if pointer is None:
        return None
    moved = pair(pointer) if mode not in (0xC,) else 0
    return Effect("acts", pair(pointer) | (bit(d) if store else 0), moved | (0 if store else bit(d)), d)


def one_register(word):
    """1001 010: those of one register, and the rest."""
    d = bit(high_register(word))
    match word & 15:
        case 0x0:  # com
            return Effect("plain", d, SHIFT | d)
        case 0x1:  # neg
            return Effect("plain", d, ARITHMETIC | d)
        case 0x2:  # swap
            return Effect("plain", d, d)
        case 0x3 | 0xA:  # inc, dec
            return Effect("plain", d, LOGIC | d)
        case 0x5 | 0x6:  # asr, lsr
            return Effect("plain", d, SHIFT | d)
        case 0x7:  # ror
            return Effect("plain", d | CARRY, SHIFT | d)
        case 0xC | 0xD:
            return Effect("jump")
        case 0xE | 0xF:
            return Effect("call")
    if word & 0xFF0F == 0x9408:  # bset, bclr
        flag = 1 << 32 + (word >> 4 & 7)
        return Effect("acts" if flag == INTERRUPT else "plain", 0, flag)
    match word:
        case 0x9508 | 0x9518:
            return Effect("return")
        case 0x95A8 | 0x9588:  # wdr, sleep
            return Effect("acts")
        case 0x95C8:  # lpm
            return Effect("plain", pair(Z), bit(0), 0)
    return None


def in_or_out(word):
    port, d = word & 15 | word >> 5 & 0x30, high_register(word)
    if word & 0x0800:
        return Effect("acts", bit(d), FLAGS if port == SREG else 0, d)
    return Effect("acts", FLAGS if port == SREG else 0, bit(d), d)


@functools.cache
def effect(word):
    """None of an instruction that this program does not know."""
    if word == 0:  # nop
        return Effect("acts")
    if word & 0xFF00 == 0x0100:  # movw
        d, r = word >> 3 & 30, word << 1 & 30
        return Effect("plain", pair(r), pair(d))
    if word & 0xFF00 == 0x0200:  # muls
        return Effect("plain", bit(16 + (word >> 4 & 15)) | bit(16 + (word & 15)), pair(0) | CARRY | ZERO)
    if word & 0xFF00 == 0x0300:  # mulsu, fmul, fmuls, fmulsu
        return Effect("plain", bit(16 + (word >> 4 & 7)) | bit(16 + (word & 7)), pair(0) | CARRY | ZERO)
    if word >> 10 in (*range(0x01, 0x0C), 0x27):
        return two_registers(word)
    if word >> 12 in (0x3, 0x4, 0x5, 0x6, 0x7, 0xE):
        return with_constant(word)
    if word & 0xD000 == 0x8000:  # ldd, std
        d, pointer = high_register(word), pair(Y if word & 8 else Z)
        return Effect("acts", pointer | bit(d), 0, d) if word & 0x0200 else Effect("acts", pointer, bit(d), d)
    if word & 0xFC00 == 0x9000:
        return memory(word)
    if word & 0xFE00 == 0x9400:
        return one_register(word)
    if word & 0xFE00 == 0x9600:  # adiw, sbiw
        d = pair(24 + (word >> 3 & 6))
        return Effect("plain", d, SHIFT | d)
    if word & 0xFC00 == 0x9800:  # cbi, sbic, sbi, sbis
        return Effect("skip" if word & 0x0100 else "acts")
    if word & 0xF000 == 0xB000:
        return in_or_out(word)
    if word & 0xE000 == 0xC000:
        return Effect("call" if word & 0x1000 else "jump")
    if word & 0xF800 == 0xF000:
        return Effect("branch", 1 << 32 + (word & 7))
    if word & 0xF808 == 0xF800:
        d, mask = high_register(word), 1 << high_register(word)
        if word & 0x0400:  # sbrc, sbrs
            return Effect("skip", mask)
        return Effect("plain", mask | TRANSFER, mask, d) if not word & 0x0200 else Effect("plain", mask, TRANSFER)  # bld, bst
    return None


def is_stack_pointer(word):
    return word & 0xF000 == 0xB000 and word & 15 | word >> 5 & 0x30 in (SPL, SPH)


def fields(word):
    """The registers that an instruction names: for each the first bit of its number, or "low" for the one in bits 0 to 3 and 9, its
    size in bits, the register of number 0, and how many registers a number is for."""
    if word & 0xFF00 == 0x0100:
        return (4, 4, 0, 2), (0, 4, 0, 2)
    if word & 0xFF00 == 0x0200:
        return (4, 4, 16, 1), (0, 4, 16, 1)
    if word >> 10 in (*range(0x01, 0x0C), 0x27):
        return (4, 5, 0, 1), ("low", 5, 0, 1)
    if word >> 12 in (0x3, 0x4, 0x5, 0x6, 0x7, 0xE):
        return ((4, 4, 16, 1),)
    if word & 0xFE00 == 0x9600:
        return ((4, 2, 24, 2),)
    does = effect(word)
    if does and (does.register is not None and word != 0x95C8 or word & 0xFE00 == 0x9400 and word & 15 in (0, 1, 2, 3, 5, 6, 7, 10)):
        return ((4, 5, 0, 1),)
    return ()


def named(word, field):
    at, size, first, step = field
    number = low_register(word) if at == "low" else word >> at & (1 << size) - 1
    return first + number * step


def with_named(word, field, register):
    """The instruction with another register there; None if it cannot be."""
    at, size, first, step = field
    number, rest = divmod(register - first, step)
    if rest or not 0 <= number < 1 << size:
        return None
    if at == "low":
        return word & ~0x020F | number & 15 | number << 5 & 0x0200
    return word & ~((1 << size) - 1 << at) | number << at


def translated(registers, names):
    return sum(bit(names.get(n, n)) for n in range(32) if registers >> n & 1) | registers & FLAGS


def rename(word, reads, writes):
    """The instruction with other registers; None if it cannot be. It is said for those that it reads and for those that it writes
    which others take their place."""
    before, places = effect(word), fields(word)
    for first in (writes, reads):
        new = word
        for n, field in enumerate(places):
            register, names = named(word, field), first if n == 0 or not before.uses else reads
            to = names.get(register, register)
            if any(names.get(register + n, register + n) != to + n for n in range(field[3])):
                new = None
            elif new is not None and to != register:
                new = with_named(new, field, to)
        if new is None:
            continue
        after = effect(new)
        if (after.uses, after.sets, after.kind) == (translated(before.uses, reads), translated(before.sets, writes), before.kind):
            return new
    return None


def reading(word, old, new):
    """The instruction with another register where it reads one and does not write it; None if it cannot be."""
    for field in reversed(fields(word)):
        if named(word, field) == old and (changed := with_named(word, field, new)) is not None:
            before, after = effect(word), effect(changed)
            width = (1 << field[3]) - 1
            if before.sets == after.sets and before.kind == after.kind and after.uses & ~before.uses & ~(width << new) == 0 and before.uses != after.uses:
                return changed
    return None
