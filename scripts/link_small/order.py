"""The order of the functions."""

import collections
import random
import struct

from link_small.elf import R_AVR_CALL, RELA, executed

# Orders of functions that are tried.
ORDERS = 12
# How far RCALL reaches; a little less, for what is between functions.
CALL_REACH = 4090


def arrange(object, seed):
    """Puts functions that call each other near each other, for more calls within reach of two bytes: from one order to the next
    that leaves fewer out of reach, by moving a function at a time, as long as there is a better one to be found soon."""
    functions = [section for section in executed(object) if section.name.startswith(".text.")]
    number = {section: n for n, section in enumerate(functions)}
    calls = []
    for section in functions:
        for where, (what, addend) in section.relocations.items():
            # Those of other objects come behind all of these.
            target = number.get(object.section_of(what), len(functions))
            if what & 0xFF == R_AVR_CALL and target != number[section]:
                calls.append((number[section], where, target))
    shorter = collections.Counter(caller for caller, _, _ in calls)
    sizes = [len(section.data) - 2 * shorter[n] for n, section in enumerate(functions)]

    def out_of_reach(order):
        begins, at = [0] * (len(order) + 1), 0
        for n in order:
            begins[n] = at
            at += sizes[n]
        begins[-1] = at
        return sum(abs(begins[caller] + where - begins[target]) > CALL_REACH for caller, where, target in calls)

    chance = random.Random(seed)
    order = list(range(len(functions)))
    best, in_vain = out_of_reach(order), 0
    while best and in_vain < 3000:
        other = order.copy()
        other.insert(chance.randrange(len(order)), other.pop(chance.randrange(len(order))))
        count = out_of_reach(other)
        in_vain = in_vain + 1 if count >= best else 0
        if count <= best:
            best, order = count, other
    return [functions[n] for n in order]


def rearrange(object, functions):
    """Changes places in the table of sections. The linker takes them in the order in which it comes upon them there or upon their
    relocations, so these go along."""
    moved = [one for section in functions for one in (section, section.table) if one]
    places = sorted(one.header for one in moved)
    old = {one: (one.header, bytes(object.elf[one.header : one.header + 40])) for one in moved}
    first = min(section.header for section in object.sections)
    renumbered = {}
    for place, section in zip(places, moved):
        before, header = old[section]
        object.elf[place : place + 40] = header
        renumbered[(before - first) // 40] = (place - first) // 40
    for section in object.sections:
        if section.type == RELA:
            number = (section.header - first) // 40
            header = first + 40 * renumbered.get(number, number)
            index = struct.unpack_from("<I", object.elf, header + 28)[0]
            struct.pack_into("<I", object.elf, header + 28, renumbered.get(index, index))
    table = object.section(".symtab")
    offset, size = struct.unpack_from("<2I", object.elf, table.header + 16)
    for at in range(offset + 14, offset + size, 16):
        index = struct.unpack_from("<H", object.elf, at)[0]
        struct.pack_into("<H", object.elf, at, renumbered.get(index, index))
