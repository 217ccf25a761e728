"""How the functions of an object go on and call each other, and which registers and flags hold something that is still read.

A register is live where what it holds may be read before it is written again. What is live after a function returns depends on who
called it, so this is worked out for the program as a whole, from these rules:

* A function of this object that is only called or jumped to by others of it: live at its end is what is live after one of those
  calls. Nothing else is known of one that others can reach (a global symbol, a pointer to it): everything is live at its end.
* What a call makes of what is live after it is said in two sets for each function: what it uses, and what passes it unchanged.
* A register that is pushed and popped passes. It is not used by that: if nobody wants it after the pop, nobody wants it at all.
* A function of another object keeps to the calling convention of the AVR. One of this object that is not understood may do anything.

Sections that are not one function each (there are some of assembly) are left alone, and so is what has an instruction that is not
known.
"""

from link_small.code import instructions, is_load_or_store
from link_small.effects import EVERYTHING, effect, is_stack_pointer, pair
from link_small.elf import FUNCTION, R_AVR_7_PCREL, R_AVR_13_PCREL, R_AVR_CALL, executed

# r1 is zero where a function begins and ends, for those who rely on it and for those who will when others do no more.
ZERO_REGISTER = 1 << 1
# What a function of another object may read: arguments are in r8 to r25, and functions of libgcc get some in X and Z; r1 is zero,
# and Y is not theirs.
ARGUMENTS = sum(1 << n for n in range(8, 28)) | pair(0) | pair(28) | pair(30)
# What it may change.
CLOBBERED = EVERYTHING & ~(sum(1 << n for n in range(2, 18)) | pair(28) | 1 << 1)
BRANCHES = R_AVR_7_PCREL, R_AVR_13_PCREL, R_AVR_CALL


class Foreign:
    """A function that is not looked into."""

    def __init__(self, uses, sets, changes):
        self.uses, self.passes, self.changes, self.returns = uses, EVERYTHING & ~sets, changes, True


# Of another object; and of this one, where it is not understood: LLVM has calling conventions of its own for these (IPRA).
FOREIGN = Foreign(ARGUMENTS, 0, CLOBBERED)
NOT_UNDERSTOOD = Foreign(EVERYTHING, 0, EVERYTHING)
# libgcc's of which more is known (GCC Wiki, "avr-gcc", "Exceptions to the Calling Convention"; lib1funcs.S).
KNOWN = {
    # r25:r22 *= r21:r18
    "__mulsi3": Foreign(sum(1 << n for n in range(18, 26)) | 1 << 1, sum(1 << n for n in range(22, 26)), CLOBBERED),
}


class Instruction:
    def __init__(self, at, word, does):
        self.at, self.word, self.does = at, word, does
        self.size = 4 if is_load_or_store(word) or does.kind in ("jump", "call") and word & 0xFE0C == 0x940C else 2
        self.kind, self.register = does.kind, does.register
        self.next = ()  # the indices of those that can follow
        self.called = None  # by a call, or a jump that leaves the function
        self.saved = None  # of a push or a pop that belong together: the bit for what is on the stack
        self.live = 0  # after it

    def ends(self):
        """Whether the function may return here."""
        return self.kind == "return" or self.kind == "jump" and self.called and self.called.returns

    def goes_on(self):
        """Whether what is next may follow."""
        return not self.called or self.called.returns


