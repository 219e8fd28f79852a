"""The tables of `measure-wear`, `measure-drift`, `simulate actuator` and `calibrate`."""

from __future__ import annotations

import math
from dataclasses import replace

from edmctl.actuator.waveforms import Leg
from edmctl.cli.render.calibration_tables import (
    render_actuator,
    render_calibration,
    render_lever,
    render_plan,
)
from edmctl.cli.render.procedure_tables import render_drift, render_wear
from edmctl.jobs.actuator_trial import ModelErrors, Truth, WaveformResult
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


def test_what_was_not_measured_is_not_in_the_table() -> None:
    text = render_wear("Cu 270 µm", NO_HOLE, 6.9, 7.0, None)
    assert "depth  " not in text
    assert "feed  " not in text
    assert "Z2" not in text
    assert "No depth: the tool's last job left no measured bottom." in text
    assert "0.02 µm" in text


def test_the_depth_of_a_suspect_touch_is_estimated() -> None:
    rows = render_wear("hole", replace(WEAR, depth_basis=Basis.ESTIMATED), 6.9, 7.0, None).splitlines()
    assert "measured" not in rows[0]
    assert "~30.00 ± 0.40 µm" in rows[1]
    assert "  7.00 ± 0.50 µm" in rows[2]
    assert "~37.00 ± 0.60 µm" in rows[3]


def test_a_drift_that_was_taken_off_is_stated() -> None:
    assert "drift of 2.70 µm since" in render_wear(
        "hole", replace(WEAR, drift_correction_um=2.7), 6.9, 7.0, None
    )


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


def test_rests_that_have_only_walked_tell_no_share_and_that_is_said() -> None:
    text = " ".join(render_drift(DRIFT, None, "drift.toml", "jobs go by it", replaced=False).split())
    assert "share that a touch sees –" in text
    assert "The rests have not drifted by more than their random walk: no share can be told." in text
    assert "Jobs take 100 % of the drift of their rests off wear, Z2 and Z3." in text


def test_the_truth_is_beside_what_was_measured() -> None:
    truth = {"sensor_um_per_s": 0.0009, "machine_um_per_s": 0.003}
    lines = render_drift(DRIFT, truth, "drift.toml", "jobs go by it", replaced=False).splitlines()
    assert "drift of the touches 3.80 ± 0.20 nm/s 3.90 nm/s" in [" ".join(line.split()) for line in lines]
    assert all(len(line) <= 80 for line in lines[:-1])


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


def words(line: str) -> list[str]:
    return line.split()


def test_models_stand_under_each_other_on_data_that_they_did_not_see() -> None:
    lines = render_calibration(made_findings()).splitlines()
    assert words(lines[0]) == ["held-out", "blocks", "max", "µm", "RMS", "µm", "max", "%", "RMS", "%"]
    assert words(lines[1]) == ["straight", "line", "44.07", "16.39", "9.77", "3.63"]
    assert words(lines[2]) == ["Maxwell,", "no", "creep", "26.29", "4.92", "5.83", "1.09"]
    assert words(lines[3]) == ["edmctl", "2.26", "0.44", "0.50", "0.10"]
    assert words(lines[4])[:6] == ["edmctl,", "noise", "taken", "off", "1.90", "0.41"]
    assert len({len(line) for line in lines[:6]}) == 1


def test_uncertainties_are_95_percent_intervals() -> None:
    text = render_calibration(made_findings())
    assert "gain           2.9750 ± 0.0020 µm/V" in text
    assert "stroke         446.25 ± 0.29 µm from 0.0 V to 150.0 V" in text
    assert "creep          2.80 ± 0.10 % per decade of time" in text
    assert "delay          0.60 ms" in text


def test_validation_has_its_own_block_and_says_what_was_fitted_again() -> None:
    file = made_file("b.csv")
    text = render_calibration(
        made_findings(
            validated=made_figures(), validated_baselines=BASELINES, files=(file,), refit=("gain", "zero")
        )
    )
    block = text.split("\n\n")[1].splitlines()
    assert block[0].startswith("b.csv ")
    assert block[-1] == "Gain and zero are fitted to each file first."
    assert len(block) == 5


def test_each_of_several_validation_files_has_a_row() -> None:
    files = (made_file("b.csv"), made_file("c.csv", max_um=3.0))
    text = render_calibration(
        made_findings(validated=made_figures(max_um=3.0), validated_baselines=BASELINES, files=files)
    )
    block = text.split("\n\n")[1].splitlines()
    assert block[0].startswith("2 files ")
    assert [line.split()[1] for line in block[4:6]] == ["b.csv", "c.csv"]


def test_small_ranges_are_told_to_the_nanometre() -> None:
    small = made_findings(held_out=made_figures(max_um=0.1234, range_um=20.0))
    assert "0.123" in render_calibration(small)


def test_what_is_not_accepted_is_said_with_the_reason() -> None:
    assert "\nAccepted." in render_calibration(made_findings())
    text = render_calibration(
        made_findings(identification=Found(problems=("Too bad: redo.",), notes=("Short.",)))
    )
    assert text.splitlines()[-2:] == ["Not accepted: Too bad: redo.", "Note: Short."]
    assert "Accepted." not in text
    limited = render_calibration(made_findings(identification=Found(restrictions=("for one rate.",))))
    assert limited.splitlines()[-1] == "Accepted for one rate."


def test_the_lever_factor_is_told_with_its_interval() -> None:
    assert render_lever(LEVER) == "lever factor   18.020 ± 0.050"
    assert "lever factor   18.020 ± 0.050" in render_calibration(made_findings(), LEVER)


def test_a_plan_lists_when_each_leg_begins() -> None:
    plan = CalibrationPlan((Leg(150.0, 2.0), Leg(0.0, 0.5)), 5000)
    lines = render_plan(plan).splitlines()
    assert [words(line) for line in lines[:3]] == [
        ["at", "s", "to", "V", "in", "s"],
        ["0.0", "150.0", "2.000"],
        ["2.0", "0.0", "0.500"],
    ]
    times = f"{duration(plan.duration_s)} or more, {count(plan.samples)} samples or more, without pulses"
    assert lines[3].startswith(f"2 legs between 0 V and 150.0 V in {times}")
