"""The table of `simulate actuator`: how far each model is from the truth, waveform by waveform."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from edmctl.console.model_errors import MODEL_NAMES, ErrorsView
from edmctl.console.style import PLAIN, Style
from edmctl.console.tables import render_columns
from edmctl.wording import decimal

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


class WaveformView(Protocol):
    """One waveform and the errors of every model on it, in percent of the stroke."""

    @property
    def name(self) -> str: ...
    @property
    def models(self) -> Mapping[str, ErrorsView]: ...


def render_actuator(waveforms: Sequence[WaveformView], stroke_um: float, style: Style = PLAIN) -> str:
    """Render one row per waveform and model, and what the figures mean."""
    header = ["waveform", "model", "max µm", "RMS µm", "max %", "RMS %"]
    rows = [
        [
            waveform.name if index == 0 else "",
            MODEL_NAMES[key],
            *(decimal(value) for value in (errors.max_um, errors.rms_um, errors.max_pct, errors.rms_pct)),
        ]
        for waveform in waveforms
        for index, (key, errors) in enumerate(waveform.models.items())
    ]
    return "\n".join(
        [
            render_columns(header, rows, style, align="<<>"),
            f"Errors against the simulated truth, in percent of the stroke of {decimal(stroke_um)} µm.",
            "Each model gets one zero per waveform (its mean error is taken off): the sensor's zero is not known.",
            "The sensor's gain error stays in.",
        ]
    )
