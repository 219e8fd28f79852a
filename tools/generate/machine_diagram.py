"""The block diagram of docs/build-the-machine.md, with the nets of `pins.h` on its wires."""

from __future__ import annotations

from dataclasses import dataclass
from xml.sax.saxutils import escape

from tools.generate.board_source import pins

WIDTH, HEIGHT = 1040, 764
ROW, TOP, BLOCK = 56, 76, 42
"""Distance of rows, middle of the first one, height of a block."""
LEFT, CHIP, MIDDLE, RIGHT = (20, 190), (318, 438), (608, 800), (850, 1020)
"""Columns, from x to x."""
LOW, DEADLY, PLAIN = ("#e8f1fb", "#3b6ea5"), ("#fdeaea", "#b3261e"), ("#f1f1ee", "#6b6b66")
"""Fill and edge: below 25 V, may kill, other things."""

STYLE = (
    "text { font-family: system-ui, 'Segoe UI', Helvetica, Arial, sans-serif; fill: #1c1c1a } "
    ".t { font-size: 12.5px } .s { font-size: 11px; fill: #4a4a46 } .n { font-size: 10.5px; font-family: "
    "ui-monospace, Menlo, Consolas, 'DejaVu Sans Mono', monospace } .h { font-size: 16px; font-weight: "
    "bold } "
    ".c { font-size: 12px; font-weight: bold }"
)


@dataclass(frozen=True, slots=True)
class Block:
    """A box of one or two lines of text in a column; it reaches from its row over `rows`."""

    column: tuple[int, int]
    row: float
    title: str
    small: str = ""
    kind: tuple[str, str] = LOW
    rows: int = 1


@dataclass(frozen=True, slots=True)
class Wire:
    """Nets between the chip and what stands beside it in a row; `out`: driven by the chip, `both`: some of them."""

    side: tuple[int, int]
    row: float
    nets: tuple[str, ...]
    out: bool = False
    both: bool = False


BLOCKS = (
    Block(LEFT, 0, "computer", "edmctl", PLAIN),
    Block(LEFT, 1, "USB isolator", "to the ST-LINK's socket", PLAIN),
    Block(LEFT, 4, "dielectric", "level, flow, temperature", PLAIN),
    Block(LEFT, 6, "limit switches", "24 V loop, optocoupler", PLAIN),
    Block(LEFT, 11, "e-stop, door, contactor", "24 V loops, optocouplers", PLAIN),
    Block(MIDDLE, 0, "converter, buffer, clamp", "converter on the board's 5 V"),
    Block(MIDDLE, 1, "monitor divider", "of the actuator's voltage"),
    Block(MIDDLE, 2, "conditioning", "of the displacement sensor"),
    Block(MIDDLE, 3, "step drivers, 74HCT", "pull-downs at the inputs"),
    Block(MIDDLE, 4, "charge pump, e-stop", "enable the high voltage"),
    Block(MIDDLE, 5, "set points", "pull-downs, scaling amplifier"),
    Block(MIDDLE, 6, "gate driver, read back", "isolated"),
    Block(MIDDLE, 7, "drive of the mode switch"),
    Block(MIDDLE, 8, "contact circuit", "below 1 V"),
    Block(MIDDLE, 9, "gap divider", "1 : 100, clamp, buffer"),
    Block(MIDDLE, 10, "amplifier, comparators", "ignition, over-current"),
    Block(MIDDLE, 11, "break chain", "healthy = high; 1 µs filter"),
    Block(RIGHT, 0, "amplifier, 0–150 V", "mains by the contactor", DEADLY),
    Block(RIGHT, 1, "piezo actuator", "carries the tool", DEADLY),
    Block(RIGHT, 2, "displacement sensor", "looks at the actuator"),
    Block(RIGHT, 3, "stages X, Y, theta", "carry the work"),
    Block(RIGHT, 4, "high voltage, reservoir", "mains by the contactor", DEADLY, rows=2),
    Block(RIGHT, 6, "transistor, resistors", "high side", DEADLY),
    Block(RIGHT, 7, "mode switch", "at the gap's plus", DEADLY, rows=2),
    Block(RIGHT, 9, "gap: tool, work", "in the dielectric", DEADLY),
    Block(RIGHT, 10, "shunt", kind=DEADLY),
    Block(RIGHT, 11, "star point", "gap minus, ground, earth", PLAIN),
)
WIRES = (
    Wire(LEFT, 1, ("LINE_OUT", "LINE_IN"), both=True),
    Wire(LEFT, 4, ("LEVEL", "FLOW", "TEMPERATURE")),
    Wire(LEFT, 6, ("LIMITS",)),
    Wire(LEFT, 9.6, ("ESTOP", "DOOR")),
    Wire(MIDDLE, 0, ("DAC_CLOCK", "DAC_DATA", "DAC_SELECT"), out=True),
    Wire(MIDDLE, 1, ("MONITOR",)),
    Wire(MIDDLE, 2, ("DISPLACEMENT",)),
    Wire(
        MIDDLE,
        3,
        ("STEP_X", "STEP_Y", "STEP_THETA", "DIRECTION_X", "DIRECTION_Y", "DIRECTION_THETA"),
        out=True,
    ),
    Wire(MIDDLE, 4, ("ALIVE",), out=True),
    Wire(MIDDLE, 5, ("OPEN_VOLTAGE", "PEAK_CURRENT", "HV_SUPPLY"), both=True),
    Wire(MIDDLE, 6, ("GATE", "GATE_SENSE"), both=True),
    Wire(MIDDLE, 7, ("MODE",), out=True),
    Wire(MIDDLE, 8, ("CONTACT",)),
    Wire(MIDDLE, 9, ("GAP_VOLTAGE",)),
    Wire(MIDDLE, 10, ("GAP_CURRENT", "IGNITION", "IGNITION_TIMER")),
)
JOINED = ("DISCHARGE_TIMER", "DISCHARGE_END")
"""A bridge between two pins of the chip."""
CHAIN = "BREAK_CHAIN"
TO_THE_RIGHT = {0: ">", 1: "<", 2: "<", 3: ">", 4: ">", 5: "<>", 6: "<>", 7: ">", 8: "<", 9: "<", 10: "<"}
"""Which way signals go between the two columns on the right, by row."""
DOWN = (0, 5, 6, 8, 9, 10)
"""Power goes on to the block below."""


