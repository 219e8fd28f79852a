"""The tables of `measure-wear`, `measure-drift`, `simulate actuator` and `calibrate`."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from edmctl.actuator.waveforms import Leg
from edmctl.cli.render.calibration_tables import (
    render_actuator,
    render_calibration,
    render_lever,
    render_plan,
)
from edmctl.cli.render.procedure_tables import render_drift, render_wear
from edmctl.jobs.actuator_trial import ModelErrors, WaveformResult
from edmctl.labels import Basis
from edmctl.procedures.calibration import CalibrationPlan
from edmctl.results.measurements import DriftResult, UncertaintyPart, WearResult
from edmctl.wording import count, duration
from tests.cli.render.views import BASELINES, LEVER, Found, made_figures, made_file, made_findings

WEAR = WearResult(
    z1_um=50.0,
    z2_um=87.0,
    z3_um=57.0,
    z3_before_um=57.0,
    z3_after_um=57.0,
    drift_um=0.0,
    drift_correction_um=0.0,
    touches=3,
    sd_um=(0.05, 0.05, 0.05, 0.05),
    wear_um=7.0,
    wear_u95_um=0.5,
    depth_um=30.0,
    depth_u95_um=0.4,
    feed_um=37.0,
    feed_u95_um=0.6,
    wear_model_um=7.1,
    wear_model_u95_um=1.0,
    depth_model_um=29.9,
    depth_model_u95_um=1.0,
    feed_model_um=37.0,
    feed_model_u95_um=1.4,
    budget=(UncertaintyPart("gain of the sensor", 0.02, 0.09, 0.11),),
    depth_basis=Basis.TOUCHED,
    wear_basis=Basis.TOUCHED,
    time_s=100.0,
)
NAN = math.nan
NO_HOLE = replace(
    WEAR,
    z2_um=NAN,
    depth_um=NAN,
    depth_u95_um=NAN,
    feed_um=NAN,
    feed_u95_um=NAN,
    depth_basis=None,
    budget=(UncertaintyPart("gain of the sensor", 0.02, NAN, NAN),),
)


def words_of(text: str) -> str:
    return " ".join(text.split())


def test_a_wear_has_what_was_measured_of_it() -> None:
    alone = render_wear("Cu 270 µm", NO_HOLE, 6.9, 7.0, None)
    assert "No depth: the tool's last job left no measured bottom." in alone
    assert "0.02 µm" in alone
    for absent in ("depth  ", "feed  ", "Z2"):
        assert absent not in alone
    suspect = replace(WEAR, depth_basis=Basis.ESTIMATED)
    rows = render_wear("hole", suspect, 6.9, 7.0, None).splitlines()
    assert "measured" not in rows[0]
    for row, text in zip(
        rows[1:], ("~30.00 ± 0.40 µm", "  7.00 ± 0.50 µm", "~37.00 ± 0.60 µm"), strict=False
    ):
        assert text in row
    corrected = render_wear("hole", replace(WEAR, drift_correction_um=2.7), 6.9, 7.0, None)
    assert "drift of 2.70 µm since" in corrected


DRIFT = DriftResult(
    rest_um_per_s=0.00062,
    rest_u_um_per_s=0.00016,
    touch_um_per_s=0.0038,
    touch_u_um_per_s=0.0001,
    apart_um_per_s=0.0032,
    apart_u_um_per_s=0.0002,
    share=math.nan,
    share_u=math.nan,
    share_used=1.0,
    share_used_u=0.58,
    creep_um=2.4,
    creep_u_um=0.1,
    rests=24,
    touches=11,
    outliers=0,
    misfit=1.0,
    rest_rms_um=0.04,
    touch_rms_um=0.05,
    hold_um=250.0,
    hold_s=300.0,
    time_s=950.0,
)


def test_drift_is_beside_its_truth_and_the_share_of_touches() -> None:
    text = words_of(render_drift(DRIFT, None, "drift.toml", "jobs go by it", replaced=False))
    assert "share that a touch sees –" in text
    assert "The rests have not drifted by more than their random walk: no share can be told." in text
    assert "Jobs take 100 % of the drift of their rests off wear, Z2 and Z3." in text
    truth = {"sensor_um_per_s": 0.0009, "machine_um_per_s": 0.003}
    lines = render_drift(DRIFT, truth, "drift.toml", "jobs go by it", replaced=False).splitlines()
    assert "drift of the touches 3.80 ± 0.20 nm/s 3.90 nm/s" in map(words_of, lines)
    assert all(len(line) <= 80 for line in lines[:-1])


def made_waveform(name: str) -> WaveformResult:
    models = {
        "line": ModelErrors(30.0, 18.5, 6.7, 4.2),
        "paper": ModelErrors(11.0, 6.0, 2.4, 1.3),
        "ours": ModelErrors(1.5, 0.7, 0.3, 0.2),
    }
    return WaveformResult(name, {"range_um": 451.234}, models)


def test_each_waveform_has_a_row_per_model_and_is_named_once() -> None:
    text = render_actuator([made_waveform("sine 1 Hz"), made_waveform("step")], 451.234)
    lines = text.splitlines()
    assert [words_of(line) for line in lines[:4]] == [
        "waveform model max µm RMS µm max % RMS %",
        "sine 1 Hz straight line 30.00 18.50 6.70 4.20",
        "Maxwell, no creep 11.00 6.00 2.40 1.30",
        "edmctl 1.50 0.70 0.30 0.20",
    ]
    assert lines[4].startswith("step ")
    assert len({len(line) for line in lines[:7]}) == 1
    assert "in percent of the stroke of 451.23 µm" in text
    assert "one zero per waveform" in text


def test_a_calibration_has_the_errors_on_data_that_was_not_fitted_and_intervals() -> None:
    text = render_calibration(made_findings(), LEVER)
    lines = text.splitlines()
    assert [words_of(line) for line in lines[:4]] == [
        "held-out blocks max µm RMS µm max % RMS %",
        "straight line 44.07 16.39 9.77 3.63",
        "Maxwell, no creep 26.29 4.92 5.83 1.09",
        "edmctl 2.26 0.44 0.50 0.10",
    ]
    assert words_of(lines[4]).startswith("edmctl, noise taken off 1.90 0.41")
    assert len({len(line) for line in lines[:6]}) == 1
    for line in (
        "gain           2.9750 ± 0.0020 µm/V",
        "stroke         446.25 ± 0.29 µm from 0.0 V to 150.0 V",
        "creep          2.80 ± 0.10 % per decade of time",
        "delay          0.60 ms",
        render_lever(LEVER),
        "\nAccepted.",
    ):
        assert line in text
    assert render_lever(LEVER) == "lever factor   18.020 ± 0.050"
    small = made_findings(held_out=made_figures(max_um=0.1234, range_um=20.0))
    assert "0.123" in render_calibration(small)


def test_validation_has_a_block_of_its_own_with_a_row_for_each_of_several_files() -> None:
    one, other = made_file("b.csv"), made_file("c.csv", max_um=3.0)
    known = {"validated": made_figures(), "validated_baselines": BASELINES}
    blocks = [
        render_calibration(made_findings(files=files, refit=("gain", "zero"), **known)).split("\n\n")[1]
        for files in ((one,), (one, other))
    ]
    alone, several = (block.splitlines() for block in blocks)
    assert alone[0].startswith("b.csv ")
    assert alone[-1] == "Gain and zero are fitted to each file first."
    assert len(alone) == 5
    assert several[0].startswith("2 files ")
    assert [line.split()[1] for line in several[4:6]] == ["b.csv", "c.csv"]


@pytest.mark.parametrize(
    ("found", "end"),
    [
        (
            Found(problems=("Too bad: redo.",), notes=("Short.",)),
            ["Not accepted: Too bad: redo.", "Note: Short."],
        ),
        (Found(restrictions=("for one rate.",)), ["Accepted for one rate."]),
    ],
)
def test_what_is_not_accepted_is_said_with_the_reason(found: Found, end: list[str]) -> None:
    text = render_calibration(made_findings(identification=found))
    assert text.splitlines()[-len(end) :] == end
    assert "Accepted." not in text


def test_a_plan_lists_when_each_leg_begins() -> None:
    plan = CalibrationPlan((Leg(150.0, 2.0), Leg(0.0, 0.5)), 5000)
    lines = render_plan(plan).splitlines()
    assert [words_of(line) for line in lines[:3]] == ["at s to V in s", "0.0 150.0 2.000", "2.0 0.0 0.500"]
    times = f"{duration(plan.duration_s)} or more, {count(plan.samples)} samples or more, without pulses"
    assert lines[3].startswith(f"2 legs between 0 V and 150.0 V in {times}")
