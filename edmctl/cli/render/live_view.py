"""The state of a job as a block of lines, for the width and height that there are.

Wide terminals show bars and charts with their figures beside them, narrow ones the figures alone; where lines are
few, the charts become lower first, and then what matters least is left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.cells import cell_len, set_cell_size

from edmctl.cli.render.charts import PULSE_INKS, SPAN_S, History, chart, depth_bar, pulse_bar
from edmctl.cli.render.layout import Span
from edmctl.cli.render.progress import depth_words, has_pulses, while_cutting
from edmctl.cli.render.style import Ink, Style
from edmctl.dataclasses import dataclass, field
from edmctl.results.progress import Progress
from edmctl.wording import decimal, duration, printable

LABEL = 8
GAP = 2
WIDE, WIDE_WORDS, NARROW_WORDS = 99, 45, 34
"""From `WIDE` cells on the figures have the wider column."""
NARROWEST = 59
"""Below this there are no bars and charts."""
LEAST_HEIGHT_UM = 2.0
"""A chart of the displacement spans at least this, many times the sensor's noise."""
LEAST_GAP_SHARE = 0.2
"""A chart of the gap voltage spans at least this share of its reference."""
_CHART_ROWS = ((3, 26), (2, 12), (1, 0))
"""Rows of a chart, and the height from which on they leave room for all else and some notes."""
_ASCII = str.maketrans(
    {"µ": "u", "±": "+-", "–": "-", "−": "-", "…": "~", "·": "*", "°": " deg ", "×": "x", "→": "->"}
)


@dataclass(slots=True)
class Histories:
    """The last minute of gap voltage and displacement."""

    gap_v: History = field(default_factory=History)
    displacement_um: History = field(default_factory=History)

    def update(self, p: Progress) -> None:
        """Add what came since the last report."""
        for before in p.past:
            self.displacement_um.update(
                before.time_s, before.displacement_low_um, before.displacement_high_um
            )
            self.gap_v.update(before.time_s, before.gap_low_v, before.gap_high_v)
        low_um, high_um = p.displacement_low_um, p.displacement_high_um
        self.displacement_um.update(p.time_s, low_um, high_um)
        low_v, high_v = (p.gap_low_v, p.gap_high_v) if has_pulses(p.ratios) else (math.nan, math.nan)
        self.gap_v.update(p.time_s, low_v, high_v)


@dataclass(frozen=True, slots=True)
class _Place:
    """`words` cells of figures beside `chart` cells of bars (0 on narrow terminals)."""

    width: int
    chart: int
    words: int
    chart_rows: int
    style: Style


def draw_view(
    p: Progress, histories: Histories, width: int, height: int, style: Style
) -> list[tuple[str, int]]:
    """Return the lines, at most `height` of at most `width` cells, each painted and with the cells it takes."""
    place = _place(width, height, style)
    # Each part with its rank: the last ones go first where lines are few.
    parts: list[tuple[int, list[list[Span]]]] = [
        (8, [[]]),
        (0, [_head(p, width, style)]),
        (1, _depth(p, place)),
        (4, _pulses(p, place)),
        (3, _gap(p, histories.gap_v, place)),
        (5, _tool(p, histories.displacement_um, place)),
        (6, _feed(p)),
        (7, _jumps(p)),
        (2, _warning(p)),
    ]
    free, kept = height, set()
    for rank, lines in sorted(parts, key=lambda part: part[0]):
        if len(lines) <= free:
            free -= len(lines)
            kept.add(rank)
    shown = [line for rank, lines in parts if rank in kept for line in lines]
    return [(render_line(line, width, style), _cells(line, width, style)) for line in shown]


def _cells(line: Sequence[Span], width: int, style: Style) -> int:
    return min(width, sum(cell_len(text if style.unicode else plain_ascii(text)) for text, _ in line))


def _place(width: int, height: int, style: Style) -> _Place:
    words = WIDE_WORDS if width >= WIDE else NARROW_WORDS
    beside = width >= NARROWEST
    chart_rows = next(rows for rows, least in _CHART_ROWS if height >= least)
    return _Place(
        width=width,
        chart=width - LABEL - GAP - words if beside else 0,
        words=words if beside else max(0, width - LABEL),
        chart_rows=chart_rows if beside else 1,
        style=style,
    )


