"""One instruction for two or more: for copies of a register pair, small numbers added to one, and branches that skips can do."""

from link_small.code import Edit
from link_small.effects import ARITHMETIC, HALF, bit, fields, named
from link_small.elf import R_AVR_13_PCREL
from link_small.flow import analyze, labels_of
from link_small.jumps import JUMP
from link_small.tidy import all_values, live_before, tidied
from link_small.values import R1, number

MOV, ADIW, SBIW, MOVW = 0x0B, 0x9600, 0x9700, 0x0100
CPSE, SBRC, SBRS = 0x1000, 0xFC00, 0xFE00
# How far apart two copies may be.
APART = 8


def copy_pairs(object):
    """Two copies that are a register pair's become one, where either is, if nothing between them is in the way."""
    edit = Edit(object)
    for function in tidied(analyze(object)):
        code, labels, done = function.code, labels_of(function.code), set()
        for n, one in enumerate(code):
            if one.word >> 10 != MOV or n in done:
                continue
            to, origin = (named(one.word, field) for field in fields(one.word))
            if (to ^ origin) & 1 or to == origin:
                continue
            between_uses = between_sets = 0
            for m in range(n + 1, min(n + APART, len(code))):
                other = code[m]
                if m in labels or m in done or other.kind not in ("plain", "acts"):
                    break
                if other.word >> 10 == MOV and [named(other.word, field) for field in fields(other.word)] == [to ^ 1, origin ^ 1]:
                    here = not (between_uses | between_sets) & bit(to ^ 1) and not between_sets & bit(origin ^ 1) and origin ^ 1 != to
                    there = not (between_uses | between_sets) & bit(to) and not between_sets & bit(origin) and to ^ 1 != origin
                    if here or there:
                        stays, goes = (one, other) if here else (other, one)
                        edit.replace(function.section, stays.at, MOVW | to >> 1 << 4 | origin >> 1)
                        edit.delete(function.section, goes)
                        done |= set(range(n, m + 1))
                    break
                between_uses |= other.does.uses
                between_sets |= other.does.sets
    return edit.make()


def add_to_pairs(object):
    """SUBI and SBCI of a small number, or the negative of one, become SBIW or ADIW. A half carry, or for ADIW any flag, must not be
    read: these are others then."""
    edit = Edit(object)
    for function in tidied(analyze(object)):
        code, labels, relocations = function.code, labels_of(function.code), function.section.relocations
        for n, (low, high) in enumerate(zip(code, code[1:])):
            if low.word >> 12 != 5 or high.word >> 12 != 4 or n + 1 in labels or low.at in relocations or high.at in relocations:
                continue
            register = named(low.word, fields(low.word)[0])
            if register not in (24, 26, 30) or named(high.word, fields(high.word)[0]) != register + 1:
                continue
            value = (high.word & 15 | high.word >> 4 & 0xF0) << 8 | low.word & 15 | low.word >> 4 & 0xF0
            for word, small, other_flags in (SBIW, value, HALF), (ADIW, -value & 0xFFFF, ARITHMETIC):
                if 0 < small < 64 and not high.live & other_flags:
                    edit.replace(function.section, low.at, word | (register - 24 >> 1) << 4 | small & 0x0F | (small & 0x30) << 2)
                    edit.delete(function.section, high)
                    break
    return edit.make()


def skip_for(one, branch, held):
    """The skip that does what a comparison and a branch over one instruction do, if there is one."""
    flag, if_set = branch.word & 7, not branch.word & 0x0400
    places = [named(one.word, field) for field in fields(one.word)]
    mask = one.word & 15 | one.word >> 4 & 0xF0
    is_test = one.word >> 10 in (0x08, 0x0A) and places[0] == places[1]
    if one.word >> 12 == 7 and flag == 1 and mask.bit_count() == 1:  # andi
        return (SBRC if if_set else SBRS) | places[0] << 4 | mask.bit_length() - 1
    if is_test and flag == 2:
        return (SBRS if if_set else SBRC) | places[0] << 4 | 7
    if flag == 1 and if_set:
        if one.word >> 10 == 0x05:  # cp
            return CPSE | one.word & 0x03FF
        zero = one.word >> 12 == 3 and mask == 0 or is_test
        if zero and held and held[R1] == number(0):
            return CPSE | places[0] << 4 | 1
    return None


def skip(object):
    """A comparison and a branch over one instruction become a skip; a copy that was made for the comparison goes. So does the copy
    where the branch goes further: then a skip is over a jump. For the last, because nothing else is done to functions with skips."""
    functions = analyze(object)
    found = all_values(functions)
    edit = Edit(object)
    for function in tidied(functions):
        code, section, labels = function.code, function.section, labels_of(function.code)
        done = -1
        for n, (one, branch) in enumerate(zip(code, code[1:])):
            if n <= done or branch.kind != "branch" or n + 1 in labels or one.kind != "plain" or one.at in section.relocations or n + 2 >= len(code):
                continue
            over = branch.next[0] == n + 3
            if over and code[n + 2].kind == "call" and n + 3 < len(code) and code[n + 3].kind == "return":
                # ld makes one jump of the two.
                continue
            if (live_before(function, branch.next[0]) | live_before(function, n + 2)) & one.does.sets:
                continue
            held = found[function].before[n]
            word = skip_for(one, branch, held)
            copy = code[n - 1] if n and n not in labels and n - 1 > done else None
            origin = None
            if copy and copy.word >> 10 == MOV and one.word >> 12 == 7:
                to, origin = (named(copy.word, field) for field in fields(copy.word))
                if to != named(one.word, fields(one.word)[0]):
                    origin = None
            if over and word is not None:
                if origin is not None:
                    word = word & ~0x01F0 | origin << 4
                    edit.delete(section, copy)
                edit.replace(section, one.at, word)
                edit.delete(section, branch)
                done = n + 2
            elif word is not None and origin is not None:
                what, addend = section.relocations[branch.at]
                edit.delete(section, copy)
                edit.replace(section, one.at, (word ^ 0x0200) & ~0x01F0 | origin << 4)
                edit.replace(section, branch.at, JUMP)
                section.relocations[branch.at] = what & ~0xFF | R_AVR_13_PCREL, addend
                done = n + 1
    return edit.make()
