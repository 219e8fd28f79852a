"""The state of a job as a block of lines, for the width and height that there are.

Wide terminals show bars and charts with their figures beside them. Narrow ones, and those without Unicode, show the
figures alone. Where lines are few, the charts become lower first, and then the least important lines are left out.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from itertools import groupby
from operator import itemgetter

from rich.cells import cell_len, set_cell_size

from edmctl.cli.render.progress import depth_words, has_pulses, while_cutting
from edmctl.cli.render.terminal import Ink, Span, Style
from edmctl.dataclasses import dataclass, field
from edmctl.results.progress import Extremes, Progress
from edmctl.results.telemetry import PulseShares
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
BEYOND = 1.08
"""The depth bar extends this far beyond its target, so that a hole that is too deep is visible."""
SPAN_S = 60.0
_MOST = 4000
"""Reports that are kept: a minute of them at 60 Hz."""
_CHART_ROWS = ((3, 26), (2, 12), (1, 0))
"""Rows of a chart, and the height from which on they leave room for all else and some notes."""
_DOTS = (0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80)
"""Left and right dots of a braille cell from top to bottom."""
_PULSES = {
    "open": ("░", Ink.OPEN),
    "normal": ("█", Ink.NORMAL),
    "arc": ("▓", Ink.ARC),
    "short": ("▞", Ink.SHORT),
}
_ASCII = str.maketrans(
    {"µ": "u", "±": "+-", "–": "-", "−": "-", "…": "~", "·": "*", "°": " deg ", "×": "x", "→": "->"}
)


def depth_bar(done_um: float, u95_um: float, target_um: float, cells: int) -> list[Span]:
    """Draw the depth, the band of its 95 % interval (a cell at least), and the target."""
    full_um = BEYOND * target_um
    if not (full_um > 0.0 and math.isfinite(done_um)):
        return [("─" * cells, Ink.FAINT)]

    def place(value_um: float) -> float:
        return min(max(value_um / full_um, 0.0), 1.0) * cells

    sure = likely = round(place(done_um))
    if u95_um > 0.0:
        sure, likely = math.floor(place(done_um - u95_um)), math.ceil(place(done_um + u95_um))
    bar = (
        [("█", Ink.SIGNAL)] * sure
        + [("▒", Ink.BAND)] * (likely - sure)
        + [("─", Ink.FAINT)] * (cells - likely)
    )
    bar[min(round(place(target_um)), cells - 1)] = ("│", Ink.STRONG)
    return _joined(bar)


def count_bar(done: int, total: int, cells: int) -> list[Span]:
    """Draw how many of a number are done."""
    filled = min(cells, cells * done // max(1, total))
    return [("█" * filled, Ink.SIGNAL), ("─" * (cells - filled), Ink.FAINT)]


def pulse_bar(ratios: PulseShares, cells: int, *, colour: bool = True) -> list[Span]:
    """Draw the classes side by side; with colour all are solid, without it each has a pattern."""
    spans: list[Span] = []
    drawn, total = 0, 0.0
    for name, (pattern, ink) in _PULSES.items():
        share = float(getattr(ratios, name))
        total += share if math.isfinite(share) else 0.0
        end = max(drawn, min(cells, round(total * cells)))
        spans.append((("█" if colour else pattern) * (end - drawn), ink))
        drawn = end
    return [*spans, (" " * (cells - drawn), None)]


class History:
    """Lows and highs of one signal in the last `SPAN_S` of the machine's time."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, float, float]] = deque(maxlen=_MOST)

    def update(self, time_s: float, low: float, high: float) -> None:
        """Add one report; unknown values are left out, and a clock that is set back clears the history."""
        rows = self._rows
        if not math.isfinite(time_s):
            return
        if rows and time_s < rows[-1][0]:
            rows.clear()
        while rows and rows[0][0] < time_s - SPAN_S:
            rows.popleft()
        if low <= high:
            rows.append((time_s, low, high))

    @property
    def low(self) -> float:
        """Lowest value; NaN without any."""
        return min((row[1] for row in self._rows), default=math.nan)

    @property
    def high(self) -> float:
        """Highest value; NaN without any."""
        return max((row[2] for row in self._rows), default=math.nan)

    def columns(self, count: int, now_s: float) -> list[tuple[float, float] | None]:
        """Low and high in each of `count` equal parts of the span, oldest first; None without a report.

        The parts begin at whole multiples of their length, so that a peak keeps its shape while it travels.
        """
        found: list[tuple[float, float] | None] = [None] * count
        if not math.isfinite(now_s):
            return found
        step_s = SPAN_S / count
        oldest = math.floor(now_s / step_s) - count + 1
        for time_s, low, high in self._rows:
            i = int(time_s / step_s) - oldest
            if 0 <= i < count:
                other = found[i]
                found[i] = (min(low, other[0]), max(high, other[1])) if other else (low, high)
        return found