def nets_shown() -> set[str]:
    """Return every net that stands on the diagram."""
    return {net for wire in WIRES for net in wire.nets} | set(JOINED) | {CHAIN}


def _y(row: float) -> float:
    return TOP + ROW * row


def _box(block: Block) -> str:
    x, end = block.column
    y, height = _y(block.row) - BLOCK / 2, BLOCK + ROW * (block.rows - 1)
    fill, edge = block.kind
    middle, centre = (x + end) / 2, y + height / 2
    lines = [
        f'<rect x="{x}" y="{y:g}" width="{end - x}" height="{height}" rx="5" fill="{fill}" '
        f'stroke="{edge}" stroke-width="1.4"/>'
    ]
    lines.append(
        f'<text class="t" x="{middle:g}" y="{centre - 2 if block.small else centre + 4:g}" '
        f'text-anchor="middle">{escape(block.title)}</text>'
    )
    if block.small:
        lines.append(
            f'<text class="s" x="{middle:g}" y="{centre + 13:g}" '
            f'text-anchor="middle">{escape(block.small)}</text>'
        )
    return "\n".join(lines)


def _line(
    points: list[tuple[float, float]], begin: bool, end: bool, colour: str = "#4a4a46", width: float = 1.4
) -> str:
    path = " ".join(f"{x:g},{y:g}" for x, y in points)
    heads = (' marker-start="url(#a)"' if begin else "") + (' marker-end="url(#a)"' if end else "")
    return f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="{width:g}"{heads}/>'


def _labels(nets: tuple[str, ...], where: dict[str, str], x: float, y: float) -> list[str]:
    """Net and pin: one above the wire, or one above and one below, or the six of the stages in two lines."""
    if nets[0].startswith("STEP"):
        spans = [" ".join(where[net] for net in nets[i : i + 3]) for i in (0, 3)]
        texts = [(f"STEP_* {spans[0]}", -5.0), (f"DIRECTION_* {spans[1]}", 13.0)]
    elif len(nets) <= 2:
        texts = [(f"{net} {where[net]}", offset) for net, offset in zip(nets, (-5.0, 13.0), strict=False)]
    else:
        texts = [
            (f"{net} {where[net]}", offset) for net, offset in zip(nets, (-18.0, -5.0, 13.0), strict=True)
        ]
    return [
        f'<text class="n" x="{x:g}" y="{y + offset:g}" text-anchor="middle">{escape(text)}</text>'
        for text, offset in texts
    ]


def _wire(wire: Wire, where: dict[str, str]) -> list[str]:
    left = wire.side == LEFT
    begin, end = (LEFT[1], CHIP[0]) if left else (CHIP[1], MIDDLE[0])
    y = _y(wire.row)
    into_left = wire.both or wire.out == left
    into_right = wire.both or wire.out != left
    points = [(float(begin), y), (float(end), y)]
    return [_line(points, into_left, into_right), *_labels(wire.nets, where, (begin + end) / 2, y)]


