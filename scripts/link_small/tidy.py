"""Rewriting with what is known of registers: what they hold (`values`), and whether anybody reads it (`flow`).

A function that has an instruction which skips another (LLVM makes none) is left alone.
"""

from link_small.code import Edit
from link_small.effects import FLAGS, INTERRUPT, REGISTERS, ZERO, bit, effect, fields, named, reading, rename
from link_small.flow import analyze
from link_small.values import R1, Values, comparison_for_equality, copies, number, result

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
    if moved and all(origin == to or held[origin] is not None and held[origin] == held[to] for origin, to in moved):
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


def drop_comparisons(object):
    """Leaves out comparisons with a number for whether they are equal, where Z says so already."""
    functions = analyze(object)
    found = all_values(functions)
    edit = Edit(object)
    for function in tidied(functions):
        for n, one in enumerate(function.code):
            says = comparison_for_equality(one.word) if one.at not in function.section.relocations else None
            if says and says == found[function].zero_says[n] and not one.live & one.does.sets & FLAGS & ~ZERO:
                edit.delete(function.section, one)
    return edit.make()


class Web:
    """A value that is in a register, whichever way the program goes: the instructions that make it, and those where it is there and
    will be read. It is free to be in another register unless it is an argument, a result, or on the stack."""

    def __init__(self, function, leads, register, start):
        self.function, self.register = function, bit(register)
        self.made, self.needed, self.free = set(), set(), True
        todo = [start]
        while todo and self.free:
            n = todo.pop()
            if n in self.needed:
                continue
            self.needed.add(n)
            one = function.code[n]
            # What is there at the beginning is an argument.
            self.free = n > 0 and self.can_change(one)
            if not self.is_made_by(one):
                todo += self.after(n)
            for before in leads[n]:
                other = function.code[before]
                if other.called and other.called.changes & self.register:
                    self.free = False
                elif self.is_made_by(other):
                    self.made.add(before)
                    self.free &= self.can_change(other)
                    todo += self.after(before)
                else:
                    todo.append(before)

    def is_made_by(self, one):
        return not one.called and bool(one.does.sets & ~one.does.uses & self.register)

    def after(self, n):
        following = [following for following in self.function.code[n].next if following < len(self.function.code)]
        return [n for n in following if live_before(self.function, n) & self.register]

    def can_change(self, one):
        if one.called:
            return one.kind == "call" and not self.register & (one.called.uses | one.called.changes)
        return one.kind != "return" and (one.kind not in ("push", "pop") or not self.register & (one.does.uses | one.does.sets))


def merge_copies(object):
    """Leaves out copies of what nobody reads again: the original is in the register of the copy from the beginning, or the copy
    in that of the original, wherever they are used, if the two are never needed at the same time."""
    edit = Edit(object)
    for function in tidied(analyze(object)):
        code, touched = function.code, set()
        leads = [[] for _ in code]
        for n, one in enumerate(code):
            for following in one.next if one.goes_on() else ():
                if following < len(code):
                    leads[following].append(n)
        for n, one in enumerate(code):
            names = dict(copies(one.word))
            if not names or names.keys() & set(names.values()) or one.live & mask(names) or (mask(names) | mask(names.values())) & FIXED:
                continue
            there = {origin: (Web(function, leads, origin, n), to) for origin, to in names.items()}
            new = in_others(function, n, there)
            if new is None:
                following = [after for after in one.next if after < len(code)]
                back = {to: (Web(function, leads, to, following[0]), origin) for origin, to in names.items() if following and live_before(function, following[0]) >> to & 1}
                if len(back) == len(names):
                    new = in_others(function, n, back)
            if new is None or touched & {n, *new}:
                continue
            touched |= {n, *new}
            for place, word in new.items():
                if word != code[place].word and place != n:
                    edit.replace(function.section, code[place].at, word)
            edit.delete(function.section, one)
    return edit.make()


def mask(registers):
    return sum(bit(register) for register in registers)


def live_before(function, n):
    one = function.code[n]
    return function.before(one, one.live)


def in_others(function, copy, webs):
    """The instructions of these webs, by register, with other registers; None if they cannot be."""
    new = {}
    if not all(web.free for web, _ in webs.values()):
        return None
    for n in set().union(*(web.made | web.needed for web, _ in webs.values())):
        one, reads, writes = function.code[n], {}, {}
        for register, (web, to) in webs.items():
            if n in web.needed:
                if live_before(function, n) >> to & 1:
                    return None
                reads[register] = to
            if n in web.made or n in web.needed and not web.is_made_by(one):
                writes[register] = to
                # What is written to the other register while this is needed would be lost.
                if n != copy and one.live >> register & 1 and (one.called.changes if one.called else one.does.sets) >> to & 1:
                    return None
        new[n] = one.word if n == copy or one.called else rename(one.word, reads, writes)
        if new[n] is None:
            return None
    return new
