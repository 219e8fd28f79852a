"""The profiles that there are, a line each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from edmctl.console.style import PLAIN, Style
from edmctl.console.tables import render_columns
from edmctl.wording import duration

if TYPE_CHECKING:
    from collections.abc import Sequence


class SummaryView(Protocol):
    """A profile and its forecast; `refused` says why the machine cannot run it."""

    @property
    def profile(self) -> str: ...
    @property
    def description(self) -> str: ...
    @property
    def time_s(self) -> float | None: ...
    @property
    def tool_wear_um(self) -> float | None: ...
    @property
    def refused(self) -> str: ...


def render_profiles(found: Sequence[SummaryView], style: Style = PLAIN) -> str:
    """Render a table of profiles: name, what it makes, how long that takes and what it wears off the tool."""
    rows = [
        (one.profile, one.refused, "–", "–")
        if one.time_s is None or one.tool_wear_um is None
        else (one.profile, one.description, duration(one.time_s), f"{one.tool_wear_um:.0f} µm")
        for one in found
    ]
    return render_columns(["profile", "makes", "takes", "tool wear"], rows, style, align="<<>>")
