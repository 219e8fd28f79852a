"""The table of `simulate actuator`."""

from __future__ import annotations

from edmctl.cli.render.calibration_tables import render_actuator
from edmctl.jobs.actuator_trial import ModelErrors, Truth, WaveformResult


def made_waveform(name: str) -> WaveformResult:
    models = {
        "line": ModelErrors(30.0, 18.5, 6.7, 4.2),
        "paper": ModelErrors(11.0, 6.0, 2.4, 1.3),
        "ours": ModelErrors(1.5, 0.7, 0.3, 0.2),
    }
    return WaveformResult(name, Truth(451.234), models)


def test_each_waveform_has_a_row_per_model_and_is_named_once() -> None:
    lines = render_actuator([made_waveform("sine 1 Hz"), made_waveform("step")], 451.234).splitlines()
    assert lines[0].split() == ["waveform", "model", "max", "µm", "RMS", "µm", "max", "%", "RMS", "%"]
    assert lines[1].split() == ["sine", "1", "Hz", "straight", "line", "30.00", "18.50", "6.70", "4.20"]
    assert lines[3].split() == ["edmctl", "1.50", "0.70", "0.30", "0.20"]
    assert lines[4].startswith("step ")
    assert len({len(line) for line in lines[:7]}) == 1


def test_percentages_and_zeros_are_explained() -> None:
    text = render_actuator([made_waveform("step")], 451.234)
    assert "in percent of the stroke of 451.23 µm" in text
    assert "one zero per waveform" in text
