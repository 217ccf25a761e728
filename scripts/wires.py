"""How a CAN board, servos and the rest are wired to an Arduino, from avr-specs/boards.toml: as text
for scripts/wiring-page, and as an SVG drawing for the page of web/.
"""

import boards
from boards import TABLE
from drawing import WIRES, Drawing

# Between two columns of text.
LINE = "─────"
# What the wires of the MCP2515 carry, by pin of the Arduino and of the CAN board. All others but
# those of outputs are grey.
KINDS = {"5V": "plus", "CS": "cs", "INT": "int"} | dict.fromkeys(("SO", "SI", "SCK"), "spi")
STYLE = """\
<style>
.cs, .int, .spi, .output { fill: none; stroke-width: 1.6 }
.cs { stroke: #bc6c00 }
.int { stroke: #8250df }
.spi { stroke: #0969da }
.output { stroke: #1a7f37 }
@media (prefers-color-scheme: dark) {
.cs { stroke: #d29922 }
.int { stroke: #a371f7 }
.spi { stroke: #4493f8 }
.output { stroke: #3fb950 }
}
</style>
"""
# Of the drawing, in pixels: height of a row and of the gap between two boxes, upper edge of the
# first row, right edge of the Arduino, left edge of the other boxes, right edges of the CAN board's
# and of the others.
WIDTH, ROW, GAP, TOP = 460, 20, 16, 32
ARDUINO, LEFT, SHORT, RIGHT = 80, 150, 290, 458


def choice_of(shield, board=TABLE["default_board"]):
    """An Arduino with a CAN board. All Arduinos have the same pins."""
    entry = TABLE["shields"][shield]
    return boards.Choice(board, shield, entry["cs"], entry["int"], entry["crystal_mhz"])


def controller(choice):
    """The wires of the MCP2515: pin of the Arduino, pin of the CAN board."""
    power = [("5V", "VCC"), ("GND", "GND")]
    is_wired = TABLE["shields"][choice.shield].get("is_wired")
    return (power if is_wired else []) + [
        (choice.cs, "CS"),
        ("D12", "SO"),
        ("D11", "SI"),
        ("D13", "SCK"),
        (choice.int, "INT"),
    ]


def others(choice):
    """The other wires: pin, what is on it, and what else it needs."""
    pins = TABLE["pins"]
    return [
        (pins["sensor"], "LM35, output", "its other pins go to 5V and GND"),
        (pins["light"], "330 ohms, LED, GND", "with the feature lights"),
        (pins["button"], "button, GND", "with the feature button"),
    ]


def hub(choice):
    """The eight outputs and the circuit of an ATmega328P."""
    return [
        *((pin, f"servo {n}, signal") for n, pin in enumerate(choice.outputs, 1)),
        ("GND", "- of the servos' own supply, whose + goes to the servos only"),
        (choice.power[0], "voltage: middle of a divider from the battery to GND, at most 5 V"),
        (choice.power[1], "current: output of an ACS712, or of an INA180 with its shunt"),
    ]


def lines(head, rows):
    """Wires as lines of text."""
    left, right = head
    return [
        f"{left:>9}  {' ' * len(LINE)}  {right}",
        *(f"{pin:>9}  {LINE}  {what}" for pin, what in rows),
    ]


def text(shield):
    """One CAN board on any Arduino, as text."""
    choice = choice_of(shield)
    if TABLE["shields"][shield].get("is_wired"):
        head = "CAN board"
    else:
        head = "shield, which makes these connections when it is plugged on"
    servo = "its + and - go to a supply of their own, its - also to GND"
    rest = [(choice.servo, "servo, signal", servo), *others(choice)]
    rest = [(pin, f"{what:<18}  {how}") for pin, what, how in rest]
    return "\n".join(
        [
            *lines(("Arduino", head), controller(choice)),
            "",
            *lines(("Arduino", "the rest"), rest),
            "",
            *lines(("CAN board", "the bus"), [("H", "CAN high"), ("L", "CAN low")]),
        ]
    )


