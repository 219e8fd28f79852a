"""Table of the paper's electromechanical model: what the paper reads, and what is read here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.console.layout import render_columns
from edmctl.console.style import PLAIN, Style
from edmctl.wording import decimal

if TYPE_CHECKING:
    from edmctl.jobs.paper_trial import PaperTrial

_STARTS = {
    "virgin": "The model begins virgin, with no memory, as a simulation does; the actuator has\nbeen cycled before.",
    "conditioned": "Model and actuator have both been cycled over the whole range before.",
}


def render_paper_trial(trial: PaperTrial, style: Style = PLAIN) -> str:
    """Render the errors of each waveform, and what the paper reads off it beside ours."""
    blocks = []
    rows = [
        [reading.figure, reading.what, reading.paper, f"{reading.ours_um:.1f}"]
        for waveform in trial.waveforms
        for reading in waveform.readings
    ]
    if rows:
        blocks.append(render_columns(["figure", "error", "paper µm", "ours µm"], rows, style, align="<<>"))
    errors = [
        [waveform.name, *(decimal(value) for value in (e.max_um, e.rms_um, e.max_pct, e.rms_pct))]
        for waveform in trial.waveforms
        for e in (waveform.errors,)
    ]
    header = ["waveform", "max µm", "RMS µm", "max %", "RMS %"]
    blocks.append(render_columns(header, errors, style))
    blocks.append("\n".join(_notes(trial)))
    return "\n\n".join(blocks)


def _notes(trial: PaperTrial) -> list[str]:
    fit = trial.fitted.fit
    fitted = f"max {fit.max_um:.1f} µm, RMS {fit.rms_um:.1f} µm"
    return [
        f"Model less sensor, in percent of the stroke of {decimal(trial.stroke_um)} µm. The model is Table 1",
        "with k_p = 6e7 N/m and k_a = 6 N/µm; the paper has no numbers of its block H,",
        f"which is fitted to one slow cycle here ({fitted}). The zero of that",
        "fit holds for all.",
        _STARTS[trial.start],
    ]