def _row(label: str, bar: list[Span], words: list[Span]) -> list[Span]:
    line: list[Span] = [(f"{label:{LABEL}}", Ink.FAINT)]
    return [*line, *bar, (" " * GAP, None), *words] if bar else [*line, *words]


def _head(p: Progress, width: int, style: Style) -> list[Span]:
    """Step, place and times; names are cut before times."""
    where = [printable(p.site)] if p.site else []
    if p.step:
        where.append(p.step)
    if p.sites_total > 1:
        where.append(f"{p.sites_done} of {p.sites_total} done")
    place = ", ".join(where)
    about = "about " if width >= NARROWEST + 10 else ""
    left = f", {about}{duration(p.time_left_s)} left" if p.time_left_s > 0 else ""
    times = f"{duration(p.time_s)}{left}"
    free = width - cell_len(times) - GAP
    if free < len(p.phase):
        return [(str(p.phase), Ink.STRONG), (f" {times}", Ink.FAINT)]
    phase = cut(str(p.phase), free)
    place = cut(f" {place}", free - cell_len(phase)) if place else ""
    used = cell_len(phase) + cell_len(place if style.unicode else plain_ascii(place))
    return [
        (phase, Ink.STRONG),
        (place, None),
        (" " * (width - used - cell_len(times)), None),
        (times, Ink.FAINT),
    ]


def _depth(p: Progress, place: _Place) -> list[list[Span]]:
    """Depth and its target, or the feed if the target is a feed."""
    if math.isfinite(p.feed_target_um) and math.isfinite(p.feed_um):
        bar = _bar(p.feed_um, math.nan, p.feed_target_um, place)
        return [_row("feed", bar, [(f"{p.feed_um:.1f} of {p.feed_target_um:.1f} µm", None)])]
    if not math.isfinite(p.depth_um) or (p.depth_um == 0.0 and math.isnan(p.depth_target_um)):
        return []
    bar = _bar(p.depth_um, p.depth_u95_um, p.depth_target_um, place)
    return [_row("depth", bar, [(depth_words(p), None)])]


def _bar(done_um: float, u95_um: float, target_um: float, place: _Place) -> list[Span]:
    if not place.chart:
        return []
    return depth_bar(done_um, u95_um, target_um, place.chart, unicode=place.style.unicode)


def _pulses(p: Progress, place: _Place) -> list[list[Span]]:
    if not has_pulses(p.ratios):
        return []
    style = place.style
    bar = pulse_bar(p.ratios, place.chart, unicode=style.unicode, colour=style.colour) if place.chart else []
    words = [_share(name, 100.0 * float(getattr(p.ratios, name)), place.words) for name in PULSE_INKS]
    return [_row("pulses", bar, words)]


def _share(name: str, percent: float, cells: int) -> Span:
    """Share of one class, short enough for all four to fit."""
    last = name == "short"
    if cells >= WIDE_WORDS:
        words = f"{percent:2.0f} % {name}" + ("" if last else "  ")
    elif cells >= NARROW_WORDS:
        words = f"{percent:.0f} {name} " + ("%" if last else "")
    else:
        words = f"{percent:.0f} {name[0]} " + ("%" if last else "")
    return words, PULSE_INKS[name]


def _gap(p: Progress, history: History, place: _Place) -> list[list[Span]]:
    if not has_pulses(p.ratios) or not math.isfinite(p.gap_v):
        return []
    words = f"{p.gap_v:.1f} V, reference {p.reference_v:.1f} V"
    # The reference lies on the scale: a gap that never comes near it has to be seen.
    low_v, high_v = min(history.low, p.reference_v), max(history.high, p.reference_v)
    scale = _scale(low_v, high_v, LEAST_GAP_SHARE * p.reference_v)
    return _charted("gap", history, scale, "V", words, p.reference_v, p.time_s, place)


