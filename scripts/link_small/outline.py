"""Stretches of code that occur more than once: one is left, as a function or as the end of one, and is called.

A call and a return are seven cycles, so loops and functions that have to be quick are left as they are; the end of one may be called,
though.
"""

import collections
import struct

from link_small.code import Edit, is_load_or_store
from link_small.elf import FUNCTION, R_AVR_CALL, fail
from link_small.flow import analyze, labels_of
from link_small.jumps import RETURN

CALL, JUMP = 0x940E, 0x940C
# In bytes, once ld has relaxed it.
CALL_SIZE = RETURN_SIZE = 2
# In instructions.
LONGEST = 24
# Some writes to ports must follow another within four cycles (EECR, WDTCSR).
TIMED = 4


class Place:
    """Where a stretch is: the indices of its first instruction and of the one behind it, whether that is the return, and whether there
    is time for a call."""

    def __init__(self, function, first, end, returns, has_time):
        self.function, self.first, self.end, self.returns, self.has_time = function, first, end, returns, has_time
        self.span = range(first, end + returns)

    def bytes(self):
        code = self.function.code
        last = code[self.span[-1]]
        return code[self.first].at, last.at + last.size


def is_port(section, one):
    """Whether it reads or writes a register of the hardware."""
    if is_load_or_store(one.word):
        return one.at + 2 not in section.relocations
    return one.word & 0xF000 == 0xB000 or one.word & 0xFC00 == 0x9800


def stretches(object, functions):
    """The instructions in a row of which only the first is ever jumped to, and that go on at the next: for each row its function, the
    index of the first, and a number for each, which equal ones have in common, or None for a return at the end."""
    numbers = {}

    def number_of(section, one):
        relocations = []
        for at in range(one.at, one.at + one.size):
            if at in section.relocations:
                what, addend = section.relocations[at]
                to = object.section_of(what)
                relocations.append((at - one.at, what & 0xFF, to.header if to and to.name else what, object.value_of(what) + addend))
        # Where it calls is only in the relocation.
        data = one.kind if one.kind == "call" else bytes(section.data[one.at : one.at + one.size])
        return numbers.setdefault((data, *relocations), len(numbers))

    for function in functions:
        code, section = function.code, function.section
        labels = labels_of(code)
        begin, row = 0, []
        for n, one in enumerate(code):
            if n in labels:
                yield function, begin, row
                begin, row = n, []
            if one.kind in ("plain", "acts", "call") and one.goes_on():
                row.append(number_of(section, one))
                continue
            yield function, begin, [*row, None] if one.word == RETURN and row else row
            begin, row = n + 1, []


def is_timed(place):
    """Whether a call or a return would come between two ports that may have to be written shortly after each other."""
    code, section = place.function.code, place.function.section

    def come_close(border):
        return all(any(is_port(section, one) for one in some) for some in (code[max(0, border - TIMED) : border], code[border : border + TIMED]))

    return come_close(place.first) or come_close(place.end)


def in_loops(function):
    """The indices of the instructions in loops."""
    return {n for end, one in enumerate(function.code) for begin in one.next for n in range(begin, end + 1)}


def repeated(object, functions, quick):
    """Where each stretch is that occurs more than once."""
    found = collections.defaultdict(list)
    loops = {function: in_loops(function) for function in functions}
    for function, begin, row in stretches(object, functions):
        for first in range(len(row)):
            for end in range(first + 1, min(len(row), first + LONGEST) + 1):
                if row[end - 1] is None:
                    break
                # ld makes a jump of a call and a return.
                returns = row[end : end + 1] == [None] and function.code[begin + end - 1].kind != "call"
                # An object has no place for the relocation of a call where there was none before.
                has_time = function not in quick and function.section.table is not None and begin + first not in loops[function]
                place = Place(function, begin + first, begin + end, returns, has_time)
                if not is_timed(place):
                    found[tuple(row[first:end])].append(place)
    return {stretch: places for stretch, places in found.items() if len(places) > 1}


