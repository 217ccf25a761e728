"""Rewriting with what is known of registers: what they hold (`values`), and whether anybody reads it (`flow`).

A function that has an instruction which skips another (LLVM makes none) is left alone.
"""

from link_small.code import Edit
from link_small.effects import FLAGS, INTERRUPT, REGISTERS, bit, effect, fields, named, reading, rename
from link_small.flow import analyze
from link_small.values import R1, Values, copies, is_clear, number, result

# Instructions with a constant for those of two registers: cp, sub, sbc, and, or, mov.
WITH_CONSTANT = {0x05: 0x3000, 0x06: 0x5000, 0x02: 0x4000, 0x08: 0x7000, 0x0A: 0x6000, 0x0B: 0xE000}

# Registers that stay what they are: r0 and r1, which mul writes, and Y.
FIXED = 0x30000003


def tidied(functions):
    return [function for function in functions.values() if not any(one.kind == "skip" for one in function.code)]


def all_values(functions):
    """What is known of each function. r1 is zero wherever a function begins, if it is wherever one is called and returns."""
    found = {function: Values(function, not function.section.name.startswith(".text.__vector_")) for function in functions.values()}
    if all(values.keeps_zero for values in found.values()):
        return found
    return {function: Values(function, False) for function in functions.values()}


def drop_the_dead(object):
    """Leaves out what writes registers and flags that nobody reads."""
    edit = Edit(object)
    for function in tidied(analyze(object)):
        for one in function.code:
            if one.kind == "plain" and not one.live & one.does.sets:
                edit.delete(function.section, one)
    return edit.make()


def with_constant(word, value):
    d, _ = (named(word, field) for field in fields(word))
    if word >> 10 not in WITH_CONSTANT or d < 16:
        return None
    return WITH_CONSTANT[word >> 10] | (d - 16) << 4 | value & 15 | value << 4 & 0x0F00


def better(one, held, relocation):
    """An instruction that does the same, and reads what may make another unnecessary; 0 if none is needed."""
    word, does = one.word, one.does
    moved = copies(word)
    if moved and all(held[origin] is not None and held[origin] == held[to] for origin, to in moved):
        return 0
    written = does.sets & REGISTERS
    if does.kind == "plain" and written and not written & written - 1 and not one.live & does.sets & FLAGS:
        register = written.bit_length() - 1
        left = result(one, held, relocation)
        if left is not None and left == held[register]:
            return 0
        if word >> 10 == 0x0A:  # or with zero
            to, other = (named(word, field) for field in fields(word))
            if held[to] == number(0) and to != other:
                return 0x2C00 | word & 0x03FF
            if held[other] == number(0) and to != other:
                return 0
    if word >> 10 in WITH_CONSTANT and not relocation:
        _, other = (named(word, field) for field in fields(word))
        value = held[other]
        if value and value[0] == "number" and value[1] and (new := with_constant(word, value[1])):
            return new
    for register in range(32):
        if not does.uses >> register & 1 or held[register] is None:
            continue
        to = R1 if held[register] == held[R1] else held[register][2] if held[register][0] == "copy" else register
        if held[to] != held[register]:
            to = held.index(held[register])
        if to == register or held[register][0] != "copy" and to != R1:
            continue
        if (new := reading(word, register, to)) is not None:
            # Of a pair, both.
            extra = effect(new).uses & ~does.uses
            gone = does.uses & ~effect(new).uses
            if extra.bit_count() == 2 or gone.bit_count() == 2:
                old, new_pair = register & ~1, to & ~1
                if register & 1 != to & 1 or held[old] is None or held[old] != held[new_pair] or held[old + 1] is None or held[old + 1] != held[new_pair + 1]:
                    continue
            return new
        # A test: both are the same one.
        if word >> 10 in (0x08, 0x0A) and not does.sets & REGISTERS and (new := rename(word, {register: to}, {})) is not None:
            return new
    return None