def _tool(p: Progress, history: History, place: _Place) -> list[list[Span]]:
    if not math.isfinite(p.displacement_um):
        return []
    scale = _scale(history.low, history.high, LEAST_HEIGHT_UM)
    words = f"at {p.displacement_um:.1f} µm"
    return _charted("tool", history, scale, "µm", words, math.nan, p.time_s, place)


def _scale(low: float, high: float, least: float) -> tuple[float, float]:
    """Return the range, widened to `least`."""
    spare = max(0.0, least - (high - low)) / 2.0
    return low - spare, high + spare


def _charted(
    label: str,
    history: History,
    scale: tuple[float, float],
    unit: str,
    words: str,
    mark: float,
    now_s: float,
    place: _Place,
) -> list[list[Span]]:
    """A chart with the newest values beside its first row and the range beside its last."""
    known = math.isfinite(history.low)
    extent = (
        f"{decimal(history.low, 1)} to {decimal(history.high, 1)} {unit} in {SPAN_S:.0f} s" if known else ""
    )
    if not place.chart:
        return [_row(label, [], [(words, None)])]
    if not known:
        return [_row(label, [(" " * place.chart, None)], [(words, None)])]
    lines = chart(history, now_s, place.chart, place.chart_rows, scale, mark, unicode=place.style.unicode)
    texts = [words, *[""] * (len(lines) - 2), extent][: len(lines)]
    return [
        _row("" if i else label, line, [(text, Ink.FAINT if i else None)])
        for i, (line, text) in enumerate(zip(lines, texts, strict=True))
    ]


def _feed(p: Progress) -> list[list[Span]]:
    feed = []
    if math.isfinite(p.feed_um) and math.isnan(p.feed_target_um):
        feed.append(f"{p.feed_um:.1f} µm")
    if math.isfinite(p.feed_um_s):
        feed.append(f"{p.feed_um_s + 0.0:.2f} µm/s".replace("-", "−"))
    u95 = f" ± {p.wear_u95_um:.1f}" if math.isfinite(p.wear_u95_um) else ""
    wear = f"{while_cutting(p)}{p.wear_um:.1f}{u95} µm" if math.isfinite(p.wear_um) else ""
    if not feed:
        return [_row("wear", [], [(wear, None)])] if wear else []
    if wear:
        feed.append(f"tool wear {wear}")
    return [_row("feed" if math.isnan(p.feed_target_um) else "", [], [(", ".join(feed), None)])]


def _jumps(p: Progress) -> list[list[Span]]:
    if not p.jumps:
        return []
    parts = [f"{p.jumps} in this {p.step.partition(' ')[0] or 'job'}"]
    if math.isfinite(p.jump_period_s):
        parts.append(f"every {p.jump_period_s:.3g} s")
    parts.append(f"the last {duration(max(0.0, p.time_s - p.last_jump_s))} ago")
    return [_row("jumps", [], [(", ".join(parts), None)])]


def _warning(p: Progress) -> list[list[Span]]:
    if not p.warning:
        return []
    ago = f" {duration(max(0.0, p.time_s - p.warned_s))} ago" if math.isfinite(p.warned_s) else ""
    return [[("warning", Ink.WARNING), (f"{ago}: {printable(p.warning)}", None)]]


def plain_ascii(text: str) -> str:
    """Return `text` for a terminal that shows ASCII only; a character without an equivalent becomes `?`."""
    return text if text.isascii() else text.translate(_ASCII).encode("ascii", "replace").decode("ascii")


def cut(text: str, cells: int) -> str:
    """Return as much of `text` as fits into `cells`, with an ellipsis if it was cut."""
    if cell_len(text) <= cells:
        return text
    return f"{set_cell_size(text, cells - 1).rstrip()}…" if cells > 0 else ""


def render_line(spans: Sequence[Span], cells: int, style: Style) -> str:
    """Return the spans painted, cut to `cells`."""
    parts = []
    for text, ink in spans:
        if cells <= 0:
            break
        shown = cut(text if style.unicode else plain_ascii(text), cells)
        if not style.unicode:
            shown = plain_ascii(shown)
        cells -= cell_len(shown)
        parts.append(style.paint(shown, ink) if ink else shown)
    return "".join(parts)
