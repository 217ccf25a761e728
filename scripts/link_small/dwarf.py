"""Debug information that stays right when code moves: every address in it gets a relocation.

LLVM gives one to where a thing begins and counts the rest from there, and a debugger would see lines, ends of functions, and
variables beside where they are. DWARF 4, which is rustc's for the AVR.
"""

import struct

from link_small.elf import EXECUTED, R_AVR_CALL, Reader, fail

# Of DWARF: attributes, forms, and the size of those that have one.
LOW_PC, HIGH_PC = 0x11, 0x12
UNUSED = b"\xff\x7f"  # the last of the vendors' own attributes
ADDR, DATA1, DATA2, DATA4, DATA8, SDATA, UDATA = 0x01, 0x0B, 0x05, 0x06, 0x07, 0x0D, 0x0F
STRING, STRP, FLAG, FLAG_PRESENT = 0x08, 0x0E, 0x0C, 0x19
BLOCK, BLOCK1, EXPRLOC = 0x09, 0x0A, 0x18
REF_ADDR, REF4, SEC_OFFSET = 0x10, 0x13, 0x17
SIZES = {ADDR: 2, DATA1: 1, DATA2: 2, DATA4: 4, DATA8: 8, STRP: 4, FLAG: 1, FLAG_PRESENT: 0, REF_ADDR: 4, REF4: 4, SEC_OFFSET: 4}


def attribute_value(reader, form):
    """Its value, where it is a number of a fixed size."""
    if form in SIZES:
        return reader.number(SIZES[form])
    if form in (SDATA, UDATA):
        reader.leb128()
    elif form == STRING:
        reader.at = reader.data.index(0, reader.at) + 1
    elif form == BLOCK1:
        reader.skip(reader.number(1))
    elif form in (BLOCK, EXPRLOC):
        reader.skip(reader.leb128())
    else:
        fail(f"there is a form {form:#x} in the debug information")
    return None


