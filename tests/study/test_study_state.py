"""A study in the hands of several clocks, benches and people, and the command that continues it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from edmctl.app import main
from edmctl.dataclasses import replace
from edmctl.errors import PreconditionError, RunFileError, UsageError
from edmctl.jobs.plan import MachineAddress
from edmctl.record.json_rows import SUFFIX
from edmctl.study.folder import StudyFolder, create_folder, open_folder
from edmctl.study.on_machine import is_of_next_tool, next_order
from edmctl.study.planning import plan_study
from edmctl.study.results import Judgement, PlannedRun, RunKind, RunState
from edmctl.study.running import bare_row, refuse_mixture
from edmctl.study.study_file import read_study
from edmctl.study.suggestions import next_batch, suggestions
from edmctl.study.table import what_next
from tests.study.studies import HEAD, MACHINE, RANGES, RESPONSES, SMALL, come_to, made, written

BY_HAND = (
    HEAD
    + RANGES
    + '[design]\nkind = "lhs"\nruns = 6\n\n[optimize]\nruns = 9\n'
    + RESPONSES.replace('response = "machining_time_s"', 'response = "ra_um"')
)


def alike(run: PlannedRun) -> dict[str, float | None]:
    """A law without effects."""
    return {"machining_time_s": 20.0, "wear_ratio_lin": 0.2}


def tell_all(folder: StudyFolder) -> None:
    """Tell what people measure of every run that was made and lacks it."""
    state = folder.read()
    with folder.writer() as writer:
        for run in state.runs:
            if run.state is RunState.DONE and not run.told:
                value = 0.2 + float(run.planned.settings["pulse.duty"])
                writer.told(run, {"ra_um": value})


def later_by_a_day(folder: StudyFolder) -> None:
    """Make it that all rows were written a day later, as by a clock that was put back since."""
    for file in folder.rows.glob(f"*{SUFFIX}"):
        lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
        for line in lines:
            line["when"] = (datetime.fromisoformat(line["when"]) + timedelta(days=1)).isoformat()
        file.write_text("".join(f"{json.dumps(line)}\n" for line in lines), encoding="utf-8")


def test_what_is_told_and_judged_last_counts_after_a_clock_was_put_back(tmp_path: Path) -> None:
    folder = made(tmp_path, SMALL)
    come_to(folder, alike)
    tell_all(folder)
    later_by_a_day(folder)
    with folder.writer() as writer:
        writer.told(folder.read().runs[0], {"ra_um": 1.5})
        writer.told(folder.read().runs[1], {"ra_um": None})
    state = folder.read()
    assert (state.runs[0].value("ra_um"), state.runs[1].value("ra_um")) == (1.5, None)


def test_holes_are_in_the_order_in_which_they_were_made_whatever_the_clock_said(tmp_path: Path) -> None:
    folder = made(tmp_path, MACHINE.replace('kind = "full"', 'kind = "full"\nreplicates = 2'))
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
    come_to(folder, alike)
    tell_all(folder)
    batch = next_batch(folder.read())
    with folder.writer() as writer:
        writer.planned(batch)
    come_to(folder, alike)
    return folder, batch


def test_an_optimisation_waits_for_what_people_measure(tmp_path: Path) -> None:
    folder, batch = optimised_once(tmp_path)
    number = batch[0].number
    with pytest.raises(PreconditionError, match="waits for ra_um") as waiting:
        next_batch(folder.read())
    assert waiting.value.code == "E8216"
    assert f"tell {folder.path} {number} ra_um=VALUE" in waiting.value.hint
    with folder.writer() as writer:
        writer.judged(folder.read().run(number), Judgement.REJECT, "chip")
    assert [one.kind for one in next_batch(folder.read())] == [RunKind.SUGGESTED]
    with folder.writer() as writer:
        writer.judged(folder.read().run(number), Judgement.ACCEPT, "it was none")
    tell_all(folder)
    assert any("of the optimisation" in line for line in what_next(folder.read(), "optimize"))


def test_a_suggestion_is_not_the_one_that_was_added_and_is_not_made_yet(tmp_path: Path) -> None:
    folder = made(tmp_path, BY_HAND.replace("runs = 9", "runs = 30"))
    come_to(folder, alike)
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


def test_a_study_stays_on_its_bench_whatever_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = made(tmp_path, SMALL)
    monkeypatch.chdir(tmp_path)
    bench = tmp_path / "bench.h5"
    bench.touch()
    with folder.writer() as writer:
        writer.on_machine("sim:bench.h5")
    come_to(folder, alike)
    refuse_mixture(folder.read(), MachineAddress("sim:bench.h5"))
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path / "other")
    state = open_folder(tmp_path / "made").read()
    assert state.rows.port == f"sim:{bench}"
    for port in ("sim:", "sim:bench.h5", f"sim:{bench}2", "/dev/ttyUSB0"):
        with pytest.raises(UsageError, match="made on the machine at") as elsewhere:
            refuse_mixture(state, MachineAddress(port))
        assert (elsewhere.value.code, str(bench) in elsewhere.value.hint) == ("E2108", True)
    bench.unlink()
    with pytest.raises(PreconditionError, match="is gone") as gone:
        refuse_mixture(state, MachineAddress(f"sim:{bench}"))
    assert gone.value.code == "E8214"


def on(folder: Path) -> str:
    """The port of `begun` in a command."""
    return f"--port 'sim:{folder}/my bench.h5'"


def begun(folder: Path, numbers: Sequence[int], tool: int = 1) -> StudyFolder:
    """A study on a machine of which some runs are made."""
    study = made(folder, MACHINE)
    with study.writer() as writer:
        writer.on_machine(f"sim:{folder}/my bench.h5")
        for number in numbers:
            run = study.read().run(number).planned
            writer.run(replace(bare_row(run, 1, None, datetime.now(UTC)), tool=tool))
    return study


def test_the_machine_of_a_study_is_named(tmp_path: Path) -> None:
    study = begun(tmp_path, [1, 2])
    command = f"edmctl study resume {study.path} {on(tmp_path)}"
    assert study.read().making_command() == command
    with study.writer() as writer:
        writer.paused(study.read().run(3), "E8043: worn")
    steps = what_next(study.read())
    assert steps[0] == "Paused before run 3: E8043: worn"
    assert f"`{command}`" in steps[1]


def test_the_command_that_was_called_is_named_again(tmp_path: Path) -> None:
    study = begun(tmp_path, [1])
    with pytest.raises(UsageError) as refused:
        refuse_mixture(study.read(), MachineAddress("sim:"), "confirm")
    assert f"`edmctl study confirm {study.path} {on(tmp_path)}`" in refused.value.hint


def test_a_repeated_run_on_a_machine_is_another_hole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = begun(tmp_path, [1])
    assert main(["study", "judge", str(study.path), "1", "repeat", "a chip"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"{on(tmp_path)}` makes it again, as another hole" in said
    assert main(["study", "judge", str(study.path), "2", "repeat", "a chip"]) == 2
    assert f"`edmctl study resume {study.path} {on(tmp_path)}`" in capsys.readouterr().err


def test_nothing_is_added_where_runs_cannot_be_made(tmp_path: Path) -> None:
    study = begun(tmp_path, [1, 2, 3, 4])
    assert main(["study", "confirm", str(study.path)]) == 2
    assert not study.read().rows.added


def test_a_folder_has_one_study(tmp_path: Path) -> None:
    study = made(tmp_path)
    with pytest.raises(RunFileError, match="has a study already") as taken:
        create_folder(study.path, plan_study(read_study(written(tmp_path))))
    assert f"`edmctl study resume {study.path}`" in taken.value.hint
    (study.path / "profile.toml").write_text("changed", encoding="utf-8")
    with pytest.raises(PreconditionError, match=r"profile\.toml is not what it was"):
        open_folder(study.path)
    with pytest.raises(UsageError, match="has no study"):
        open_folder(tmp_path)
    with pytest.raises(RunFileError, match="is not empty"):
        create_folder(tmp_path, plan_study(read_study(written(tmp_path))))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["made", "study.toml"]
