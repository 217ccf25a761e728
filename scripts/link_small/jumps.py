"""Jumps that lead to jumps, code that nothing leads to, and equal ends of stretches of code, of which one is enough."""

from link_small.code import Edit
from link_small.elf import R_AVR_13_PCREL
from link_small.flow import analyze, labels_of
from link_small.tidy import tidied

RETURN, JUMP = 0x9508, 0xC000
# How far a branch reaches from where it is, in bytes.
BRANCH_REACH = range(-124, 127)
# Less is not worth the two cycles of a jump.
SHORTEST = 4


def jumps_within(one):
    """Whether it is a jump to a place of the same function."""
    return one.kind == "jump" and not one.called and one.next


def lead(function, place, to, object):
    """The relocation that leads there."""
    section = function.section
    what = section.relocations[function.code[place].at][0] if function.code[place].at in section.relocations else object.symbol_of(section)
    return what, function.code[to].at - object.value_of(what)


def follow_jumps(object):
    """Jumps and branches go where they lead to in the end. Those to the next instruction go, and so does what is never reached."""
    edit = Edit(object)
    for function in tidied(analyze(object)):
        code, section = function.code, function.section
        reached, todo = {0}, [0]
        while todo:
            one = code[todo.pop()]
            for following in one.next if one.goes_on() else ():
                if following not in reached:
                    reached.add(following)
                    todo.append(following)
        for n, one in enumerate(code):
            if n not in reached:
                edit.delete(section, one)
                continue
            if one.kind == "branch":
                to = one.next[0]
            elif jumps_within(one):
                to = one.next[0]
            else:
                continue
            end, seen = to, set()
            while jumps_within(code[end]) and end not in seen:
                seen.add(end)
                end = code[end].next[0]
            if one.kind == "jump" and end == n + 1 or one.kind == "branch" and to == n + 1:
                edit.delete(section, one)
            elif one.kind == "jump" and code[end].word == RETURN:
                del section.relocations[one.at]
                edit.replace(section, one.at, RETURN)
                if one.size == 4:
                    edit.cut(section, one.at + 2)
            elif end != to and (one.kind == "jump" or code[end].at - one.at - 2 in BRANCH_REACH):
                section.relocations[one.at] = lead(function, n, end, object)
                edit.changes += 1
    return edit.make()


def merge_tails(object):
    """Of two stretches of code in a function that are equal and go on at the same place, one is left, and a jump there."""
    edit = Edit(object)
    for function in tidied(analyze(object)):
        code, section = function.code, function.section
        labels = labels_of(code)

        def same(a, b):
            a, b = code[a], code[b]
            if a.kind == "branch" or jumps_within(a):
                return a.kind == b.kind and a.does.uses == b.does.uses and a.word >> 10 == b.word >> 10 and a.next and b.next and a.next[0] == b.next[0]
            here, there = ([section.relocations.get(one.at + n) for n in (0, 2)][: one.size // 2] for one in (a, b))
            return section.data[a.at : a.at + a.size] == section.data[b.at : b.at + b.size] and here == there

        # Where stretches end: by a return, by a jump to a place, or in front of it.
        ends = {}
        for n, one in enumerate(code):
            if one.kind == "return" and one.word == RETURN:
                ends.setdefault("return", []).append((n + 1, True))
            elif jumps_within(one):
                ends.setdefault(one.next[0], []).append((n, True))
            elif n + 1 in labels and one.kind in ("plain", "acts", "call", "pop") and one.goes_on():
                ends.setdefault(n + 1, []).append((n + 1, False))
        touched = set()
        best = []
        for where, stretches in ends.items():
            for this, jumps in stretches:
                for that, _ in stretches:
                    if not jumps or this == that:
                        continue
                    length = 0
                    while length < this and length < that and same(this - length - 1, that - length - 1) and code[this - length - 1].kind != "branch":
                        length += 1
                        if this - length in labels:
                            break
                    first = this - length
                    if not length or first <= that - 1 < this or that - length <= first < that:
                        continue
                    saved = sum(code[n].size for n in range(first, this)) - (2 if where == "return" else 0)
                    if saved >= SHORTEST:
                        best.append((saved, first, this, that - length, that, where))
        for saved, first, end, other, other_end, where in sorted(best, key=lambda it: (-it[0], it[1:5])):
            gone = set(range(first, end + (where != "return")))
            stays = set(range(other, other_end))
            if touched & (gone | stays):
                continue
            touched |= gone | stays
            what = object.symbol_of(section)
            for n in sorted(gone):
                edit.delete(section, code[n])
            edit.keep(section, code[first].at)
            edit.replace(section, code[first].at, JUMP)
            section.relocations[code[first].at] = what & ~0xFF | R_AVR_13_PCREL, code[other].at - object.value_of(what)
    return edit.make()
