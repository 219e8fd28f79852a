"""The table of `calibrate`."""

from __future__ import annotations

from edmctl.actuator.waveforms import Leg
from edmctl.cli.render.calibration_tables import render_calibration, render_lever, render_plan
from edmctl.procedures.actuator.calibration import CalibrationPlan
from edmctl.wording import count, duration
from tests.cli.render.views import BASELINES, LEVER, Found, made_figures, made_file, made_findings


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
