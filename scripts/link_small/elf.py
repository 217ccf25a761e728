"""Relocatable objects of the AVR: what is in them, and writing it back."""

import struct
import sys

# Of ELF for the AVR.
MAY_BE_RELAXED = 0x80  # in e_flags
RELA, NOBITS = 4, 8
EXECUTED = 0x4
FUNCTION = 2
R_AVR_NONE, R_AVR_7_PCREL, R_AVR_13_PCREL, R_AVR_16, R_AVR_LO8_LDI, R_AVR_HI8_LDI, R_AVR_CALL = 0, 2, 3, 4, 6, 7, 18


def fail(why):
    sys.exit(f"link-small: {why}")


class Section:
    """Its data, and its relocations: where, and to what (symbol and type, what is added to the symbol)."""

    def __init__(self, elf, header):
        self.header, self.relocations, self.table = header, {}, None
        self.name, self.type, self.flags, _, offset, size, self.link, self.of, _, _ = struct.unpack_from("<10I", elf, header)
        self.data = bytearray(elf[offset : offset + size]) if self.type != NOBITS else bytearray()


class Object:
    """A relocatable ELF file of 32 bits."""

    def __init__(self, elf):
        self.elf = bytearray(elf)
        headers, self.flags = struct.unpack_from("<2I", elf, 32)
        count, names = struct.unpack_from("<2H", elf, 48)
        self.sections = [Section(elf, headers + 40 * index) for index in range(count)]
        names = self.sections[names].data
        for section in self.sections:
            section.name = names[section.name : names.index(0, section.name)].decode()
            if section.type == RELA:
                of = self.sections[section.of]
                of.table = section
                of.relocations = {where: target for where, *target in struct.iter_unpack("<IIi", section.data)}
        table = self.section(".symtab")
        self.symbols, self.names = table.data, self.sections[table.link].data

    def section(self, name):
        return next((section for section in self.sections if section.name == name), None)

    def section_of(self, what):
        index = struct.unpack_from("<H", self.symbols, 16 * (what >> 8) + 14)[0]
        return self.sections[index] if index < len(self.sections) else None

    def value_of(self, what):
        return struct.unpack_from("<I", self.symbols, 16 * (what >> 8) + 4)[0]

    def name_of(self, what):
        name = struct.unpack_from("<I", self.symbols, 16 * (what >> 8))[0]
        return self.names[name : self.names.index(0, name)].decode()

    def symbol_of(self, section):
        """A symbol in this section, for a relocation, without its type."""
        index = self.sections.index(section)
        for at in range(0, len(self.symbols), 16):
            if struct.unpack_from("<H", self.symbols, at + 14)[0] == index:
                return at // 16 << 8
        return fail(f"there is no symbol in {section.name}")

    def named(self):
        """Its symbols: the name, the value, the kind, and the section that it is in, if it is in one."""
        for at in range(0, len(self.symbols), 16):
            name, value, _, kind, _, index = struct.unpack_from("<3I2BH", self.symbols, at)
            name = self.names[name : self.names.index(0, name)].decode()
            yield name, value, kind & 0xF, self.sections[index] if 0 < index < len(self.sections) else None

    def sections_of_globals(self):
        """Those that have a symbol which another object can refer to."""
        for at in range(0, len(self.symbols), 16):
            if self.symbols[at + 12] >> 4:
                yield self.section_of(at << 4)

    def update(self, section):
        """What has changed goes to the end of the file."""
        if section.table:
            section.table.data = b"".join(struct.pack("<IIi", where, *to) for where, to in sorted(section.relocations.items()))
            self.update(section.table)
        elif section.relocations:
            fail(f"{section.name} has relocations now, and the object no place for them")
        struct.pack_into("<2I", self.elf, section.header + 16, len(self.elf), len(section.data))
        self.elf += section.data


class Reader:
    def __init__(self, data):
        self.data, self.at = data, 0

    def more(self):
        return self.at < len(self.data)

    def skip(self, size):
        self.at += size

    def number(self, size):
        self.at += size
        return int.from_bytes(self.data[self.at - size : self.at], "little")

    def leb128(self):
        value = shift = 0
        while True:
            byte = self.number(1)
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value


def executed(object):
    return [section for section in object.sections if section.flags & EXECUTED]


def write(object):
    for section in object.sections:
        if section.table or section.flags & EXECUTED:
            object.update(section)
    object.update(object.section(".symtab"))
