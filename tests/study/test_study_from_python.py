"""Studies from Python: what is told counts for the run that it is of, whoever adds runs at the same time."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from edmctl.errors import UsageError
from edmctl.study.results import Judgement
from edmctl.study.study import Study
from tests.study.studies import FULL, HEAD, RANGES, RESPONSES, made, make_some, written

IN_RANGES = f"{HEAD}{RANGES}{FULL}{RESPONSES}"


def test_runs_that_several_threads_add_keep_their_settings(tmp_path: Path) -> None:
    folder = made(tmp_path, IN_RANGES.replace('"full"', '"lhs"\nruns = 4'))

    def one(reference: float) -> tuple[int, float]:
        study = Study.load(folder.path)
        run = study.add({"servo.reference": reference, "pulse.duty": 0.3})
        study.tell(run, {"machining_time_s": 100.0 * reference})
        return run.number, reference

    given = [0.71, 0.73, 0.75, 0.77]
    with ThreadPoolExecutor(4) as pool:
        added = dict(pool.map(one, given))
    assert sorted(added) == [5, 6, 7, 8]
    state = folder.read()
    for number, reference in added.items():
        run = state.run(number)
        assert run.planned.settings["servo.reference"] == reference
        assert run.value("machining_time_s") == 100.0 * reference


@pytest.mark.parametrize("value", [True, "0.3", None, math.nan, math.inf, np.array([1.0]), -5.0, 10**400])
def test_a_value_that_is_no_possible_number_is_refused(tmp_path: Path, value: object) -> None:
    study = Study.load(made(tmp_path).path)
    for values in ({"machining_time_s": value}, {}):
        with pytest.raises(UsageError) as refused:
            study.tell(1, values)  # type: ignore[arg-type]
        assert refused.value.code == "E2105"


def test_what_was_measured_is_not_told_over_but_a_repeated_run_is_told_anew(tmp_path: Path) -> None:
    folder = made(tmp_path)
    study = Study.load(folder.path)
    (first,) = study.ask()
    study.tell(np.int64(first.number), {"machining_time_s": np.float64(20.0), "ra_um": 0.3})
    study.tell(first, {"machining_time_s": 21.0})  # what was told may be corrected
    assert folder.read().run(1).value("machining_time_s") == 21.0
    with folder.writer() as writer:
        writer.judged(folder.read().run(1), Judgement.REPEAT, "a chip")
    assert study.ask()[0].number == 1
    study.tell(first, {"machining_time_s": 19.0})
    run = folder.read().run(1)
    assert (run.attempts, run.value("machining_time_s")) == (2, 19.0)
    assert study.ask()[0].number == 2
    second = study.ask()[0]
    make_some(folder, second.number)
    assert folder.read().run(second.number).row is not None
    with pytest.raises(UsageError) as measured:
        study.tell(second, {"machining_time_s": 1.0})
    assert measured.value.code == "E2105"
    study.tell(second, {"ra_um": 0.2})


def test_settings_beyond_the_bounds_are_not_added(tmp_path: Path) -> None:
    study = Study.load(made(tmp_path, IN_RANGES.replace('"full"', '"lhs"\nruns = 4')).path)
    for reference in (0.6, "0.7", True):
        with pytest.raises(UsageError) as refused:
            study.add({"servo.reference": reference, "pulse.duty": 0.3})
        assert refused.value.code == "E2110"
    with pytest.raises(TypeError):
        study.tell(True, {"machining_time_s": 1.0})
    with pytest.raises(UsageError):
        study.ask(-1)
    run = study.add({"servo.reference": np.float64(0.75), "pulse.duty": np.float32(0.3)})  # type: ignore[dict-item]
    assert run.settings["servo.reference"] == 0.75
    assert type(run.settings["pulse.duty"]) is float


def test_a_study_may_be_made_in_the_empty_folder_where_one_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = written(tmp_path)
    empty = tmp_path / "empty"
    empty.mkdir()
    monkeypatch.chdir(empty)
    assert Study.load(file).start(".").plan().runs