def choose(places, taken):
    """The bytes that are saved, the place that is left, if it ends a function, and those that call or jump there."""
    free, own = [], collections.defaultdict(set)
    for place in places:
        if not set(place.span) & (taken[place.function] | own[place.function]):
            own[place.function] |= set(place.span)
            free.append(place)
    ends = sorted((place for place in free if place.returns), key=lambda place: place.has_time)
    left = ends[0] if ends else None
    code = places[0].function.code
    size = sum(CALL_SIZE if one.kind == "call" else one.size for one in code[places[0].first : places[0].end])
    saved_by = {place: size if place.returns else size - CALL_SIZE for place in free}
    gone = [place for place in free if place is not left and place.has_time and saved_by[place]]
    return sum(saved_by[place] for place in gone) - (0 if left else size + RETURN_SIZE), left, gone


def append(object, place):
    """Puts the stretch behind the function that it is in, with a return. Where it is there."""
    section = place.function.section
    first = place.function.code[place.first].at
    last = place.function.code[place.end - 1]
    at = len(section.data)
    section.data += section.data[first : last.at + last.size] + struct.pack("<H", RETURN)
    for where, to in list(section.relocations.items()):
        if first <= where < last.at + last.size:
            section.relocations[where - first + at] = to
    for symbol in range(0, len(object.symbols), 16):
        value, size, kind = struct.unpack_from("<2IB", object.symbols, symbol + 4)
        if kind & 0xF == FUNCTION and object.section_of(symbol << 4) is section and value + size == at:
            struct.pack_into("<I", object.symbols, symbol + 8, len(section.data) - value)
    return at


def names_in(path):
    """The functions that a file names, one a line; what begins with # is a comment."""
    try:
        with open(path, encoding="utf-8") as file:
            lines = [line.strip() for line in file]
    except OSError as error:
        fail(f"the list of the functions that have to be quick, {path}: {error.strerror}")
    return [line for line in lines if line and not line.startswith("#")]


def is_called(section, name):
    """Whether it is the section of a function of this name, in Rust with its length before it."""
    return section.name.endswith("." + name) or f"{len(name)}{name}" in section.name


def outline(object, quick_names):
    """Whether there was any. The names are those of functions that have to be quick."""
    functions = list(analyze(object).values())
    for name in quick_names:
        if not any(is_called(section, name) for section in object.sections):
            fail(f"there is no function {name}, which is to be quick: take it from the list, or name the function that it is in now")
    quick = {function for function in functions if any(is_called(function.section, name) for name in quick_names)}
    found = repeated(object, functions, quick)
    taken = collections.defaultdict(set)
    worth = {stretch: choose(places, taken)[0] for stretch, places in found.items()}
    todo = sorted((stretch for stretch in found if worth[stretch] > 0), key=lambda stretch: (-worth[stretch], stretch))
    edit, chosen = Edit(object), []
    while todo:
        stretch = todo.pop(0)
        saved, left, gone = choose(found[stretch], taken)
        if saved < worth[stretch]:
            # Others have taken some of its places.
            if saved > 0:
                worth[stretch] = saved
                todo.insert(next((n for n, other in enumerate(todo) if worth[other] < saved), len(todo)), stretch)
            continue
        if left:
            section, at = left.function.section, left.function.code[left.first].at
        else:
            section = gone[0].function.section
            at = append(object, gone[0])
        for place in filter(None, (left, *gone)):
            taken[place.function] |= set(place.span)
        chosen.append((section, at, gone))
    for section, at, gone in chosen:
        what = object.symbol_of(section)
        for place in gone:
            begin, end = place.bytes()
            its = place.function.section
            for where in range(begin, end):
                its.relocations.pop(where, None)
            edit.replace(its, begin, JUMP if place.returns else CALL)
            struct.pack_into("<H", its.data, begin + 2, 0)
            its.relocations[begin] = what & ~0xFF | R_AVR_CALL, at - object.value_of(what)
            for where in range(begin + 4, end, 2):
                edit.cut(its, where)
    return edit.make()