def _chip(where: dict[str, str]) -> list[str]:
    x, end = CHIP
    top, bottom = _y(0) - BLOCK / 2, _y(10) + BLOCK / 2
    middle = (x + end) / 2
    bridge_y = _y(7.7)
    names = [f"{net} {where[net]}" for net in JOINED]
    return [
        f'<rect x="{x}" y="{top:g}" width="{end - x}" height="{bottom - top:g}" rx="6" fill="#eef6ee" '
        'stroke="#3f7d45" stroke-width="1.6"/>',
        f'<text class="c" x="{middle:g}" y="{_y(2):g}" text-anchor="middle">NUCLEO-</text>',
        f'<text class="c" x="{middle:g}" y="{_y(2) + 16:g}" text-anchor="middle">F429ZI</text>',
        f'<text class="s" x="{middle:g}" y="{_y(2) + 34:g}" text-anchor="middle">5 V at E5V</text>',
        f'<text class="s" x="{middle:g}" y="{bridge_y - 20:g}" text-anchor="middle">bridge on it:</text>',
        *(
            f'<text class="n" x="{middle:g}" y="{bridge_y - 4 + 13 * i:g}" text-anchor="middle" '
            f'textLength="{min(112, 6.4 * len(name)):g}" lengthAdjust="spacingAndGlyphs">{name}</text>'
            for i, name in enumerate(names)
        ),
    ]


def _between() -> list[str]:
    """Wires of the two columns on the right, of power, and of the break chain."""
    drawn = []
    for row, way in TO_THE_RIGHT.items():
        points = [(float(MIDDLE[1]), _y(row)), (float(RIGHT[0]), _y(row))]
        drawn.append(_line(points, "<" in way, ">" in way))
    middle = (RIGHT[0] + RIGHT[1]) / 2
    drawn += [
        _line([(middle, _y(row) + BLOCK / 2), (middle, _y(row + 1) - BLOCK / 2)], False, True, DEADLY[1], 2.4)
        for row in DOWN
    ]
    sight = [(middle, _y(2) - BLOCK / 2), (middle, _y(1) + BLOCK / 2)]
    drawn.append(_line(sight, False, False).replace("/>", ' stroke-dasharray="3 3"/>'))
    # Over-current into the chain, the chain into the chip, the loops into the chain and into the chip.
    chain = (MIDDLE[0] + MIDDLE[1]) / 2
    drawn.append(_line([(chain, _y(10) + BLOCK / 2), (chain, _y(11) - BLOCK / 2)], False, True))
    x = CHIP[1] - 24.0
    drawn.append(
        _line([(float(MIDDLE[0]), _y(11) - 9), (x, _y(11) - 9), (x, _y(10) + BLOCK / 2)], False, True)
    )
    drawn.append(_line([(float(LEFT[1]), _y(11) + 9), (float(MIDDLE[0]), _y(11) + 9)], False, True))
    loop = (LEFT[0] + LEFT[1]) / 2
    drawn.append(
        _line([(loop, _y(11) - BLOCK / 2), (loop, _y(9.6)), (float(LEFT[1]), _y(9.6))], False, False)
    )
    usb = (LEFT[0] + LEFT[1]) / 2
    drawn.append(_line([(usb, _y(0) + BLOCK / 2), (usb, _y(1) - BLOCK / 2)], False, False))
    return drawn


def picture() -> str:
    """Return the diagram as SVG, on a light ground of its own."""
    where = {pin.net: pin.name for pin in pins()}
    foot = _y(11) + BLOCK / 2 + 26
    legend = [
        (LEFT[0], LOW, "below 25 V, on the star point's ground"),
        (LEFT[0] + 270, DEADLY, "can kill: 150 V, 300 V, energy stored"),
        (LEFT[0] + 540, PLAIN, "isolated, or not electronics of this page"),
    ]
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img">',
        "<title>Block diagram of the machine: controller, circuits, high voltage, actuator</title>",
        f"<style>{STYLE}</style>",
        '<defs><marker id="a" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" '
        'markerUnits="userSpaceOnUse" '
        'orient="auto-start-reverse"><path d="M0,0.5 L8,4 L0,7.5 z" fill="#4a4a46"/></marker></defs>',
        f'<rect x="0.5" y="0.5" width="{WIDTH - 1}" height="{HEIGHT - 1}" rx="8" fill="#ffffff" '
        'stroke="#c9c9c4"/>',
        f'<text class="h" x="{LEFT[0]}" y="32">The machine about its controller</text>',
        *_between(),
        *(line for wire in WIRES for line in _wire(wire, where)),
        *_chip(where),
        *(_box(block) for block in BLOCKS),
        f'<text class="n" x="{(CHIP[1] + MIDDLE[0]) / 2:g}" y="{_y(11) - 14:g}" '
        f'text-anchor="middle">{CHAIN} {where[CHAIN]}</text>',
        f'<text class="s" x="{(LEFT[1] + CHIP[1]) / 2:g}" y="{_y(11) + 24:g}" text-anchor="middle">e-stop '
        "and door in series</text>",
        f'<text class="s" x="{MIDDLE[1] - 8}" y="{_y(10.5) + 4:g}" text-anchor="end">over-current</text>',
    ]
    for x, (fill, edge), text in legend:
        lines.append(
            f'<rect x="{x}" y="{foot - 10:g}" width="16" height="12" rx="2" fill="{fill}" stroke="{edge}"/>'
        )
        lines.append(f'<text class="s" x="{x + 22}" y="{foot:g}">{escape(text)}</text>')
    return "\n".join([*lines, "</svg>", ""])