class Function:
    def __init__(self, section):
        self.section, self.code, self.index = section, [], {}
        self.uses = self.passes = self.changes = self.live_at_end = 0
        self.returns, self.callers = False, []

    def read(self, object, functions):
        """Its instructions, and where each goes. Why it is not understood, if it is not."""
        for at, word in instructions(self.section):
            does = effect(word)
            if does is None:
                return f"the instruction {word:#06x}"
            if is_stack_pointer(word):
                return "it uses the stack pointer"
            self.index[at] = len(self.code)
            self.code.append(Instruction(at, word, does))
        for n, one in enumerate(self.code):
            if one.kind in ("branch", "jump", "call") and (problem := self.follow(object, functions, one)):
                return problem
            if one.kind not in ("jump", "return"):
                one.next = *one.next, n + 1
            if one.kind == "skip":
                one.next = *one.next, n + 2
        return None

    def follow(self, object, functions, one):
        what, addend = self.section.relocations.get(one.at, (0, 0))
        if not what:
            # To the beginning of the program, where nothing is left of what was: like a reset.
            reset = one.word & 0xFE0E == 0x940C and self.section.data[one.at : one.at + 4] == b"\x0c\x94\0\0"
            return None if reset else f"the jump at {one.at:#x}"
        target, offset = object.section_of(what), object.value_of(what) + addend
        if target is self.section and one.kind != "call":
            if offset not in self.index:
                return f"the jump at {one.at:#x}"
            one.next = (self.index[offset],)
        elif one.kind == "branch" or target in functions and offset:
            return f"the jump at {one.at:#x}"
        else:
            one.called = functions.get(target) or (NOT_UNDERSTOOD if target and target.name else KNOWN.get(object.name_of(what), FOREIGN))
        return None

    def pair_saves(self):
        """Finds the pushes and pops of the same register that belong together, whatever way the program goes."""
        code, stacks, todo = self.code, {0: ()}, [0]
        pops = {}
        while todo:
            n = todo.pop()
            one, stack = code[n], stacks[n]
            if one.kind == "push":
                pops.setdefault(n, set())
                stack = *stack, n
            elif one.kind == "pop":
                if not stack:
                    return
                pops[stack[-1]].add(n)
                stack = stack[:-1]
            elif stack and one.ends():
                return
            for following in one.next if one.goes_on() else ():
                if following == len(code):
                    return
                if following not in stacks:
                    stacks[following] = stack
                    todo.append(following)
                elif stacks[following] != stack:
                    return
        for number, (push, its) in enumerate(sorted(pops.items())):
            if all(code[pop].register == code[push].register for pop in its):
                for n in (push, *its):
                    code[n].saved = 1 << 40 + number

    def before(self, one, live, for_nothing=True):
        """What is live before an instruction, from what is after it. An instruction whose result is not uses nothing, or else does so
        nevertheless: what it uses depends on what is live at the end, which cannot be said in sets that are worked out only once."""
        does = one.does
        if one.called:
            return one.called.uses | ZERO_REGISTER | live & (one.called.passes | ~EVERYTHING)  # what is on the stack passes
        if one.saved:
            register = does.uses | does.sets
            have, get = (one.saved, register) if one.kind == "push" else (register, one.saved)
            return live & ~have | (get if live & have else 0)
        if for_nothing and one.kind == "plain" and not live & does.sets:
            return live
        return live & ~does.sets | does.uses

    def solve(self, at_end, for_nothing):
        """What is live after each instruction, given what is at the end. What is at the beginning."""
        code = self.code
        before = [0] * len(code) + [EVERYTHING]
        changed = True
        while changed:
            changed = False
            for n in range(len(code) - 1, -1, -1):
                one = code[n]
                live = at_end | ZERO_REGISTER if one.kind == "return" or one.kind == "jump" and one.called else 0
                for following in one.next:
                    live |= before[following]
                one.live = live
                live = self.before(one, live, for_nothing)
                if live != before[n]:
                    before[n] = live
                    changed = True
        return before[0]

    def summarize(self):
        """Works out what it uses, what passes it, and what it changes. Whether that is news."""
        old = self.uses, self.passes, self.changes
        self.uses, self.passes, self.changes = self.solve(0, False), self.solve(EVERYTHING, False), self.changed()
        return old != (self.uses, self.passes, self.changes)

    def changed(self):
        """The registers and flags that may have another value at the end."""
        changed, todo, at_end = {0: 0}, [0], 0
        while todo:
            n = todo.pop()
            one, now = self.code[n], changed[n]
            if one.called:
                now |= one.called.changes
            elif one.saved:
                register = one.does.uses | one.does.sets
                into, source = (one.saved, register) if one.kind == "push" else (register, one.saved)
                now = now | into if now & source else now & ~into
            else:
                now |= one.does.sets
            if one.ends():
                at_end |= now
            for following in one.next if one.goes_on() else ():
                if following < len(self.code) and now & ~changed.get(following, 0) or following not in changed:
                    changed[following] = changed.get(following, 0) | now
                    if following < len(self.code):
                        todo.append(following)
        return at_end & EVERYTHING

    def find_whether_it_returns(self):
        """Whether that is news."""
        seen, todo = {0}, [0]
        while todo and not self.returns:
            one = self.code[todo.pop()]
            self.returns = one.ends()
            for following in one.next if one.goes_on() else ():
                if following not in seen and following < len(self.code):
                    seen.add(following)
                    todo.append(following)
        return self.returns


