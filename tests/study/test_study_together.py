"""Several clocks, benches and people at one study."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import pytest

from edmctl.errors import PreconditionError
from edmctl.jobs.plan import MachineAddress
from edmctl.record.json_rows import SUFFIX
from edmctl.study.folder import open_folder
from edmctl.study.results import Judgement, RunKind, RunState
from edmctl.study.rows import MACHINE, bench_of
from edmctl.study.running import bare_row, refuse_mixture
from edmctl.study.suggestions import next_batch, suggestions
from edmctl.study.table import what_next
from tests.study.studies import HEAD, RESPONSES, SMALL, TWO_FACTORS, made

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.study.folder import StudyFolder
    from edmctl.study.results import PlannedRun

RANGES = TWO_FACTORS.replace("levels = [0.7, 0.8]", "low = 0.7\nhigh = 0.8").replace(
    "levels = [0.2, 0.4]", "low = 0.2\nhigh = 0.4"
)
BY_HAND = (
    HEAD
    + RANGES
    + '[design]\nkind = "lhs"\nruns = 6\n\n[optimize]\nruns = 9\n'
    + RESPONSES.replace('response = "machining_time_s"', 'response = "ra_um"')
)


def come_to(folder: StudyFolder, runs: list[PlannedRun], time_s: float = 20.0) -> None:
    """Write the rows of runs that were made."""
    with folder.writer() as writer:
        for run in runs:
            row = bare_row(run, 1, run.seed, datetime.now(UTC))
            writer.run(replace(row, responses={"machining_time_s": time_s, "wear_ratio_lin": 0.2}))


def tell_all(folder: StudyFolder, names: tuple[str, ...] = ("ra_um",)) -> None:
    """Tell what people measure of every run that was made and lacks it."""
    state = folder.read()
    with folder.writer() as writer:
        for run in state.runs:
            if run.state is RunState.DONE and not run.told:
                value = 0.2 + float(run.planned.settings["pulse.duty"])
                writer.told(run, dict.fromkeys(names, value))


def later_by_a_day(folder: StudyFolder) -> None:
    """Make it that all rows were written a day later, as by a clock that was put back since."""
    for file in folder.rows.glob(f"*{SUFFIX}"):
        lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
        for line in lines:
            line["when"] = (datetime.fromisoformat(line["when"]) + timedelta(days=1)).isoformat()
        file.write_text("".join(f"{json.dumps(line)}\n" for line in lines), encoding="utf-8")


def test_what_is_told_and_judged_last_counts_after_a_clock_was_put_back(tmp_path: Path) -> None:
    folder = made(tmp_path, SMALL)
    come_to(folder, [run.planned for run in folder.read().runs])
    tell_all(folder)
    later_by_a_day(folder)
    with folder.writer() as writer:
        writer.told(folder.read().runs[0], {"ra_um": 1.5})
        writer.told(folder.read().runs[1], {"ra_um": None})
    state = folder.read()
    assert (state.runs[0].value("ra_um"), state.runs[1].value("ra_um")) == (1.5, None)


def test_holes_are_in_the_order_in_which_they_were_made_whatever_the_clock_said(tmp_path: Path) -> None:
    from edmctl.study.on_machine import is_of_next_tool, next_order

    machine = "[machine]\nholes_per_tool = 4\n"
    folder = made(tmp_path, SMALL.replace('kind = "full"', 'kind = "full"\nreplicates = 2') + machine)
    runs = [run.planned for run in folder.read().runs]
    now = datetime.now(UTC)
    with folder.writer() as writer:
        for count, run in enumerate(runs[:5]):
            started = now - timedelta(days=count)
            row = replace(bare_row(run, 1, None, started), tool=run.tool, order=next_order(folder.read()))
            writer.run(row)
    state = folder.read()
    assert next_order(state) == 6
    made_last = max((run.row for run in state.runs if run.row is not None), key=lambda row: row.order)
    assert made_last.number == runs[4].number
    assert not is_of_next_tool(state, state.runs[5])


def optimised_once(tmp_path: Path) -> tuple[StudyFolder, list[PlannedRun]]:
    """A study whose design is told, and its first suggestion, made and not told yet."""
    folder = made(tmp_path, BY_HAND)
    come_to(folder, [run.planned for run in folder.read().runs])
    tell_all(folder)
    batch = next_batch(folder.read())
    with folder.writer() as writer:
        writer.planned(batch)
    come_to(folder, batch)
    return folder, batch


def test_an_optimisation_waits_for_what_people_measure(tmp_path: Path) -> None:
    folder, batch = optimised_once(tmp_path)
    with pytest.raises(PreconditionError, match="waits for ra_um") as waiting:
        next_batch(folder.read())
    assert waiting.value.code == "E8216"
    assert f"tell {folder.path} {batch[0].number} ra_um=VALUE" in waiting.value.hint
    tell_all(folder)
    assert next_batch(folder.read())
    assert any("of the optimisation" in line for line in what_next(folder.read(), "optimize"))


def test_a_suggestion_is_not_the_one_that_was_added_and_is_not_made_yet(tmp_path: Path) -> None:
    folder = made(tmp_path, BY_HAND.replace("runs = 9", "runs = 30"))
    come_to(folder, [run.planned for run in folder.read().runs])
    tell_all(folder)
    together = [one.settings for one in suggestions(folder.read(), 2)]
    one_by_one = []
    for _ in range(2):
        (added,) = suggestions(folder.read(), 1)
        with folder.writer() as writer:
            writer.planned([added])
        one_by_one.append(added.settings)
    assert one_by_one == together
    assert one_by_one[0] != one_by_one[1]


def test_a_rejected_suggestion_is_no_longer_waited_for(tmp_path: Path) -> None:
    folder, batch = optimised_once(tmp_path)
    with folder.writer() as writer:
        values = {
            "number": batch[0].number,
            "attempt": 1,
            "judgement": str(Judgement.REJECT),
            "reason": "chip",
        }
        writer.append("judged", values)
    assert [one.kind for one in next_batch(folder.read())] == [RunKind.SUGGESTED]


def test_a_bench_is_the_same_file_from_every_folder_and_is_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = made(tmp_path, SMALL)
    monkeypatch.chdir(tmp_path)
    bench = tmp_path / "bench.h5"
    bench.touch()
    with folder.writer() as writer:
        writer.append(MACHINE, {"port": "sim:bench.h5", "bench": bench_of("sim:bench.h5")})
    come_to(folder, [folder.read().runs[0].planned])
    assert folder.read().rows.port == "sim:bench.h5"
    refuse_mixture(folder.read(), MachineAddress("sim:bench.h5"))
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path / "other")
    state = open_folder(tmp_path / "made").read()
    assert state.rows.port == f"sim:{bench}"
    with pytest.raises(Exception, match="made on the machine at"):
        refuse_mixture(state, MachineAddress("sim:bench.h5"))
    bench.unlink()
    with pytest.raises(PreconditionError, match="is gone") as gone:
        refuse_mixture(state, MachineAddress(f"sim:{bench}"))
    assert gone.value.code == "E8214"