def chart(
    history: History, now_s: float, cells: int, rows: int, scale: tuple[float, float], mark: float = math.nan
) -> list[list[Span]]:
    """Draw the lowest and highest values of a signal into `rows` of `cells`, top first.

    scale : values at the lower and the upper edge
    mark : value of a faint line
    """
    low, high = scale
    most = 4 * rows - 1

    def level(value: float) -> int:
        share = (value - low) / (high - low) if high > low else 0.5
        return most - min(max(round(share * most), 0), most)

    dots = [[0] * cells for _ in range(rows)]
    for i, found in enumerate(history.columns(2 * cells, now_s)):
        if found is not None:
            for dot in range(level(found[1]), level(found[0]) + 1):
                dots[dot // 4][i // 2] |= _DOTS[i % 2][dot % 4]
    marked = level(mark) if math.isfinite(mark) else -1
    drawn = []
    for row, line in enumerate(dots):
        empty = chr(0x2800 + sum(side[marked % 4] for side in _DOTS)) if marked // 4 == row else " "
        drawn.append(_joined((chr(0x2800 + dot), Ink.SIGNAL) if dot else (empty, Ink.FAINT) for dot in line))
    return drawn


def _joined(cells: Iterable[Span]) -> list[Span]:
    """Join neighbours of one ink."""
    return [("".join(text for text, _ in run), ink) for ink, run in groupby(cells, key=itemgetter(1))]


@dataclass(slots=True)
class Histories:
    """The last minute of gap voltage and displacement."""

    gap_v: History = field(default_factory=History)
    displacement_um: History = field(default_factory=History)

    def update(self, p: Progress) -> None:
        """Add what came since the last report."""
        reports: tuple[Extremes | Progress, ...] = (*p.past, p)
        for one in reports:
            self.displacement_um.update(one.time_s, one.displacement_low_um, one.displacement_high_um)
            is_known = one is not p or has_pulses(p.ratios)
            self.gap_v.update(one.time_s, one.gap_low_v if is_known else math.nan, one.gap_high_v)


def draw_view(
    p: Progress, histories: Histories, width: int, height: int, style: Style
) -> list[tuple[str, int]]:
    """Return the lines, at most `height` of at most `width` cells, each painted and with the cells it takes."""
    view = _View(p, histories, width, height, style)
    # Each part with its rank: the last ones are left out first where lines are few.
    parts: list[tuple[int, list[list[Span]]]] = [
        (8, [[]]),
        (0, [view.head()]),
        (1, view.depth()),
        (4, view.pulses()),
        (3, view.gap()),
        (5, view.tool()),
        (6, view.feed()),
        (7, view.jumps()),
        (2, view.warning()),
    ]
    free, kept = height, set()
    for rank, lines in sorted(parts, key=itemgetter(0)):
        if len(lines) <= free:
            free -= len(lines)
            kept.add(rank)
    return [painted(line, width, style) for rank, lines in parts if rank in kept for line in lines]


class _View:
    """The parts of the block: `words` cells of figures beside `chart` cells of bars (0 on narrow terminals)."""

    def __init__(self, p: Progress, histories: Histories, width: int, height: int, style: Style) -> None:
        self.p, self.histories, self.width, self.style = p, histories, width, style
        self.words = WIDE_WORDS if width >= WIDE else NARROW_WORDS
        self.chart = width - LABEL - GAP - self.words
        self.chart_rows = next(rows for rows, least in _CHART_ROWS if height >= least)
        if width < NARROWEST:
            self.words = max(0, width - LABEL)
        if width < NARROWEST or not style.unicode:
            self.chart = 0

    def head(self) -> list[Span]:
        """Step, place and times; names are cut before times."""
        p = self.p
        where = [printable(p.site)] if p.site else []
        if p.step:
            where.append(p.step)
        if p.sites_total > 1:
            where.append(f"{p.sites_done} of {p.sites_total} done")
        about = "about " if self.width >= NARROWEST + 10 else ""
        left = f", {about}{duration(p.time_left_s)} left" if p.time_left_s > 0 else ""
        phase, times = str(p.phase), f"{duration(p.time_s)}{left}"
        free = self.width - len(times) - GAP - len(phase)
        if free < 0:
            return [(phase, Ink.STRONG), (f" {times}", Ink.FAINT)]
        place = cut(_plain(f" {', '.join(where)}" if where else "", self.style), free)
        blanks = " " * (free + GAP - cell_len(place))
        return [(phase, Ink.STRONG), (place, None), (blanks, None), (times, Ink.FAINT)]

    def depth(self) -> list[list[Span]]:
        """Depth and its target, or the feed if the target is a feed."""
        p = self.p
        if math.isfinite(p.feed_target_um) and math.isfinite(p.feed_um):
            words = f"{p.feed_um:.1f} of {p.feed_target_um:.1f} µm"
            return [self._row("feed", words, self._bar(p.feed_um, math.nan, p.feed_target_um))]
        if not math.isfinite(p.depth_um) or (p.depth_um == 0.0 and math.isnan(p.depth_target_um)):
            return []
        return [self._row("depth", depth_words(p), self._bar(p.depth_um, p.depth_u95_um, p.depth_target_um))]

    def _bar(self, done_um: float, u95_um: float, target_um: float) -> list[Span]:
        return depth_bar(done_um, u95_um, target_um, self.chart) if self.chart else []

    def pulses(self) -> list[list[Span]]:
        """Shares of the pulse classes, in words short enough for all four to fit."""
        ratios = self.p.ratios
        if not has_pulses(ratios):
            return []
        wide, usual = self.words >= WIDE_WORDS, self.words >= NARROW_WORDS
        words: list[Span] = []
        for name, (_, ink) in _PULSES.items():
            share = 100.0 * float(getattr(ratios, name))
            text = f"{share:2.0f} % {name}" if wide else f"{share:.0f} {name if usual else name[0]}"
            words += [(text, ink), ("  " if wide else " ", None)]
        words[-1] = ("" if wide else " %", _PULSES["short"][1])
        bar = pulse_bar(ratios, self.chart, colour=self.style.colour) if self.chart else []
        return [[*self._row("pulses", "", bar), *words]]

    def gap(self) -> list[list[Span]]:
        """Gap voltage. Its reference is on the scale: a gap that never comes near it has to be seen."""
        p, history = self.p, self.histories.gap_v
        if not has_pulses(p.ratios) or not math.isfinite(p.gap_v):
            return []
        words = f"{p.gap_v:.1f} V, reference {p.reference_v:.1f} V"
        ends = min(history.low, p.reference_v), max(history.high, p.reference_v)
        return self._charted("gap", words, history, "V", ends, LEAST_GAP_SHARE * p.reference_v, p.reference_v)

    def tool(self) -> list[list[Span]]:
        """Displacement of the tool."""
        history = self.histories.displacement_um
        if not math.isfinite(self.p.displacement_um):
            return []
        words = f"at {self.p.displacement_um:.1f} µm"
        return self._charted("tool", words, history, "µm", (history.low, history.high), LEAST_HEIGHT_UM)

    def _charted(
        self,
        label: str,
        words: str,
        history: History,
        unit: str,
        ends: tuple[float, float],
        least: float,
        mark: float = math.nan,
    ) -> list[list[Span]]:
        """A chart at least `least` high; the newest values are beside its first row, the range beside its last."""
        if not self.chart or not math.isfinite(history.low):
            return [self._row(label, words, [(" " * self.chart, None)] if self.chart else [])]
        spare = max(0.0, least - (ends[1] - ends[0])) / 2.0
        scale = (ends[0] - spare, ends[1] + spare)
        lines = chart(history, self.p.time_s, self.chart, self.chart_rows, scale, mark)
        extent = f"{decimal(history.low, 1)} to {decimal(history.high, 1)} {unit} in {SPAN_S:.0f} s"
        drawn = [self._row("", "", line) for line in lines]
        drawn[-1].append((extent, Ink.FAINT))
        drawn[0] = self._row(label, words, lines[0])
        return drawn

    def feed(self) -> list[list[Span]]:
        """Feed and its speed, and the wear of the tool."""
        p = self.p
        feed = []
        if math.isfinite(p.feed_um) and math.isnan(p.feed_target_um):
            feed.append(f"{p.feed_um:.1f} µm")
        if math.isfinite(p.feed_um_s):
            feed.append(f"{decimal(p.feed_um_s)} µm/s")
        u95 = f" ± {p.wear_u95_um:.1f}" if math.isfinite(p.wear_u95_um) else ""
        wear = f"{while_cutting(p)}{p.wear_um:.1f}{u95} µm" if math.isfinite(p.wear_um) else ""
        if not feed:
            return [self._row("wear", wear)] if wear else []
        if wear:
            feed.append(f"tool wear {wear}")
        return [self._row("feed" if math.isnan(p.feed_target_um) else "", ", ".join(feed))]

    def jumps(self) -> list[list[Span]]:
        """How often the tool has jumped."""
        p = self.p
        if not p.jumps:
            return []
        parts = [f"{p.jumps} in this {p.step.partition(' ')[0] or 'job'}"]
        if math.isfinite(p.jump_period_s):
            parts.append(f"every {p.jump_period_s:.3g} s")
        parts.append(f"the last {duration(max(0.0, p.time_s - p.last_jump_s))} ago")
        return [self._row("jumps", ", ".join(parts))]

    def warning(self) -> list[list[Span]]:
        """The last warning."""
        p = self.p
        if not p.warning:
            return []
        ago = f" {duration(max(0.0, p.time_s - p.warned_s))} ago" if math.isfinite(p.warned_s) else ""
        return [[("warning", Ink.WARNING), (f"{ago}: {printable(p.warning)}", None)]]

    def _row(self, label: str, words: str, bar: Sequence[Span] = ()) -> list[Span]:
        gap: list[Span] = [(" " * GAP, None)] if bar else []
        return [(f"{label:{LABEL}}", Ink.FAINT), *bar, *gap, (words, None)]


def plain_ascii(text: str) -> str:
    """Return `text` for a terminal that shows ASCII only; a character without an equivalent becomes `?`."""
    return text if text.isascii() else text.translate(_ASCII).encode("ascii", "replace").decode("ascii")


def _plain(text: str, style: Style) -> str:
    return text if style.unicode else plain_ascii(text)


def cut(text: str, cells: int) -> str:
    """Return as much of `text` as fits into `cells`, with an ellipsis if it was cut."""
    if cell_len(text) <= cells:
        return text
    return f"{set_cell_size(text, cells - 1).rstrip()}…" if cells > 0 else ""


def painted(spans: Sequence[Span], cells: int, style: Style) -> tuple[str, int]:
    """Return the spans painted and cut to `cells`, and the cells that they take."""
    parts, used = [], 0
    for text, ink in spans:
        shown = _plain(cut(_plain(text, style), cells - used), style)
        used += cell_len(shown)
        parts.append(style.paint(shown, ink) if ink else shown)
    return "".join(parts), used
