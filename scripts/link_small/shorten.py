"""Loads and stores through Y, branches over jumps, and comparisons that say nothing new."""

import collections
import re
import struct
import subprocess

from link_small.code import Edit, cut, instructions, is_branch, is_jump, is_skip, loads_and_stores, uses_carry
from link_small.elf import FUNCTION, R_AVR_7_PCREL, R_AVR_NONE, executed

# What Y points to, and how far LDD and STD reach from there.
Y_WINDOW = "__y_window"
REACH = 64
# LDD with these pointers.
Y, Z = 0x8008, 0x8000


def addresses_in(object, trial):
    """The loads and stores of variables: the code, where in it, and the address."""
    final = {name: value & 0xFFFF for name, value, _, section in trial.named() if name and section}
    bases = {section: final[name] - value for name, value, _, section in object.named() if section and name in final}
    for section, at, what, addend in loads_and_stores(object):
        base = bases.get(object.section_of(what))
        if base is not None:
            yield section, at, base + object.value_of(what) + addend


def through(edit, section, at, pointer, place):
    """Makes LDD or STD of a load or store, with what the pointer is with displacement 0, and the place behind it."""
    word = struct.unpack_from("<H", section.data, at)[0]
    edit.replace(section, at, pointer | word & 0x03F0 | (place & 0x20) << 8 | (place & 0x18) << 7 | place & 7)
    what, addend = section.relocations.pop(at + 2)
    # Says nothing but that the variable is in use, or --gc-sections would leave it out, and move those behind it.
    section.relocations[at + 1] = what & ~0xFF | R_AVR_NONE, addend
    edit.cut(section, at + 2)


def shorten(objects, trial):
    """Makes LDD and STD of loads and stores within reach of Y. Where Y has to point to."""
    found = {object: list(addresses_in(object, trial)) for object in objects}
    uses = collections.Counter(address for places in found.values() for *_, address in places)
    window = max(uses, key=lambda begin: sum(uses[begin + n] for n in range(REACH)), default=0)
    for object, places in found.items():
        edit = Edit(object)
        for section, at, address in places:
            if 0 <= address - window < REACH:
                through(edit, section, at, Y, address - window)
        edit.make()
    return window


def function_with_y(path, elf):
    """The first that uses Y, if there is one."""
    functions = {name for name, _, kind, _ in elf.named() if kind == FUNCTION}
    listing = subprocess.run(["avr-objdump", "-d", "--no-show-raw-insn", path], capture_output=True, text=True, check=True).stdout
    function = None
    for line in listing.splitlines():
        if label := re.fullmatch(r"[0-9a-f]+ <(.*)>:", line):
            function = label[1] if label[1] in functions else None
        elif function and re.search(r"\b(r28|r29|Y)\b", line.partition(";")[0]):
            return function
    return None


def sets_zero_as_a_comparison_with_zero_does(word):
    """The register whose bits `and`, `or`, `eor`, `andi`, or `ori` works out, if the instruction is one of these."""
    if word & 0xFC00 in (0x2000, 0x2400, 0x2800):
        return word >> 4 & 31
    if word & 0xF000 in (0x6000, 0x7000):
        return 16 + (word >> 4 & 15)
    return None


def simplify(object):
    """Leaves out what LLVM leaves in:

    * a branch over a jump: the opposite branch, if that reaches, or if it reaches another jump to there;
    * a comparison with zero after an instruction that has said as much;
    * the two instructions that compare a register pair with zero, where one (sbiw) can.

    Whether there was any. One may make room for another."""
    targets = collections.defaultdict(set)
    for section in object.sections:
        if not section.name.startswith(".debug"):
            for what, addend in section.relocations.values():
                targets[object.section_of(what)].add(object.value_of(what) + addend)
    cuts = {}
    for section in executed(object):
        code, relocations, places = list(instructions(section)), section.relocations, []
        words = dict(code)

        def target(at):
            what, addend = relocations.get(at, (0, 0))
            return object.value_of(what) + addend if what and object.section_of(what) is section else None

        jumps = collections.defaultdict(list)
        for at, word in code:
            if is_jump(word) and target(at) is not None:
                jumps[target(at)].append(at)

        for (_, before), (at, first), (second_at, second) in zip([(0, 0), *code], code, code[1:]):
            if is_skip(before) or second_at in targets[section] or places and places[-1] >= at - 2:
                continue
            if is_branch(first) and is_jump(second) and target(at) == at + 4:
                to = target(second_at)
                reached = [other for other in (to, *jumps[to]) if other is not None and -126 <= other - at - 2 <= 126]
                reached = [other for other in reached if other != second_at and other not in places]
                if reached:
                    what, addend = relocations.pop(second_at)
                    struct.pack_into("<H", section.data, at, first ^ 0x0400)
                    relocations[at] = what & ~0xFF | R_AVR_7_PCREL, addend + reached[0] - to
                    targets[section].add(reached[0])
                    places.append(second_at)
            # cp rN, r1 and cpc rN+1, r1, of r24, r26, and r30. r1 is zero.
            if first & 0xFE0F == 0x1401 and second == first - 0x1000 + 0x10 and first >> 4 & 31 in (24, 26, 30):
                struct.pack_into("<H", section.data, at, 0x9700 | (first >> 5 & 3) << 4)
                places.append(second_at)
            register, branch = sets_zero_as_a_comparison_with_zero_does(first), words.get(at + 4, 0)
            if register is not None and second == 0x3000 | (register - 16) << 4 and is_branch(branch) and branch & 7 in (1, 2, 4):
                to = target(at + 4)
                if to in words and not uses_carry(words[to]) and not uses_carry(words.get(at + 6, 0x0400)):
                    places.append(second_at)
        if places:
            cuts[section] = places
    cut(object, cuts)
    return bool(cuts)
