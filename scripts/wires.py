"""How a CAN board, servos and the rest are wired to an Arduino, from avr-specs/boards.toml: as text
for scripts/wiring-page, and as an SVG drawing for the page of web/.
"""

from html import escape

import boards
from boards import TABLE

# Between two columns of text.
LINE = "─────"
# What the wires of the MCP2515 carry, by pin of the Arduino and of the CAN board. All others but
# those of outputs are grey.
KINDS = {"5V": "plus", "CS": "cs", "INT": "int"} | dict.fromkeys(("SO", "SI", "SCK"), "spi")
# Of the drawing, in pixels: height of a row and of the gap between two boxes, upper edge of the
# first row, right edge of the Arduino, left edge of the other boxes, right edges of the CAN board's
# and of the others.
WIDTH, ROW, GAP, TOP = 460, 20, 16, 32
ARDUINO, LEFT, SHORT, RIGHT = 80, 150, 290, 458
# Classes: a colour on white, and one on black.
STROKES = {
    "wire": ("#57606a", "#9198a1"),
    "can": ("#0969da", "#4493f8"),
    "plus": ("#cf222e", "#f85149"),
    "cs": ("#bc6c00", "#d29922"),
    "int": ("#8250df", "#a371f7"),
    "spi": ("#0969da", "#4493f8"),
    "output": ("#1a7f37", "#3fb950"),
    "box": ("#57606a", "#9198a1"),
    "strong": ("#0969da", "#4493f8"),
}
FILLS = {
    "text": ("#24292f", "#e6edf3"),
    "small": ("#57606a", "#9198a1"),
    "box": ("#f6f8fa", "#262c36"),
    "strong": ("#cfe4fb", "#12335c"),
}


def choice_of(shield, board=TABLE["default_board"]):
    """An Arduino with a CAN board. All Arduinos have the same pins."""
    entry = TABLE["shields"][shield]
    return boards.Choice(board, shield, entry["cs"], entry["int"], entry["crystal_mhz"])


def controller(choice):
    """The wires of the MCP2515: pin of the Arduino, pin of the CAN board."""
    power = [("5V", "VCC"), ("GND", "GND")] if is_wired(choice.shield) else []
    return [*power, (choice.cs, "CS"), ("D12", "SO"), ("D11", "SI"), ("D13", "SCK"),
            (choice.int, "INT")]


def is_wired(shield):
    """False if it is plugged on."""
    return TABLE["shields"][shield].get("is_wired")


def others():
    """The other wires: pin, what is on it, and what else it needs."""
    pins = TABLE["pins"]
    return [
        (pins["sensor"], "LM35, output", "its other pins go to 5V and GND"),
        (pins["light"], "330 ohms, LED, GND", "with the feature lights"),
        (pins["button"], "button, GND", "with the feature button"),
    ]


def lines(left, right, rows):
    """Wires as lines of text."""
    head = f"{left:>9}  {' ' * len(LINE)}  {right}"
    return "\n".join([head, *(f"{pin:>9}  {LINE}  {what}" for pin, what in rows)])


def text(shield):
    """One CAN board on any Arduino, as text."""
    choice = choice_of(shield)
    plugged = "shield, which makes these connections when it is plugged on"
    servo = "its + and - go to a supply of their own, its - also to GND"
    rest = [(choice.servo, "servo, signal", servo), *others()]
    rest = [(pin, f"{what:<18}  {how}") for pin, what, how in rest]
    return "\n\n".join([
        lines("Arduino", "CAN board" if is_wired(shield) else plugged, controller(choice)),
        lines("Arduino", "the rest", rest),
        lines("CAN board", "the bus", [("H", "CAN high"), ("L", "CAN low")]),
    ])


def hub_text(shield):
    """The eight outputs and the circuit of an ATmega328P with a CAN board, as text."""
    choice = choice_of(shield)
    return lines("Arduino", "the rest", [
        *((pin, f"servo {n}, signal") for n, pin in enumerate(choice.outputs, 1)),
        ("GND", "- of the servos' own supply, whose + goes to the servos only"),
        (choice.power[0], "voltage: middle of a divider from the battery to GND, at most 5 V"),
        (choice.power[1], "current: output of an ACS712, or of an INA180 with its shunt"),
    ])


def styles(on_black):
    """The rules of all colours."""
    strokes = (f".{name} {{ stroke: {colours[on_black]} }}" for name, colours in STROKES.items())
    fills = (
        f"{name if name == 'text' else f'.{name}'} {{ fill: {colours[on_black]} }}"
        for name, colours in FILLS.items()
    )
    return "\n".join([*strokes, *fills])


