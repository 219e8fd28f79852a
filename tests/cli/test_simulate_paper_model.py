"""`edmctl simulate actuator --model paper`: the electromechanical model of the paper on a virtual actuator."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edmctl.actuator.paper_model import TABLE_1
from edmctl.errors import PreconditionError
from edmctl.jobs.actuator_trial import (
    PaperTrial,
    Start,
    Wanted,
    displacement,
    fit_model,
    run_paper_trial,
    slow_cycle,
    waveforms,
)
from tests.cli.commands import Here

PAPER = ("simulate", "actuator", "--model", "paper", "--seed", "3", "--quiet")


def tried(shape: str, start: Start = "virgin") -> PaperTrial:
    return run_paper_trial(waveforms(Wanted(shape, None, None, None, None, None)), start, seed=3)


def read(trial: PaperTrial) -> dict[str, float]:
    return {reading.what: reading.ours_um for one in trial.waveforms for reading in one.readings}


def test_the_block_h_reproduces_the_slow_cycle_that_it_was_fitted_to() -> None:
    fitted, slow = fit_model(3), slow_cycle(3)
    ticks_v = np.interp(np.arange(100_001) / 1000.0, slow.t_s, slow.u_v)
    error_um = displacement(fitted, ticks_v, "conditioned")[::10] - slow.y_um
    late = slice(5000, None)  # the first rise is where actuator and model may remember other things
    assert np.abs(error_um[late]).max() < 1.2 * fitted.fit.max_um
    assert np.abs(error_um[late]).max() < 0.02 * fitted.fit.range_um
    assert fitted.model.transducer is TABLE_1


def test_a_virgin_model_is_wrong_at_the_first_trough_alone() -> None:
    virgin, conditioned = read(tried("fig3a")), read(tried("fig3a", "conditioned"))
    assert 20.0 < virgin["first trough"] < 40.0
    assert conditioned["first trough"] < 8.0
    assert virgin["later troughs"] == pytest.approx(conditioned["later troughs"], abs=0.1)


def test_creep_is_seen_after_a_step_and_at_the_crests_and_not_in_the_slow_cycle() -> None:
    step = read(tried("fig4"))
    assert 15.0 < step["as the voltage arrives"] < 35.0
    assert step["as the voltage arrives"] > step["0.1 s later"] > 3.0 * step["5 to 6 s later"]
    assert 8.0 < read(tried("fig3b"))["crests"] < 30.0


def test_all_waveforms_have_one_zero() -> None:
    trial = tried("fig3b", "conditioned")
    (trace,) = trial.traces
    error_um = trace.models_um["paper"] - trace.sensor_um
    assert abs(error_um.mean()) > 3.0
    assert trial.waveforms[0].errors.max_um == pytest.approx(np.abs(error_um).max())
    assert trial.waveforms[0].errors.rms_pct == pytest.approx(
        100.0 * np.sqrt(np.mean(error_um**2)) / trial.stroke_um
    )


def test_an_actuator_that_table_1_cannot_drive_is_refused() -> None:
    with pytest.raises(PreconditionError, match="farther per volt") as refused:
        fit_model(3, replace(TABLE_1, transformer_n_per_v=10.0))
    assert refused.value.code == "E8037"


@pytest.mark.slow
def test_all_figures_are_the_default(here: Here) -> None:
    said = here(*PAPER)
    assert (said.exit_code, said.err) == (0, "")
    lines = said.out.splitlines()
    assert lines[0].split() == ["figure", "error", "paper", "µm", "ours", "µm"]
    assert {line.split()[0] for line in lines[1:12]} == {"3a", "3b", "4", "5", "loop"}
    assert max(map(len, lines)) <= 81


def test_a_figure_is_a_table_keys_with_units_and_files(here: Here) -> None:
    said = here(*PAPER, "fig3b", "--plot", "a.svg", "--data", "a.csv", "--json")
    assert said.exit_code == 0
    result = said.document["result"]
    assert (result["model"], result["start"]) == ("paper", "virgin")
    (waveform,) = result["waveforms"]
    (reading,) = waveform["readings"]
    assert (reading["figure"], reading["what"], reading["paper"]) == ("3b", "crests", "25")
    assert (reading["paper_low_um"], reading["paper_high_um"]) == (25.0, 25.0)
    assert set(waveform["errors"]) == {"max_um", "rms_um", "max_pct", "rms_pct"}
    assert result["transducer"]["stack_n_per_m"] == 6e7
    columns = np.loadtxt("a.csv", delimiter=",", skiprows=1)
    assert Path("a.csv").read_text(encoding="utf-8").splitlines()[0] == "t_s,u_V,truth_um,sensor_um,paper_um"
    at = round(reading["at_s"] * 1000)
    assert abs(columns[at, 4] - columns[at, 3]) == pytest.approx(reading["ours_um"], abs=6e-4)
    drawn = Path("a.svg").read_text(encoding="utf-8")
    for text in ("sensor", "model of the paper", "model − sensor (µm)", "paper", "ours", "simulated, seed 3"):
        assert f">{text}" in drawn
