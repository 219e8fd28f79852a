"""The table of `simulate actuator`."""

from __future__ import annotations

from dataclasses import dataclass, field

from edmctl.console.actuator_table import render_actuator


@dataclass(frozen=True)
class Errors:
    max_um: float
    rms_um: float
    max_pct: float
    rms_pct: float


@dataclass(frozen=True)
class Waveform:
    name: str
    models: dict[str, Errors] = field(
        default_factory=lambda: {
            "line": Errors(30.0, 18.5, 6.7, 4.2),
            "paper": Errors(11.0, 6.0, 2.4, 1.3),
            "ours": Errors(1.5, 0.7, 0.3, 0.2),
        }
    )


def test_each_waveform_has_a_row_per_model_and_is_named_once() -> None:
    lines = render_actuator([Waveform("sine 1 Hz"), Waveform("step")], 451.234).splitlines()
    assert lines[0].split() == ["waveform", "model", "max", "µm", "RMS", "µm", "max", "%", "RMS", "%"]
    assert lines[1].split() == ["sine", "1", "Hz", "straight", "line", "30.00", "18.50", "6.70", "4.20"]
    assert lines[3].split() == ["edmctl", "1.50", "0.70", "0.30", "0.20"]
    assert lines[4].startswith("step ")
    assert len({len(line) for line in lines[:7]}) == 1


def test_percentages_and_zeros_are_explained() -> None:
    text = render_actuator([Waveform("step")], 451.234)
    assert "in percent of the stroke of 451.23 µm" in text
    assert "one zero per waveform" in text
