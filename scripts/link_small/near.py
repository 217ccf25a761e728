"""Loads and stores of variables that are near each other: through Z, where that is free and there are so many that it is worth setting it."""

from link_small.code import Edit
from link_small.effects import Z, pair
from link_small.elf import R_AVR_HI8_LDI, R_AVR_LO8_LDI
from link_small.flow import analyze, labels_of
from link_small.shorten import REACH, addresses_in, through
from link_small.shorten import Z as THROUGH_Z

# To set Z takes two instructions, and each load or store gets shorter by one.
WORTH = 3
LDI_R30, LDI_R31 = 0xE0E0, 0xE0F0


def leaves_z(one):
    """Whether it does nothing with Z, and nobody reads behind it what Z has held before."""
    if one.kind == "call":
        return one.goes_on() and not (one.called.changes | one.live) & pair(Z)
    return one.kind in ("plain", "acts", "branch", "push", "pop") and not (one.does.uses | one.does.sets | one.live) & pair(Z)


def rows(function):
    """The indices of the instructions in a row that leave Z, and of which only the first is ever jumped to."""
    code, labels, row = function.code, labels_of(function.code), []
    for n, one in enumerate(code):
        # Nothing may come between a skip and what it skips.
        may_stay = leaves_z(one) and not (n and code[n - 1].kind == "skip")
        if n in labels or not may_stay:
            yield row
            row = []
        if may_stay:
            row.append(n)
    yield row


def nearest(found):
    """Of loads and stores with their addresses, as many as are within reach of one pointer."""
    groups = ([one for one in found if 0 <= one[1] - base < REACH] for _, base in found)
    return max(groups, key=len, default=[])


def near(object, trial):
    """Whether there was any."""
    addresses = {(section, at): address for section, at, address in addresses_in(object, trial)}
    edit = Edit(object)
    for function in analyze(object).values():
        section = function.section
        for row in rows(function):
            found = [(function.code[n].at, addresses[section, function.code[n].at]) for n in row if (section, function.code[n].at) in addresses]
            while len(group := nearest(found)) >= WORTH:
                lowest, base = min(group, key=lambda one: one[1])
                what, addend = section.relocations[lowest + 2]
                half = [(word, (what & ~0xFF | kind, addend)) for word, kind in ((LDI_R30, R_AVR_LO8_LDI), (LDI_R31, R_AVR_HI8_LDI))]
                edit.insert(section, group[0][0], half)
                for at, address in group:
                    through(edit, section, at, THROUGH_Z, address - base)
                found = [one for one in found if one[0] > group[-1][0]]
    return edit.make()
