"""Registers that are saved for nobody.

LLVM has each function save the registers that it changes of those which the calling convention says it must, though hardly any of
its callers has something in them.
"""

from link_small.code import cut
from link_small.flow import analyze


def drop_saves(object):
    """Leaves out pushes and pops of registers that nobody reads after the pop, and pushes that are never popped. Whether there were any."""
    cuts = {}
    for section, function in analyze(object).items():
        saves = {}
        for one in function.code:
            if one.saved:
                saves.setdefault(one.saved, []).append(one)
        unused = [its for its in saves.values() if not any(one.kind == "pop" and one.live & one.does.sets for one in its)]
        if unused:
            cuts[section] = sorted(one.at for its in unused for one in its)
    cut(object, cuts)
    return bool(cuts)