def labels_of(code):
    """The indices of the instructions that something else than the one before leads to."""
    return {following for n, one in enumerate(code) for following in one.next if following != n + 1}


def understood(object):
    """The functions of an object that are understood, by their sections."""
    symbols = {}
    for _, value, kind, section in object.named():
        if kind == FUNCTION:
            symbols.setdefault(section, set()).add(value)
    functions = {section: Function(section) for section in executed(object) if section.name.startswith(".text.") and symbols.get(section) == {0}}
    while True:
        for function in functions.values():
            function.code, function.index = [], {}
        bad = [section for section, function in functions.items() if function.read(object, functions)]
        # One that is reached in its middle from elsewhere is none.
        for section in object.sections:
            if not section.name.startswith(".debug"):
                for what, addend in section.relocations.values():
                    target = object.section_of(what)
                    if target in functions and target is not section and object.value_of(what) + addend:
                        bad.append(target)
        if not bad:
            return functions
        for section in set(bad):
            del functions[section]


def called_from_elsewhere(object, functions):
    """The sections of functions that somebody else can reach, too."""
    reached = {section for section in object.sections_of_globals() if section in functions}
    for section in object.sections:
        if section.name.startswith(".debug"):
            continue
        for what, _ in section.relocations.values():
            target = object.section_of(what)
            if target in functions and (section not in functions or what & 0xFF not in BRANCHES):
                reached.add(target)
    return reached


def those_called_first(functions):
    """The functions, each after those that it calls, but for recursion."""
    order = {}

    def visit(function):
        if function not in seen:
            seen.add(function)
            for one in function.code:
                if isinstance(one.called, Function):
                    visit(one.called)
            order[function] = None

    seen = set()
    for function in functions.values():
        visit(function)
    return list(order)


def analyze(object):
    """The functions of an object that are understood, by their sections, with what is live after each instruction."""
    functions = understood(object)
    for function in functions.values():
        for one in function.code:
            if isinstance(one.called, Function):
                one.called.callers.append(function)

    in_order = those_called_first(functions)

    def until_there_is_no_news(ask):
        todo = dict.fromkeys(in_order)
        while todo:
            function = next(iter(todo))
            del todo[function]
            if ask(function):
                todo |= dict.fromkeys(function.callers)

    until_there_is_no_news(lambda function: not function.returns and function.find_whether_it_returns())
    for function in functions.values():
        function.pair_saves()
    until_there_is_no_news(Function.summarize)
    for section in called_from_elsewhere(object, functions):
        functions[section].live_at_end = EVERYTHING
    todo = dict.fromkeys(reversed(in_order))
    while todo:
        function = next(iter(todo))
        del todo[function]
        function.solve(function.live_at_end, True)
        for one in function.code:
            if isinstance(one.called, Function) and one.live & EVERYTHING & ~one.called.live_at_end:
                one.called.live_at_end |= one.live & EVERYTHING
                todo[one.called] = None
    return functions