class Drawing:
    """An SVG drawing. Units are pixels, from the upper left corner."""

    def __init__(self, width, height, title):
        self.parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
            f'width="{width}" role="img">\n<title>{escape(title)}</title>\n<style>\n'
            "text { font: 13px sans-serif } .small { font-size: 11px }\n"
            "path { fill: none; stroke-width: 1.6 }\n"
            f".dot {{ stroke-width: 7; stroke-linecap: round }}\n{styles(False)}\n"
            f"@media (prefers-color-scheme: dark) {{\n{styles(True)}\n}}\n</style>\n"
        ]

    def text(self, x, y, text, small=False, anchor="middle"):
        size = ' class="small"' if small else ""
        self.parts.append(
            f'<text x="{x}" y="{y}" text-anchor="{anchor}"{size}>{escape(text)}</text>\n'
        )

    def box(self, x, y, width, height, kind="box"):
        self.parts.append(
            f'<rect class="{kind}" x="{x}" y="{y}" width="{width}" height="{height}" rx="4"/>\n'
        )

    def wire(self, kind, *points):
        path = " ".join(f"{x} {y}" for x, y in points)
        self.parts.append(f'<path class="{kind}" d="M{path}"/>\n')

    def row(self, y, pin, what, kind):
        """A row whose upper edge is at y: from a pin of the Arduino to what is on it."""
        self.wire(kind, (ARDUINO + 2, y + ROW // 2), (LEFT, y + ROW // 2))
        self.text(ARDUINO - 4, y + ROW // 2 + 4, pin, anchor="end")
        self.text(LEFT + 8, y + ROW // 2 + 4, what, small=True, anchor="start")

    def bus(self, y):
        """The bus, from the right edge of the CAN board."""
        for row, name in enumerate("HL"):
            line = y + ROW * row + ROW // 2
            self.wire("can", (SHORT, line), (SHORT + 40, line))
            self.text(SHORT - 6, line + 4, name, small=True, anchor="end")
        self.box(SHORT + 40, y - 8, RIGHT - SHORT - 40, ROW * 2 + 16)
        for row, line in enumerate(["CAN bus", "120 ohms", "at each end"]):
            self.text((SHORT + 40 + RIGHT) / 2, y + 8 + 16 * row, line, small=row > 0)

    def supply(self, y, servos):
        """The supply of the servos, in a row below them, with its wires to each of them."""
        self.box(LEFT, y, RIGHT - LEFT, ROW)
        self.row(y, "GND", "own supply of the servos", "wire")
        for x, name, kind in [(RIGHT - 44, "-", "wire"), (RIGHT - 20, "+", "plus")]:
            self.text(x, y + ROW // 2 + 4, name)
            self.wire(kind, (x, y), (x, y - GAP // 2 - ROW * servos + ROW // 2))
            for row in range(servos):
                at = y - GAP // 2 - ROW * row - ROW // 2
                self.parts.append(f'<path class="{kind} dot" d="M{x} {at}h0"/>\n')


def svg(shield, chip):
    """The wires of a CAN board on an Arduino with a chip, as a drawing."""
    choice = choice_of(shield)
    on_board = controller(choice)
    servos = [(choice.servo, "servo")]
    rest = [(pin, f"{what}: {how}") for pin, what, how in others()]
    if chip == "atmega328p":
        servos = [(pin, f"servo {n}") for n, pin in enumerate(choice.outputs, 1)]
        rest += [
            (choice.power[0], "voltage: from a divider, at most 5 V"),
            (choice.power[1], "current: ACS712, or INA180 and shunt"),
        ]
    height = TOP + ROW * (len(on_board) + len(servos) + 1 + len(rest)) + 4 * GAP
    drawing = Drawing(WIDTH, height, f"Wiring: {TABLE['shields'][shield]['title']}")
    drawing.box(2, 2, ARDUINO, height - 4)
    drawing.text(2 + ARDUINO // 2, 20, "Arduino")

    y = TOP
    drawing.box(LEFT, y - ROW, SHORT - LEFT, ROW * (len(on_board) + 1) + 6, kind="strong")
    head = "CAN board" if is_wired(shield) else "shield, plugged on"
    drawing.text((LEFT + SHORT) // 2, y - 5, head)
    for pin, what in on_board:
        drawing.row(y, pin, what, KINDS.get(pin, KINDS.get(what, "wire")))
        y += ROW
    drawing.bus(y - ROW * 4)

    y += GAP
    drawing.box(LEFT, y - 4, RIGHT - LEFT, ROW * len(servos) + 8)
    for pin, what in servos:
        drawing.row(y, pin, f"{what}, signal", "output")
        y += ROW
    y += GAP // 2
    drawing.supply(y, len(servos))

    y += ROW + GAP
    drawing.box(LEFT, y - 4, RIGHT - LEFT, ROW * len(rest) + 8)
    for pin, what in rest:
        drawing.row(y, pin, what, "wire")
        y += ROW
    return "".join(drawing.parts) + "</svg>\n"
