"""What registers hold: constants, and the same as another register.

A forward analysis of each function. What a register holds is one of

* a number, or a half of an address (its relocation);
* a name that a copy has given to what it copied. Registers with the same name hold the same;
* None: nothing is known.
"""

from link_small.effects import REGISTERS, ZERO, bit, named
from link_small.effects import fields as fields_of

R1 = 1


def number(value):
    return ("number", value)


def copies(word):
    """The registers that an instruction copies, as pairs of from and to."""
    if word >> 10 == 0x0B or word & 0xFF00 == 0x0100:
        (to, origin) = (named(word, field) for field in fields_of(word))
        return [(origin + n, to + n) for n in range(1 if word >> 10 == 0x0B else 2)]
    return []


def constant(word):
    """The number in an instruction that has one of 8 bits."""
    return word & 15 | word >> 4 & 0xF0


def is_clear(word):
    return word >> 10 in (0x09, 0x06) and len({named(word, field) for field in fields_of(word)}) == 1


def result(one, held, relocation):
    """What an instruction that writes one register leaves there, where that is known."""
    word = one.word
    if is_clear(word):
        return number(0)
    if word >> 12 == 0xE:
        return ("address", *relocation) if relocation else number(constant(word))
    if word >> 12 == 0x7 and not relocation and constant(word) == 0:
        return number(0)
    if word >> 10 == 0x0A:
        to, other = (named(word, field) for field in fields_of(word))
        for this, that in ((to, other), (other, to)):
            if held[this] == number(0):
                return held[that]
    return None


def comparison_for_equality(word):
    """The register and the number that a comparison, or a test, compares."""
    if word >> 12 == 0x3:  # cpi
        return named(word, fields_of(word)[0]), number(constant(word))
    if word >> 10 in (0x08, 0x0A) and len({named(word, field) for field in fields_of(word)}) == 1:
        return named(word, fields_of(word)[0]), number(0)
    return None


def says_whether_it_is_zero(word):
    """Whether Z is set if, and only if, the register that the instruction writes becomes zero: add, adc, sub, and, eor, or; subi, ori,
    andi; com, neg, inc, dec, asr, lsr, ror. Of sbc, sbci, and those of pairs it is about more."""
    return (word >> 10 in (0x03, 0x06, 0x07, 0x08, 0x09, 0x0A) or word >> 12 in (0x5, 0x6, 0x7)
            or word & 0xFE00 == 0x9400 and word & 15 in (0x0, 0x1, 0x3, 0x5, 0x6, 0x7, 0xA))


class Values:
    def __init__(self, function, zero_in_r1):
        self.function, self.zero_in_r1 = function, zero_in_r1
        # What registers hold before each instruction, and what Z says there.
        self.before = [None] * len(function.code)
        self.zero_says = [None] * len(function.code)
        self.keeps_zero = True
        start = [None] * 32
        if zero_in_r1:
            start[R1] = number(0)
        self.states = {0: (start, None)}
        self.solve()

    def solve(self):
        todo = {0}
        code = self.function.code
        while todo:
            n = min(todo)
            todo.discard(n)
            held, equal = self.states[n]
            self.before[n], self.zero_says[n] = list(held), equal
            held = list(held)
            one = code[n]
            equal = self.step(n, one, held, equal)
            if not one.goes_on():
                continue
            for place, following in enumerate(one.next):
                if following >= len(code):
                    continue
                on_the_way = held
                # breq taken, or brne not taken: the register is what it has been compared with.
                if equal and one.kind == "branch" and one.does.uses == ZERO and place == (one.word >> 10 & 1):
                    register, value = equal
                    name = held[register]
                    if name is None or name[0] == "copy":
                        on_the_way = [value if this == register or name and it == name else it for this, it in enumerate(held)]
                old = self.states.get(following)
                new = on_the_way, equal
                if old is not None:
                    new = [a if a == b else None for a, b in zip(old[0], on_the_way)], equal if old[1] == equal else None
                if old is None or new[0] != old[0] or new[1] != old[1]:
                    self.states[following] = list(new[0]), new[1]
                    todo.add(following)

    def step(self, n, one, held, equal):
        """Brings what is held up to date. What Z says then, if it is set: a register and what it holds."""
        does, word = one.does, one.word
        if one.called or one.kind == "return" and self.zero_in_r1:
            if held[R1] != number(0):
                self.keeps_zero = False
        if one.called:
            for register in range(32):
                if one.called.changes >> register & 1:
                    held[register] = None
            if self.zero_in_r1:
                held[R1] = number(0)
            return None
        relocation = self.function.section.relocations.get(one.at)
        moved = copies(word)
        if moved:
            # Names that the same instruction has given before are of something else now.
            for register in range(32):
                if held[register] and held[register][:2] == ("copy", n):
                    held[register] = None
            for origin, to in moved:
                if held[origin] is None:
                    held[origin] = ("copy", n, origin)
            for to, it in [(to, held[origin]) for origin, to in moved]:
                held[to] = it
        elif does.sets & REGISTERS:
            left = result(one, held, relocation) if does.sets & REGISTERS == bit((does.sets & REGISTERS).bit_length() - 1) else None
            for register in range(32):
                if does.sets >> register & 1:
                    held[register] = left
        if equal and does.sets & bit(equal[0]):
            equal = None
        if does.sets & ZERO:
            equal = comparison_for_equality(word) if not relocation else None
            if says_whether_it_is_zero(word):
                equal = named(word, fields_of(word)[0]), number(0)
        return equal
