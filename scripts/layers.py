"""The imports of src/: which file uses which, and what is wrong with them.

A file uses another if a `use` or a path names something of it. `pub use` of a module of the file's
own passes a name on and is no import; who imports that name uses the file that defines it.
"""

import re

ROOM = re.compile(r"^//! \* \[`(\w+)`\]", re.MULTILINE)
MODULE = re.compile(r'(?:path = "([^"]+)"\)?\]\s*(?:#\[[^\n]*\]\s*)*)?(?:pub )?mod (\w+);')
USE = re.compile(r"^\s*(pub(?:\([^)]*\))? )?use ([^;]+);", re.MULTILINE)
PATH = re.compile(r"\b(?:crate|super|firmware)(?:::\w+)+")


def leaves(tree):
    """The paths of a `use`: `a::{b, c::d}` is `a::b` and `a::c::d`."""
    head, brace, rest = tree.partition("{")
    if not brace:
        return [re.split(r"\s+as\s+", tree.strip())[0]]
    parts, depth, part = [], 0, ""
    for letter in rest[: rest.rindex("}")]:
        depth += (letter == "{") - (letter == "}")
        if letter == "," and depth == 0:
            parts, part = [*parts, part], ""
        else:
            part += letter
    return [head.strip() + leaf for part in [*parts, part] if part.strip() for leaf in leaves(part)]


class Imports:
    """The imports of the files of src/, given the code of each without tests and comments."""

    def __init__(self, sources):
        self.sources = sources
        # For each file its module's path, and for each module its files: one for each build.
        self.module_of, self.files, self.passed_on = {}, {}, {}
        self.add("src/lib.rs", ())
        self.add("src/main.rs", ("main",))
        for name, source in sources.items():
            for is_public, tree in USE.findall(source):
                for leaf in leaves(tree) if is_public else []:
                    if leaf.partition("::")[0] in self.children(name):
                        module = self.module_of[name]
                        self.passed_on[*module, leaf.split("::")[-1]] = leaf.split("::")
        self.uses = {name: self.used_by(name) for name in self.module_of}

    def add(self, name, module):
        if name not in self.sources or name in self.module_of:
            return
        self.module_of[name] = module
        self.files.setdefault(module, []).append(name)
        folder, _, file = name.rpartition("/")
        own = folder if file in ("lib.rs", "main.rs", "mod.rs") else name.removesuffix(".rs")
        for path, child in MODULE.findall(self.sources[name]):
            at = (*module, child)
            self.add(f"{folder}/{path}", at)
            self.add(f"{own}/{child}.rs", at)
            self.add(f"{own}/{child}/mod.rs", at)

    def children(self, name):
        return {child for _, child in MODULE.findall(self.sources[name])}

    def used_by(self, name):
        source, module = self.sources[name], self.module_of[name]
        paths = PATH.findall(source)
        for is_public, tree in USE.findall(source):
            own = self.children(name) if is_public else ()
            paths += [leaf for leaf in leaves(tree) if leaf.split("::")[0] not in own]
        return {file for path in paths for file in self.target(module, path.split("::"))} - {name}

    def target(self, module, path):
        """The files in which a path ends that a file of this module has."""
        root = module[:1] if module[:1] == ("main",) else ()
        if path[0] in ("crate", "firmware"):
            at, path = (root if path[0] == "crate" else ()), path[1:]
        elif path[0] == "super":
            at = module
            while path and path[0] == "super":
                at, path = at[:-1], path[1:]
        elif (*module, path[0]) in self.files:
            at = module
        else:
            return []
        while path and (*at, path[0]) in self.files:
            at, path = (*at, path[0]), path[1:]
        if path and (*at, path[0]) in self.passed_on:
            return self.target(at, self.passed_on[*at, path[0]])
        return self.files.get(at, [])

    def circles(self):
        """Imports that lead back to the file that has them."""
        for name in sorted(self.uses):
            for used in sorted(self.uses[name]):
                if name in self.reached(used):
                    yield f"{name}: uses {used}, which leads back to it"

    def reached(self, name):
        found, waiting = set(), [name]
        while waiting:
            new = self.uses.get(waiting.pop(), set()) - found
            found |= new
            waiting += new
        return found

    def rising(self):
        """Imports of a room of src/ that is above, in the order of the list in src/lib.rs."""
        rooms = ["main", "board", *ROOM.findall(self.sources["src/lib.rs"])]
        rank = {room: number for number, room in enumerate(rooms)}

        def room_of(name):
            return name.removeprefix("src/").removesuffix(".rs").split("/")[0]

        for name in sorted(self.uses):
            for used in sorted(self.uses[name]):
                above, below = rank.get(room_of(used), -1), rank.get(room_of(name), -1)
                if room_of(used) != room_of(name) and above < below:
                    yield f"{name}: uses {used}, which is above it (src/lib.rs has the order)"


def problems(sources):
    """What is wrong with the imports of src/."""
    imports = Imports(sources)
    return [*imports.circles(), *imports.rising()]
