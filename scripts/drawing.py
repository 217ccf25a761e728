"""An SVG drawing of boxes and lines, for scripts/drawings and scripts/wires.py."""

from html import escape

# Readable on white and on black: a reader may have either.
STYLE = """\
<style>
text { fill: #24292f; font: 13px sans-serif }
.small { font-size: 11px; fill: #57606a }
.box { fill: #f6f8fa; stroke: #57606a }
.strong { fill: #cfe4fb; stroke: #0969da }
.free { fill: #ffffff; stroke: #57606a; stroke-dasharray: 4 3 }
.line { fill: none; stroke: #57606a; stroke-width: 1.4; marker-end: url(#head) }
.head { fill: #57606a }
@media (prefers-color-scheme: dark) {
text { fill: #e6edf3 }
.small { fill: #9198a1 }
.box { fill: #262c36; stroke: #9198a1 }
.strong { fill: #12335c; stroke: #4493f8 }
.free { fill: #0d1117; stroke: #9198a1 }
.line { stroke: #9198a1 }
.head { fill: #9198a1 }
}
</style>
<marker id="head" markerWidth="9" markerHeight="8" refX="8" refY="4" orient="auto" \
markerUnits="userSpaceOnUse"><path class="head" d="M0 0 9 4 0 8z"/></marker>
"""

# Wires: what they carry decides their colour.
WIRES = """\
<style>
.wire { fill: none; stroke: #57606a; stroke-width: 1.6 }
.can { fill: none; stroke: #0969da; stroke-width: 1.6 }
.plus { fill: none; stroke: #cf222e; stroke-width: 1.6 }
.dot-wire { fill: #57606a }
.dot-can { fill: #0969da }
.dot-plus { fill: #cf222e }
@media (prefers-color-scheme: dark) {
.wire { stroke: #9198a1 }
.can { stroke: #4493f8 }
.plus { stroke: #f85149 }
.dot-wire { fill: #9198a1 }
.dot-can { fill: #4493f8 }
.dot-plus { fill: #f85149 }
}
</style>
"""


class Drawing:
    """Boxes, text and lines. Units are pixels, from the upper left corner."""

    def __init__(self, width, height, title):
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
            f'width="{width}" role="img">\n<title>{escape(title)}</title>\n'
        )
        self.parts = [head + STYLE]

    def text(self, x, y, text, small=False, anchor="middle"):
        size = ' class="small"' if small else ""
        self.parts.append(
            f'<text x="{x}" y="{y}" text-anchor="{anchor}"{size}>{escape(text)}</text>\n'
        )

    def box(self, x, y, width, height, lines, kind="box"):
        """A box with lines of text in its middle, the first one larger."""
        self.parts.append(
            f'<rect class="{kind}" x="{x}" y="{y}" width="{width}" height="{height}" rx="4"/>\n'
        )
        top = y + height / 2 + 4 - 8 * (len(lines) - 1)
        for number, line in enumerate(lines):
            self.text(x + width / 2, top + 16 * number, line, small=number > 0)

    def wire(self, kind, *points):
        path = " ".join(f"{x} {y}" for x, y in points)
        self.parts.append(f'<path class="{kind}" d="M{path}"/>\n')

    def dot(self, kind, x, y):
        self.parts.append(f'<circle class="dot-{kind}" cx="{x}" cy="{y}" r="3.5"/>\n')

    def arrow(self, *points):
        self.parts.append(f'<path class="line" d="M{" ".join(f"{x} {y}" for x, y in points)}"/>\n')

    def svg(self):
        return "".join(self.parts) + "</svg>\n"
