"""The table of boards, avr-specs/boards.toml, and the choice of a board that the scripts get as
options. avr-specs/boards.rs does the same for programs in Rust. A test compares what both derive
from the table, for every choice.
"""

import argparse
import dataclasses
import os
import pathlib
import re
import subprocess
import sys
import tomllib

ROOT = pathlib.Path(__file__).resolve().parents[1]
TARGET = ROOT / os.environ.get("CARGO_TARGET_DIR", "target")
TABLE = tomllib.loads((ROOT / "avr-specs/boards.toml").read_text())
LIMITS = tomllib.loads((ROOT / "avr-specs/budget.toml").read_text())

# As options of a script.
UNO = ["--board", "uno", "--shield", "seeed"]
# The serial port, and the SPI but its SS, which is D10.
TAKEN = ["D0", "D1", "D11", "D12", "D13"]
PINS = [f"D{n}" for n in range(14)] + [f"A{n}" for n in range(6)]
INTERRUPTS = ["D2", "D3"]
CRYSTALS_MHZ = [8, 16]

# Lock bits (datasheet, "Boot Loader Lock Bits"). While chips are written they are open. BLB1 mode 2
# protects the boot section from SPM. Mode 3 would also keep the program from reading it, and so
# from seeing that its loader is there.
UNLOCKED = 0x3F
LOCKED = 0xEF
# As Arduino's boards.txt has it.
STOCK_LOCKED = 0x0F
# The baud rate of the sketch ArduinoISP; avrdude's own for the programmer avrisp is another.
ARDUINO_ISP_BAUD = 19200


@dataclasses.dataclass(frozen=True)
class Choice:
    """A board, a CAN board, and how it is wired."""

    board: str
    shield: str
    cs: str
    int: str
    crystal_mhz: int

    @property
    def chip(self):
        return TABLE["boards"][self.board]["chip"]

    @property
    def limits(self):
        return LIMITS[self.chip]

    @property
    def preset(self):
        """The preset that is built if nobody asks for another."""
        return TABLE["chips"][self.chip]["preset"]

    @property
    def update_preset(self):
        """The preset for updates over the bus: a node with it can be updated again."""
        return TABLE["chips"][self.chip]["update_preset"]

    @property
    def servo(self):
        return next(pin for pin in TABLE["pins"]["servo"] if pin != self.cs)

    @property
    def power(self):
        """The inputs for voltage and current of the feature power."""
        return [pin for pin in TABLE["pins"]["power"] if pin != self.cs][:2]

    @property
    def outputs(self):
        """The eight outputs of the feature outputs."""
        free = [
            pin for pin in TABLE["pins"]["outputs"] if pin not in (self.cs, self.servo, *self.power)
        ]
        return [self.servo, *free[:7]]

    @property
    def light(self):
        """None if INT has its pin."""
        return None if self.int == TABLE["pins"]["light"] else TABLE["pins"]["light"]

    @property
    def target(self):
        return f"avr-specs/avr-{self.chip}.json"

    @property
    def bit_rate(self):
        """The highest one, and the default."""
        return 1_000_000 if self.crystal_mhz == 16 else 500_000

    @property
    def name(self):
        """Of the ELF."""
        entry = TABLE["shields"][self.shield]
        own = [
            text
            for key, text in [
                ("cs", f"cs{self.cs}"),
                ("int", f"int{self.int}"),
                ("crystal_mhz", f"{self.crystal_mhz}MHz"),
            ]
            if getattr(self, key) != entry[key]
        ]
        return "-".join([self.board, self.shield, *own])

    @property
    def wiring(self):
        """How the program expects the MCP2515 and what else is wired, in words."""
        words = (
            f"{TABLE['boards'][self.board]['title']}, {TABLE['shields'][self.shield]['title']}: "
            f"CS on {self.cs}, INT on {self.int}, crystal {self.crystal_mhz} MHz, "
            f"bus {self.bit_rate // 1000} kbit/s, servo on {self.servo}"
        )
        if self.preset != "full":
            return words
        voltage, current = self.power
        others = " ".join(self.outputs[1:])
        return f"{words}, outputs 2 to 8 on {others}, voltage on {voltage}, current on {current}"

    @property
    def options(self):
        """The choice as options of a script."""
        return [
            "--board",
            self.board,
            "--shield",
            self.shield,
            "--cs",
            self.cs,
            "--int",
            self.int,
            "--crystal",
            str(self.crystal_mhz),
        ]

    @property
    def environment(self):
        """For build.rs."""
        return {
            "NODE_BOARD": self.board,
            "NODE_SHIELD": self.shield,
            "NODE_CS": self.cs,
            "NODE_INT": self.int,
            "NODE_CRYSTAL_MHZ": str(self.crystal_mhz),
        }


