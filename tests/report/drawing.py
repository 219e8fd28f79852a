"""Figures that are drawn for a test, and what is seen on them."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import cache
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.record.reader import open_run
from edmctl.report.kinds import draw, kind_called
from edmctl.report.panels import NothingToDraw, house_style, rendered

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.text import Text
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


@cache
def drawn(kind: str, path: Path) -> Figure:
    """The figure of a kind, drawn once."""
    with open_run(path) as run, house_style():
        return draw(kind_called(kind), run)


def why_not(kind: str, path: Path) -> str:
    """Draw what cannot be drawn, and return why."""
    with pytest.raises(NothingToDraw) as told:
        drawn(kind, path)
    return str(told.value)


def texts_of(svg: bytes) -> set[str]:
    return {(e.text or "").strip() for e in ET.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")}


def texts(kind: str, path: Path) -> set[str]:
    """Every text of a figure, as its file has them."""
    with house_style():
        return texts_of(rendered(drawn(kind, path), ".svg"))


def width_mm(figure: Figure) -> float:
    return 25.4 * float(figure.get_figwidth())


def legend_of(figure: Figure) -> set[str]:
    legends = [*(axes.get_legend() for axes in figure.axes), *figure.legends]
    return {text.get_text() for legend in legends if legend is not None for text in legend.get_texts()}


def line_called(figure: Figure, label: str) -> tuple[Array, Array]:
    """The points of the one line with a label."""
    (found,) = [line for axes in figure.axes for line in axes.get_lines() if line.get_label() == label]
    return data(found)


def data(line: Line2D) -> tuple[Array, Array]:
    return np.asarray(line.get_xdata(), np.float64), np.asarray(line.get_ydata(), np.float64)


def points_of(axes: Axes) -> list[Line2D]:
    """The marks of each set of results."""
    from matplotlib.container import ErrorbarContainer

    return [one.lines[0] for one in axes.containers if isinstance(one, ErrorbarContainer)]


def overlaps(figure: Figure) -> list[tuple[str, str]]:
    """Pairs of texts of a figure whose boxes lie on each other. Fails where one is cut off."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    with house_style():
        canvas = FigureCanvasAgg(figure)
        canvas.draw()  # type: ignore[no-untyped-call]
        renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]
        hidden = {id(label) for axes in figure.axes for label in _labels_out_of_sight(axes)}
        boxes = [
            (text.get_text(), text.get_window_extent(renderer))
            for text in figure.findobj(Text)
            if text.get_visible() and text.get_text().strip() and id(text) not in hidden
        ]
    for text, box in boxes:
        assert figure.bbox.x0 - 1.0 < box.x0 < box.x1 < figure.bbox.x1 + 1.0, f"{text!r} is cut off"
    shrunk = [(text, box.shrunk(0.98, 0.9)) for text, box in boxes]
    return [(one, other) for (one, box), (other, its) in combinations(shrunk, 2) if box.overlaps(its)]


def _labels_out_of_sight(axes: Axes) -> list[Text]:
    found = []
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        ticks = (*axis.get_major_ticks(), *axis.get_minor_ticks())
        away = [tick for tick in ticks if not low <= tick.get_loc() <= high]
        found += [label for tick in away for label in (tick.label1, tick.label2)]
    return found
