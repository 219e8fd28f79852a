"""Errors of the actuator's models, as tables show them."""

from __future__ import annotations

from typing import Protocol

_MAXWELL = "Maxwell, no creep"
MODEL_NAMES = {"line": "straight line", "maxwell": _MAXWELL, "paper": _MAXWELL, "ours": "edmctl"}
"""`maxwell` is fitted to all the data, `paper` to one slow cycle."""


class ErrorsView(Protocol):
    """Largest and root-mean-square error of one model, in µm and in percent of a length."""

    @property
    def max_um(self) -> float: ...
    @property
    def rms_um(self) -> float: ...
    @property
    def max_pct(self) -> float: ...
    @property
    def rms_pct(self) -> float: ...
