"""The checks of `doctor`, one line each, with the fix below where there is one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from edmctl.console.style import PLAIN, Ink, Style

if TYPE_CHECKING:
    from collections.abc import Sequence

_INKS = {"warn": Ink.WARNING, "fail": Ink.ERROR}


class CheckView(Protocol):
    """One check."""

    @property
    def name(self) -> str: ...
    @property
    def status(self) -> str: ...
    @property
    def message(self) -> str: ...
    @property
    def fix(self) -> str: ...


def render_checks(checks: Sequence[CheckView], style: Style = PLAIN) -> str:
    """Render the checks under each other, names aligned."""
    width = max((len(check.name) for check in checks), default=0)
    lines = []
    for check in checks:
        status = f"{check.status:4}"
        ink = _INKS.get(str(check.status))
        painted = style.paint(status, ink) if ink else status
        lines.append(f"{painted}  {check.name:{width}}  {check.message}")
        if check.fix:
            lines.append(f"{'':{width + 8}}{style.paint('fix:', Ink.NOTE)} {check.fix}")
    return "\n".join(lines)
