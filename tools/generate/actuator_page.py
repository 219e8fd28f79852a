"""The table of docs/actuator.md: the paper's figures beside its model on virtual actuators."""

from __future__ import annotations

from edmctl.actuator.waveforms import readings
from edmctl.jobs.actuator_trial import Start, Wanted, displacement, fit_model, waveforms
from edmctl.simulator.plant import RATE_HZ, VirtualActuator
from tools.generate.text import table

SEEDS = (1, 2, 3)
STARTS: tuple[Start, ...] = ("virgin", "conditioned")


def tables() -> dict[str, str]:
    """Return the table of readings, the lowest and the highest of some actuators, in whole micrometres."""
    asked = waveforms(Wanted("figures", None, None, None, None, None))
    found: dict[tuple[str, str, str], dict[str, list[float]]] = {}
    for seed in SEEDS:
        fitted = fit_model(seed)
        for waveform in asked:
            driven = VirtualActuator(seed).drive(waveform.command_v)
            for start in STARTS:
                model_um = displacement(fitted, driven.applied_v, start)
                error_um = model_um - driven.sensor_um
                for reading in readings(waveform.figure, waveform.command_v, error_um, model_um, RATE_HZ):
                    row = found.setdefault((reading.figure, reading.what, reading.paper), {})
                    row.setdefault(start, []).append(reading.ours_um)
    head = ("figure", "error", "paper, µm", *(f"ours, {start}, µm" for start in STARTS))
    return {
        "paper": table(
            head, [(*key, *(_range(row[start]) for start in STARTS)) for key, row in found.items()]
        )
    }


def _range(values: list[float]) -> str:
    low, high = f"{min(values):.0f}", f"{max(values):.0f}"
    return low if low == high else f"{low}–{high}"