class Lines:
    """The line table, rewritten: what adds to the address is an address now."""

    def __init__(self, section):
        self.old, self.new, self.relocations, self.moved = section, bytearray(), {}, {}
        reader = Reader(section.data)
        while reader.more():
            self.unit(reader)
        section.data, section.relocations = self.new, self.relocations

    def unit(self, reader):
        old, begin = reader.at, len(self.new)
        self.moved[old] = begin
        end = reader.number(4) + reader.at
        if reader.number(2) != 4:
            fail("the line table is not of DWARF 4")
        program = reader.number(4) + reader.at
        step, _, _, _, lines, first_special = (reader.number(1) for _ in range(6))
        operands = [None, *(reader.number(1) for _ in range(first_special - 1))]
        reader.at = program
        self.new += self.old.data[old:program]
        while reader.at < end:
            start, code = reader.at, reader.number(1)
            if code >= first_special:  # adds to address and line
                steps, line = divmod(code - first_special, lines)
                if steps:
                    self.advance(steps * step)
                self.new.append(first_special + line)
            elif code == 2:  # advance_pc
                self.advance(reader.leb128() * step)
            elif code == 8:  # const_add_pc
                self.advance((255 - first_special) // lines * step)
            elif code == 9:  # fixed_advance_pc
                self.advance(reader.number(2))
            elif code == 0:  # extended: its size, and what it is
                size = reader.leb128()
                if reader.data[reader.at] == 2:  # set_address
                    self.what, self.addend = self.old.relocations[reader.at + 1]
                    self.advance(0)
                    reader.skip(size)
                else:
                    reader.skip(size)
                    self.new += self.old.data[start : reader.at]
            else:
                for _ in range(operands[code]):
                    reader.leb128()
                self.new += self.old.data[start : reader.at]
        struct.pack_into("<I", self.new, begin, len(self.new) - begin - 4)

    def advance(self, bytes_of_code):
        self.addend += bytes_of_code
        self.relocations[len(self.new) + 3] = self.what, self.addend
        self.new += bytes((0, 3, 2, 0, 0))  # set_address


def read_abbreviations(section):
    """The attributes by number, of each table. The end of a thing, which is a size of four bytes, becomes an address of two, and
    two that mean nothing. Where each table is then, too."""
    tables, moved, new = {}, {}, bytearray()
    reader = Reader(section.data)
    while reader.more():
        copied = reader.at
        moved[copied] = len(new)
        table = tables[copied] = {}
        while number := reader.leb128():
            reader.leb128()  # tag
            reader.skip(1)  # whether it has children
            table[number] = []
            while (attribute := (reader.leb128(), reader.leb128())) != (0, 0):
                table[number].append(attribute)
                if attribute == (HIGH_PC, DATA4):
                    new += section.data[copied : reader.at - 2] + bytes((HIGH_PC, ADDR, *UNUSED, DATA2))
                    copied = reader.at
        new += section.data[copied : reader.at]
    section.data = new
    return tables, moved


def relocate_ends(section, tables):
    reader = Reader(section.data)
    while reader.more():
        end = reader.number(4) + reader.at
        if reader.number(2) != 4:
            fail("the debug information is not DWARF 4")
        _, table = section.relocations[reader.at]
        reader.skip(4)
        if reader.number(1) != SIZES[ADDR]:
            fail("the debug information has addresses of another size")
        while reader.at < end:
            number, low = reader.leb128(), None
            for attribute, form in tables[table][number] if number else ():
                at, value = reader.at, attribute_value(reader, form)
                if attribute == LOW_PC:
                    low = section.relocations.get(at)
                elif (attribute, form) == (HIGH_PC, DATA4) and low:
                    section.relocations[at] = low[0], low[1] + value
                    section.data[at : at + 4] = bytes(4)


def relocate_ranges(section, have_expressions):
    """A list may have a base, which the rest of it is counted from. It becomes 0."""
    reader, base = Reader(section.data), None
    while reader.more():
        at, begin, end = reader.at, reader.number(2), reader.number(2)
        if at not in section.relocations:
            if begin == 0xFFFF:
                base = section.relocations.pop(at + 2)
                continue
            if (begin, end) == (0, 0):
                base = None
                continue
            if base:
                section.relocations[at] = base[0], base[1] + begin
                section.relocations[at + 2] = base[0], base[1] + end
                section.data[at : at + 4] = bytes(4)
        if have_expressions:
            reader.skip(reader.number(2))


def spare_returns(object, section):
    """ld makes a jump of a call with a return after it, and deletes the return unless something refers to it. Nothing does for
    the debugger's sake: what is said of that return is said of what follows it."""
    for where, (what, addend) in section.relocations.items():
        code = object.section_of(what)
        before, _ = code.relocations.get(addend - 4, (0, 0))
        if code.flags & EXECUTED and before & 0xFF == R_AVR_CALL and code.data[addend : addend + 2] == b"\x08\x95":
            section.relocations[where] = what, addend + 2


def relocate_debug_information(object):
    names = (".debug_info", ".debug_abbrev", ".debug_line", ".debug_loc", ".debug_ranges", ".debug_aranges")
    info, abbrev, line, loc, ranges, aranges = sections = [object.section(name) for name in names]
    if not info:
        return
    lines = Lines(line)
    tables, moved = read_abbreviations(abbrev)
    relocate_ends(info, tables)
    for where, (what, addend) in info.relocations.items():
        if object.section_of(what) is line:
            info.relocations[where] = what, lines.moved[addend]
        if object.section_of(what) is abbrev:
            info.relocations[where] = what, moved[addend]
    if loc:
        relocate_ranges(loc, True)
    if ranges:
        relocate_ranges(ranges, False)
    if aranges:  # what .debug_ranges says too, with sizes
        aranges.data, aranges.relocations = b"", {}
    for section in filter(None, sections):
        object.update(section)
    spare_returns_in_debug_information(object)


def spare_returns_in_debug_information(object):
    for section in object.sections:
        if section.name.startswith(".debug_") and section.relocations:
            spare_returns(object, section)