def output(*command):
    """What a command prints, without spaces around it."""
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout.strip()


FIRMWARE = "src boot crates/dronecan-wire/src crates/mcp2515-ordered/src avr-specs build.rs"
FIRMWARE += " Cargo.toml .cargo/config.toml rust-toolchain.toml"


def firmware_changed_since(commit):
    """Files of the firmware that have changed since a commit; None if it is not in this clone."""
    commit = commit.split("-")[0]
    # A file in which only comments of Rust have changed does not count.
    line = ["git", "diff", "--numstat", "-I", "^[[:space:]]*//", commit, "--", *FIRMWARE.split()]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        return None
    names = [row.split("\t")[2] for row in done.stdout.splitlines()]
    was, now = output("git", "show", f"{commit}:Cargo.toml"), (ROOT / "Cargo.toml").read_text()
    same = {"Cargo.toml"} if without_host(was) == without_host(now) else set()
    return [name for name in names if "tests" not in name and name not in same]


def without_host(manifest):
    """A Cargo.toml without the profiles of tests and of the page, which no firmware has."""
    read = tomllib.loads(manifest)
    for name in ("dev", "web"):
        del read["profile"][name]
    return read


def fill(page, word, blocks, check=False):
    """Writes blocks of a page, or with `check` fails if they differ: what is between the comments
    "name: from make word" and "end".
    """
    text = old = (ROOT / page).read_text()
    for name, content in blocks.items():
        begin, end = f"<!-- {name}: from make {word} -->", "<!-- end -->"
        text, count = re.subn(
            rf"{begin}.*?{end}", lambda _: f"{begin}\n\n{content}\n\n{end}", text, flags=re.S
        )
        if count != 1:
            sys.exit(f"{page} has no place for this block: write {begin} and {end}")
    if check and text != old:
        sys.exit(f'{page} has another text than its sources: run "make {word}"')
    (ROOT / page).write_text(text)


def table(heads, rows):
    """Of Markdown. All but the first column are numbers, or text as narrow as a number."""
    lines = [heads, ["---"] + ["---:"] * (len(heads) - 1), *rows]
    cells = ([f"{cell:,}" if isinstance(cell, int) else cell for cell in row] for row in lines)
    return "\n".join(f"| {' | '.join(row)} |" for row in cells)


def size(elf):
    """Flash and static RAM of a program in bytes. Of a HEX file only the first means anything."""
    text, data, bss = map(int, output("avr-size", elf).splitlines()[1].split()[:3])
    return text + data, data + bss


def upload_lines():
    """avrdude's line for each board, with the default CAN board. All their bootloaders, and ours,
    speak what avrdude calls `arduino`.
    """
    return "\n".join(
        upload_line(name, f"{name}-{TABLE['default_shield']}") for name in TABLE["boards"]
    )


def upload_line(board, file):
    """avrdude's line for a board and the name of a file without its extension."""
    entry = TABLE["boards"][board]
    command = (
        f"avrdude -c arduino -p {entry['chip']} -b {entry['upload_baud']} -D -P /dev/ttyUSB0 -U "
        f"flash:w:{file}.hex:i"
    )
    return f"    {command:<97}  # {entry['title']}"


