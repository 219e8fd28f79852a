"""Tool wear and depth by touches, with their uncertainty."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from edmctl.console.style import PLAIN, Style
from edmctl.console.tables import render_columns
from edmctl.labels import Basis, heading
from edmctl.wording import duration, length

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


class ReadingView(Protocol):
    """Touches of one place."""

    @property
    def mean_um(self) -> float: ...
    @property
    def sd_um(self) -> float: ...
    @property
    def touches(self) -> int: ...


class PartView(Protocol):
    """One source of uncertainty."""

    @property
    def source(self) -> str: ...
    @property
    def wear_um(self) -> float: ...
    @property
    def depth_um(self) -> float: ...
    @property
    def feed_um(self) -> float: ...


class WearView(Protocol):
    """What the touches say; NaN where no hole was touched."""

    @property
    def z1_um(self) -> float: ...
    @property
    def z2_um(self) -> float: ...
    @property
    def z3_um(self) -> float: ...
    @property
    def drift_um(self) -> float: ...
    @property
    def touches(self) -> int: ...
    @property
    def wear_basis(self) -> str: ...
    @property
    def wear_um(self) -> float: ...
    @property
    def wear_u95_um(self) -> float: ...
    @property
    def depth_um(self) -> float: ...
    @property
    def depth_u95_um(self) -> float: ...
    @property
    def feed_um(self) -> float: ...
    @property
    def feed_u95_um(self) -> float: ...
    @property
    def wear_model_um(self) -> float: ...
    @property
    def depth_model_um(self) -> float: ...
    @property
    def feed_model_um(self) -> float: ...
    @property
    def budget(self) -> Sequence[PartView]: ...


def render_wear(
    name: str,
    found: WearView,
    ledger_um: float,
    total_um: float,
    truth: Mapping[str, float] | None,
    style: Style = PLAIN,
) -> str:
    """Render what was found at the hole `name`.

    ledger_um : sum of the wears of the tool's jobs since its reference; total_um : what it has lost in all
    """
    header = [name, heading((found.wear_basis,))]
    wear = ["tool wear", length(found.wear_um, found.wear_u95_um)]
    depth = ["depth", length(found.depth_um, found.depth_u95_um)]
    feed = ["feed", length(found.feed_um, found.feed_u95_um)]
    # Lengths by the model alone would stand there twice.
    if found.wear_basis != Basis.MODEL:
        header.append("from voltage")
        wear.append(length(found.wear_model_um))
        depth.append(length(found.depth_model_um))
        feed.append(length(found.feed_model_um))
    if truth is not None:
        header.append("truth")
        wear.append(length(truth["wear_um"]))
        depth.append(length(truth["depth_um"]))
    rows = [
        depth,
        wear,
        feed,
        ["Z1 reference", length(found.z1_um)],
        ["Z2 bottom", length(found.z2_um)],
        ["Z3 pad", length(found.z3_um)],
        ["drift of Z3", length(found.drift_um)],
    ]
    parts = [
        [part.source, length(part.depth_um), length(part.wear_um), length(part.feed_um)]
        for part in found.budget
    ]
    return "\n\n".join(
        [
            render_columns(header, rows, style),
            render_columns(["standard uncertainty", "depth", "tool wear", "feed"], parts, style),
            f"{found.touches} touches of every Z. The tool's jobs account for {length(ledger_um)} of wear; it has "
            f"lost {length(total_um)} in all.",
        ]
    )


def render_reference(tool: str, reading: ReadingView, model_um: float, style: Style = PLAIN) -> str:
    """Render the reference of a tool."""
    rows = [
        ["Z1 reference", length(reading.mean_um), length(model_um)],
        ["touches", f"{reading.touches} within {length(reading.sd_um)} rms"],
    ]
    return render_columns([tool, "measured", "from voltage"], rows, style)


def render_wear_plan(
    readings: Sequence[str], touches: int, speed_um_s: float, time_s: float, style: Style = PLAIN
) -> str:
    """Render what will be touched."""
    rows = [
        ["readings", ", ".join(readings)],
        ["touches each", str(touches)],
        ["speed", f"{speed_um_s:g} µm/s"],
        ["time", duration(time_s)],
    ]
    return render_columns(["measure-wear", "forecast"], rows, style)