def hub_text(shield):
    """The eight outputs of an ATmega328P with a CAN board, as text."""
    return "\n".join(lines(("Arduino", "the rest"), hub(choice_of(shield))))


def svg(shield, chip):
    """The wires of a CAN board on an Arduino with a chip, as a drawing."""
    choice = choice_of(shield)
    on_board = controller(choice)
    servos = [(choice.servo, "servo")]
    rest = [(pin, f"{what}: {how}") for pin, what, how in others(choice)]
    if chip == "atmega328p":
        servos = [(pin, f"servo {n}") for n, pin in enumerate(choice.outputs, 1)]
        rest += [
            (choice.power[0], "voltage: from a divider, at most 5 V"),
            (choice.power[1], "current: ACS712, or INA180 and shunt"),
        ]
    rows = len(on_board) + len(servos) + 1 + len(rest)
    height = TOP + ROW * rows + 4 * GAP
    drawing = Drawing(WIDTH, height, f"Wiring: {TABLE['shields'][shield]['title']}")
    drawing.parts.append(WIRES + STYLE)
    drawing.box(2, 2, ARDUINO, height - 4, [])
    drawing.text(2 + ARDUINO // 2, 20, "Arduino")

    y = TOP
    is_wired = TABLE["shields"][shield].get("is_wired")
    drawing.box(LEFT, y - ROW, SHORT - LEFT, ROW * (len(on_board) + 1) + 6, [], kind="strong")
    drawing.text((LEFT + SHORT) // 2, y - 5, "CAN board" if is_wired else "shield, plugged on")
    for pin, what in on_board:
        wire(drawing, y, pin, what, KINDS.get(pin, KINDS.get(what, "wire")))
        y += ROW
    bus(drawing, y - ROW * 4)

    y += GAP
    drawing.box(LEFT, y - 4, RIGHT - LEFT, ROW * len(servos) + 8, [])
    for pin, what in servos:
        wire(drawing, y, pin, f"{what}, signal", "output")
        y += ROW
    y += GAP // 2
    supply(drawing, y, len(servos))

    y += ROW + GAP
    drawing.box(LEFT, y - 4, RIGHT - LEFT, ROW * len(rest) + 8, [])
    for pin, what in rest:
        wire(drawing, y, pin, what, "wire")
        y += ROW
    return drawing.svg()


def wire(drawing, y, pin, what, kind):
    """A row whose upper edge is at y: from a pin of the Arduino to what is on it."""
    drawing.wire(kind, (ARDUINO + 2, y + ROW // 2), (LEFT, y + ROW // 2))
    drawing.text(ARDUINO - 4, y + ROW // 2 + 4, pin, anchor="end")
    drawing.text(LEFT + 8, y + ROW // 2 + 4, what, small=True, anchor="start")


def bus(drawing, y):
    """The bus, from the right edge of the CAN board."""
    for row, name in enumerate("HL"):
        line = y + ROW * row + ROW // 2
        drawing.wire("can", (SHORT, line), (SHORT + 40, line))
        drawing.text(SHORT - 6, line + 4, name, small=True, anchor="end")
    lines = ["CAN bus", "120 ohms", "at each end"]
    drawing.box(SHORT + 40, y - 8, RIGHT - SHORT - 40, ROW * 2 + 16, lines)


def supply(drawing, y, servos):
    """The supply of the servos, in a row below them, with its wires to each of them."""
    drawing.box(LEFT, y, RIGHT - LEFT, ROW, [])
    wire(drawing, y, "GND", "own supply of the servos", "wire")
    for x, name, kind in [(RIGHT - 44, "-", "wire"), (RIGHT - 20, "+", "plus")]:
        drawing.text(x, y + ROW // 2 + 4, name)
        drawing.wire(kind, (x, y), (x, y - GAP // 2 - ROW * servos + ROW // 2))
        for row in range(servos):
            drawing.dot(kind, x, y - GAP // 2 - ROW * row - ROW // 2)