def read_the_original(object):
    """Reads registers that others were copied from, where they hold the same, and constants from the instruction; leaves out
    what writes to a register what it holds already. No register holds anything else than before at any place."""
    functions = analyze(object)
    found = all_values(functions)
    edit = Edit(object)
    for function in tidied(functions):
        values = found[function]
        for n, one in enumerate(function.code):
            held = values.before[n]
            if held is None or one.kind not in ("plain", "acts") or one.does.sets & INTERRUPT and one.kind == "plain":
                continue
            new = better(one, held, function.section.relocations.get(one.at))
            if new == 0:
                edit.delete(function.section, one)
            elif new is not None and new != one.word:
                edit.replace(function.section, one.at, new)
    return edit.make()


def merge_copies(object):
    """Leaves out copies of what nobody reads again: where the original was made in the same stretch of code, it is made in the
    register that it would be copied to; or else what follows uses the original. Between them nothing may use the other register."""
    edit = Edit(object)
    for function in tidied(analyze(object)):
        code = function.code
        labels = {following for n, one in enumerate(code) for following in one.next if following != n + 1}
        touched = set()
        for n, one in enumerate(code):
            names = dict(copies(one.word))
            if not names or names.keys() & set(names.values()) or one.live & mask(names) or (mask(names) | mask(names.values())) & FIXED:
                continue
            for new in made_there(function, n, names, labels), used_as_it_was(function, n, {to: origin for origin, to in names.items()}, labels):
                if new is None:
                    continue
                stretch = set(range(min(n, *new), max(n, *new) + 1)) if new else {n}
                if touched & stretch:
                    continue
                touched |= stretch
                for place, word in new.items():
                    if word != code[place].word:
                        edit.replace(function.section, code[place].at, word)
                edit.delete(function.section, one)
                break
    return edit.make()


def mask(registers):
    return sum(bit(register) for register in registers)


def live_before(function, n):
    one = function.code[n]
    return function.before(one, one.live)


def elsewhere(function, n):
    """What is live where the instruction may jump to."""
    live = 0
    for following in function.code[n].next:
        if following != n + 1:
            live |= live_before(function, following)
    return live


def stands_in_the_way(function, n, registers):
    """Whether these registers cannot change places for others across this instruction."""
    one = function.code[n]
    if one.called and one.kind == "call":
        return registers & (one.called.uses | one.called.changes)
    return one.kind not in ("plain", "acts", "branch") or registers & elsewhere(function, n)


def made_there(function, n, names, labels):
    """The instructions between where the originals are made and their copy, with the registers of the copy; None if that cannot
    be."""
    new, names, place = {}, dict(names), n
    while names:
        if place in labels or place == 0:
            return None
        place -= 1
        one = function.code[place]
        if stands_in_the_way(function, place, mask(names) | mask(names.values())):
            return None
        if one.called:
            new[place] = one.word
            continue
        # Those that begin here. The instruction may still read what is in the other register before.
        made = {origin for origin in names if one.does.sets & ~one.does.uses & bit(origin)}
        rest = {origin: to for origin, to in names.items() if origin not in made}
        if one.does.sets & mask(names.values()) or one.does.uses & mask(rest.values()):
            return None
        new[place] = rename(one.word, rest, names)
        if new[place] is None:
            return None
        names = rest
    return new


def used_as_it_was(function, n, names, labels):
    """The instructions that follow a copy, with the registers that were copied, as far as the copy is used; None if that cannot be."""
    new, names, place = {}, dict(names), n
    while True:
        place += 1
        if place == len(function.code):
            return None
        one = function.code[place]
        names = {to: origin for to, origin in names.items() if live_before(function, place) & bit(to)}
        if not names:
            return new
        if place in labels or stands_in_the_way(function, place, mask(names) | mask(names.values())):
            return None
        new[place] = one.word
        if one.called:
            continue
        ended = {to for to in names if one.does.sets & ~one.does.uses & bit(to)}
        rest = {to: origin for to, origin in names.items() if to not in ended}
        if one.does.sets & mask(names.values()):
            return None
        new[place] = rename(one.word, names, rest)
        if new[place] is None:
            return None
        names = rest