def bootloader_commands(board, hex_file, stock, programmer, port):
    """The calls of avrdude: first erase and fuses, then flash and lock bits."""
    chip = TABLE["chips"][board.chip]
    fuses = chip["fuses"] | (
        TABLE["boards"][board.board].get("stock_fuses", {}) if stock else {}
    )
    avrdude = ["avrdude", "-c", programmer, "-p", board.chip]
    if port:
        avrdude += ["-P", port]
    if programmer == "avrisp":
        avrdude += ["-b", str(ARDUINO_ISP_BAUD)]
    lock = STOCK_LOCKED if stock else LOCKED
    yield [
        *avrdude,
        "-e",
        "-U",
        f"lock:w:0x{UNLOCKED:02X}:m",
        *(word for name, value in fuses.items() for word in ("-U", f"{name}:w:0x{value:02X}:m")),
    ]
    yield [*avrdude, "-U", f"flash:w:{hex_file}:i", "-U", f"lock:w:0x{lock:02X}:m"]


def parser(text):
    """For the options of a script, whose first comment is its help."""
    return argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def add_options(parser):
    group = parser.add_argument_group("board")
    group.add_argument(
        "--board",
        default="",
        help=f"one of {', '.join(TABLE['boards'])} [default: {TABLE['default_board']}]",
    )
    group.add_argument(
        "--shield",
        default="",
        help=f"one of {', '.join(TABLE['shields'])} [default: {TABLE['default_shield']}]",
    )
    group.add_argument(
        "--cs", default="", help="pin of the MCP2515's CS, such as D8, if it is not the shield's"
    )
    group.add_argument("--int", default="", help="pin of its INT, D2 or D3")
    group.add_argument("--crystal", default="", help="its crystal in MHz, 8 or 16")


def words(arguments):
    """What the user has told make about the board, such as BOARD=nano SHIELD=module; with a space
    after each.
    """
    names = ("board", "shield", "cs", "int", "crystal")
    given = [(name, getattr(arguments, name)) for name in names if getattr(arguments, name)]
    return "".join(f"{name.upper()}={value} " for name, value in given)


def choose(arguments):
    """The choice that the options say. Ends the program with the right names if one is wrong."""
    board = entry("BOARD", "boards", arguments.board or TABLE["default_board"])
    shield = entry("SHIELD", "shields", arguments.shield or TABLE["default_shield"])
    wiring = TABLE["shields"][shield]
    cs = pin("CS", arguments.cs) if arguments.cs else wiring["cs"]
    interrupt = pin("INT", arguments.int) if arguments.int else wiring["int"]
    if interrupt not in INTERRUPTS:
        sys.exit(
            f"INT={arguments.int}: use {' or '.join(INTERRUPTS)}. Only they have an interrupt of "
            "their own."
        )
    if cs not in pins_for_cs():
        sys.exit(f"CS={arguments.cs}: the pin is taken. Use one of {', '.join(pins_for_cs())}.")
    crystal = (
        arguments.crystal.upper().removesuffix("MHZ").strip()
        if arguments.crystal
        else str(wiring["crystal_mhz"])
    )
    if crystal not in map(str, CRYSTALS_MHZ):
        sys.exit(
            f"CRYSTAL={arguments.crystal}: use {' or '.join(map(str, CRYSTALS_MHZ))}, in MHz, as "
            "it is stamped on the crystal."
        )
    return Choice(board, shield, cs, interrupt, int(crystal))


def pins_for_cs():
    """The pins that CS can have: those without another signal, or from which the other moves."""
    taken = {*TAKEN, *INTERRUPTS, *(TABLE["pins"][name] for name in ("light", "button", "sensor"))}
    return [name for name in PINS if name not in taken]


def every():
    """Each board with each CAN board."""
    for board in TABLE["boards"]:
        for shield, wiring in TABLE["shields"].items():
            yield Choice(board, shield, wiring["cs"], wiring["int"], wiring["crystal_mhz"])


def entry(option, table, name):
    if name not in TABLE[table]:
        sys.exit(f"{option}={name} is wrong. Use one of {', '.join(TABLE[table])}.")
    return name


def pin(option, name):
    if name.upper() not in PINS:
        sys.exit(f"{option}={name}: no pin has this name. Use the Arduino's names, such as D10.")
    return name.upper()
