"""The instructions of an object, and taking some of them out."""

import bisect
import struct

from link_small.elf import R_AVR_16, Reader, executed


def is_load_or_store(word):
    return word & 0xFC0F == 0x9000  # lds, sts


def is_branch(word):
    return word & 0xF800 == 0xF000  # brbs, brbc


def is_jump(word):
    return word & 0xF000 == 0xC000  # rjmp


def is_skip(word):
    return word & 0xFC00 == 0x1000 or word & 0xFC08 == 0xFC00 or word & 0xFD00 == 0x9900  # cpse; sbrc, sbrs; sbic, sbis


def uses_carry(word):
    # cpc, sbc, adc; sbci; ror; brcs, brcc; in of SREG
    return (word & 0xFC00 in (0x0400, 0x0800, 0x1C00) or word & 0xF000 == 0x4000 or word & 0xFE0F == 0x9407
            or word & 0xF807 == 0xF000 or word & 0xFE0F == 0xB60F)


def instructions(section):
    """Where each is, and its first word."""
    code = Reader(section.data)
    while code.more():
        at, word = code.at, code.number(2)
        yield at, word
        if is_load_or_store(word) or word & 0xFE0C == 0x940C:  # jmp, call
            code.skip(2)


def branch_without_relocation(object):
    """Where one is, if there is one."""
    for section in executed(object):
        for at, word in instructions(section):
            if (is_branch(word) or is_jump(word & ~0x1000)) and at not in section.relocations:  # and rcall
                return f"{section.name}+{at:#x}"
    return None


def loads_and_stores(object):
    """Those of variables: the code, where in it, and the variable (symbol, and what is added to it)."""
    for section in executed(object):
        for at, word in instructions(section):
            what, addend = section.relocations.get(at + 2, (0, 0))
            if is_load_or_store(word) and what & 0xFF == R_AVR_16:
                yield section, at, what, addend


def cut(object, cuts, added={}):
    """Deletes the two bytes at these places of each section, adds the words that are said for others (with their relocations, or None)
    before what is there, and corrects what refers to what is behind them. Who jumps to such a place comes to what was added."""
    sizes = {section: [(at, 2 * len(words)) for at, words in sorted(places.items())] for section, places in added.items()}

    def moved(section, at, with_what_is_there=False):
        grown = sum(size for place, size in sizes.get(section, ()) if place < at or with_what_is_there and place == at)
        return at + grown - 2 * bisect.bisect_left(cuts.get(section, ()), at)

    for section in object.sections:
        relocations = {}
        for where, (what, addend) in section.relocations.items():
            target, value = object.section_of(what), object.value_of(what)
            relocations[moved(section, where, True)] = what, moved(target, value + addend) - moved(target, value)
        for at, words in added.get(section, {}).items():
            for n, (_, relocation) in enumerate(words):
                if relocation:
                    relocations[moved(section, at) + 2 * n] = relocation
        section.relocations = relocations
    for at in range(0, len(object.symbols), 16):
        value, size = struct.unpack_from("<2I", object.symbols, at + 4)
        section = object.section_of(at << 4)
        begin = moved(section, value)
        struct.pack_into("<2I", object.symbols, at + 4, begin, moved(section, value + size) - begin)
    for section in cuts.keys() | added.keys():
        changes = [(at, at + 2, b"") for at in cuts.get(section, ())]
        for at, words in added.get(section, {}).items():
            changes.append((at, at, b"".join(struct.pack("<H", word) for word, _ in words)))
        for begin, end, data in sorted(changes, reverse=True):
            section.data[begin:end] = data


class Edit:
    """New words and deletions in the code of an object, made all at once."""

    def __init__(self, object):
        self.object, self.cuts, self.added = object, {}, {}
        self.changes = 0

    def replace(self, section, at, word):
        struct.pack_into("<H", section.data, at, word)
        self.changes += 1

    def delete(self, section, one):
        places = self.cuts.setdefault(section, set())
        for at in range(one.at, one.at + one.size, 2):
            section.relocations.pop(at, None)
            places.add(at)
        self.changes += 1

    def cut(self, section, at):
        """Two bytes."""
        self.cuts.setdefault(section, set()).add(at)

    def keep(self, section, at):
        self.cuts[section].discard(at)

    def insert(self, section, at, words):
        """Words, each with its relocation or None, before what is there."""
        self.added.setdefault(section, {})[at] = words
        self.changes += 1

    def make(self):
        """Whether there were any."""
        cut(self.object, {section: sorted(places) for section, places in self.cuts.items()}, self.added)
        return bool(self.changes)
