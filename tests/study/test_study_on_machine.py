"""A study on a machine that lasts: places, tools, pauses, interruptions, faults, approval."""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import pytest

from edmctl.app import main
from edmctl.errors import Diagnostic, EdmWarning, Interrupted, MachineFault, PreconditionError, UsageError
from edmctl.jobs.plan import Plan
from edmctl.jobs.surroundings import Surroundings
from edmctl.machine.stop import StopRequest
from edmctl.results.progress import Progress
from edmctl.simulator import BenchConfig, open_bench
from edmctl.simulator.injection import parse_injection
from edmctl.study.folder import StudyFolder
from edmctl.study.on_machine import MachineRuns, run_on_machine
from edmctl.study.results import RunState, StudyRun
from edmctl.study.running import bare_row
from edmctl.study.study import Study
from edmctl.study.suggestions import confirmation_runs
from edmctl.study.table import what_next
from tests.serving import serving
from tests.study.studies import MACHINE, SMALL, Unseen, made


def agree(run: StudyRun, plan: Plan) -> bool:
    return True


def options(folder: StudyFolder, **more: object) -> MachineRuns:
    def warn(found: Sequence[Diagnostic]) -> None:
        """Nobody listens."""

    port = f"sim:{folder.path.parent / 'machine.bench'}"
    given = {"port": port, "surroundings": Surroundings(), "approve": agree, "warn": warn, **more}
    return MachineRuns(**given)  # type: ignore[arg-type]


def interrupted(folder: StudyFolder, **more: object) -> Interrupted:
    """The error of a run that is stopped while its hole is cut."""
    seen = Interrupting()
    with pytest.raises(Interrupted) as stopped:
        run_on_machine(
            folder, options(folder, surroundings=Surroundings(stop=lambda _: seen.stop), **more), seen
        )
    return stopped.value


def refused(folder: StudyFolder, **more: object) -> str:
    """The code of the error that keeps the study from running."""
    with pytest.raises(PreconditionError) as error:
        run_on_machine(folder, options(folder, **more), Unseen())
    return error.value.code


class Interrupting(Unseen):
    """Asks for a stop when a hole is being cut."""

    def __init__(self) -> None:
        self.stop = StopRequest()

    def progress(self, p: Progress) -> None:  # type: ignore[override]
        if p.phase == "machining" and p.depth_um > 2.0:
            self.stop.request(signal.SIGINT)


@pytest.mark.slow
def test_tools_change_between_blocks_and_an_interrupted_hole_is_resumed(tmp_path: Path) -> None:
    folder = made(tmp_path, MACHINE)
    assert run_on_machine(folder, options(folder, most=1), Unseen()) == 1
    assert "study resume" in interrupted(folder).hint
    assert folder.read().run(2).row is None
    with pytest.raises(PreconditionError) as worn:
        run_on_machine(folder, options(folder), Unseen())
    assert worn.value.code == "E8204"
    assert "--new-tool" in worn.value.hint
    state = folder.read()
    assert [run.state for run in state.runs[:4]] == [RunState.DONE] * 4
    assert any("tool 1 is done" in line for line in what_next(state))
    assert run_on_machine(folder, options(folder, new_tool=True), Unseen()) == 4
    rows = [run.row for run in folder.read().runs]
    assert [row.tool for row in rows if row] == [1] * 4 + [2] * 4
    places = [row.site_um for row in rows if row]
    assert len(set(places)) == len(places) == 8
    resumed = rows[1]
    assert resumed is not None
    assert resumed.run_files == ("run0002-r1.h5",)
    assert all(math.isfinite(row.responses["wear_um"] or math.nan) for row in rows if row)
    worn_um = [row.truth["wear_um"] for row in rows if row]
    assert all(wear_um and wear_um > 0 for wear_um in worn_um)


def test_an_interrupted_hole_is_abandoned_and_made_anew_with_another_tool(tmp_path: Path) -> None:
    folder = made(tmp_path, MACHINE)
    interrupted(folder)
    with pytest.raises(UsageError) as other_tool:
        run_on_machine(folder, options(folder, new_tool=True), Unseen())
    assert other_tool.value.code == "E2108"
    judge = ["study", "judge", str(folder.path), "1", "repeat"]
    with folder.claimed():  # another command is making it
        assert main([*judge, "odd"]) == 8
    assert main([*judge, "  "]) == 2
    assert folder.read().run(1).row is None
    assert main([*judge, "the tool broke"]) == 0
    assert run_on_machine(folder, options(folder, new_tool=True, most=1), Unseen()) == 1
    run = folder.read().run(1)
    assert run.row is not None
    assert (run.row.attempt, run.row.tool, run.row.run_files) == (2, 2, ("run0001-a2.h5",))
    assert folder.read().rows.attempts[1][0].exit_code == 130
    assert run.row.site_um == (1100.0, 0.0)
    ledger = folder.runs / "ledger.jsonl"
    lines = [json.loads(line) | {"serial": "other"} for line in ledger.read_text("utf-8").splitlines()]
    ledger.write_text("".join(f"{json.dumps(line)}\n" for line in lines), encoding="utf-8")
    assert refused(folder) == "E8214"
    assert [run.state for run in folder.read().runs].count(RunState.DONE) == 1


@pytest.mark.slow
def test_a_tool_that_is_changed_early_ends_with_its_block(tmp_path: Path) -> None:
    folder = made(tmp_path, MACHINE)
    assert run_on_machine(folder, options(folder, most=2), Unseen()) == 2
    interrupted(folder, new_tool=True)
    assert refused(folder) == "E8204"
    rows = sorted((run.row for run in folder.read().runs if run.row), key=lambda row: row.started)
    assert [(row.number, row.tool) for row in rows] == [(1, 1), (2, 1), (3, 2), (4, 2)]
    assert [run.block for run in folder.read().runs if run.row] == [1, 1, 2, 2]
    assert run_on_machine(folder, options(folder, new_tool=True, most=1), Unseen()) == 1
    run = folder.read().run(5)
    assert (run.tool, run.block, run.planned.tool) == (3, 3, 2)


@pytest.mark.slow
def test_a_hole_whose_row_was_lost_is_read_from_its_run_file_with_its_tool(tmp_path: Path) -> None:
    folder = made(tmp_path, MACHINE)
    run_on_machine(folder, options(folder, most=1), Unseen())
    run_on_machine(folder, options(folder, most=1, new_tool=True), Unseen())
    before = folder.read().run(2).row
    (newest,) = [file for file in folder.rows.glob("*.jsonl") if b'"number": 2' in file.read_bytes()]
    lines = newest.read_bytes().splitlines(keepends=True)
    newest.write_bytes(b"".join(line for line in lines if b'"run"' not in line))
    run_on_machine(folder, options(folder, most=1), Unseen())
    rows = sorted((run.row for run in folder.read().runs if run.row), key=lambda row: row.started)
    assert [(row.number, row.tool, row.order) for row in rows] == [(1, 1, 1), (2, 2, 2)]
    assert before is not None
    assert (rows[1].responses, rows[1].site_um) == (before.responses, before.site_um)
    assert len(list(folder.runs.glob("*.h5"))) == 2


def test_a_run_without_room_is_not_added_and_one_may_be_rejected_unmade(tmp_path: Path) -> None:
    folder = made(tmp_path, SMALL + "\n[machine]\ncenter_runs = false\ncolumns = 4\nrows = 1\n")
    with folder.writer() as writer:
        writer.on_machine("sim:there.bench")
        writer.run(bare_row(folder.plan.runs[0], 1, None, datetime.now(UTC)))
    with pytest.raises(PreconditionError) as full:
        confirmation_runs(folder.read(), folder.plan.runs[0].settings, 1)
    assert full.value.code == "E8207"
    assert main(["study", "judge", str(folder.path), "4", "reject", "no room"]) == 0
    assert folder.read().run(4).state is RunState.REJECTED
    assert len(confirmation_runs(folder.read(), folder.plan.runs[0].settings, 1)) == 1


def test_a_study_of_a_machine_is_not_mixed_from_python(tmp_path: Path) -> None:
    folder = made(tmp_path, MACHINE)
    with folder.writer() as writer:
        writer.on_machine("sim:there.bench")
    with pytest.warns(EdmWarning, match="W8215"), pytest.raises(UsageError) as mixed:
        Study.load(folder.path).run()
    assert mixed.value.code == "E2108"


def test_a_run_that_is_not_approved_is_not_made(tmp_path: Path) -> None:
    folder = made(tmp_path, MACHINE.replace("holes_per_tool = 4", 'holes_per_tool = 4\napproval = "each"'))
    assert refused(folder, approve=lambda run, plan: False) == "E8205"
    assert folder.read().run(1).row is None
    assert not folder.runs.exists() or not list(folder.runs.glob("*.h5"))


@pytest.mark.slow
def test_a_fault_stops_the_study_and_the_hole_is_resumed_once_it_is_mended(tmp_path: Path) -> None:
    folder = made(tmp_path, MACHINE)
    bench = open_bench(BenchConfig(), 5)
    bench.inject(parse_injection("ESTOP@sparks+2"))
    with serving(bench) as port:
        with pytest.raises(MachineFault) as fault:
            run_on_machine(folder, options(folder, port=port), Unseen())
        assert "study resume" in fault.value.hint
        assert folder.read().run(1).row is None
        bench.clear_injections()
        assert refused(folder, port=port) == "E8010"
        assert main(["reset", "--ack", "4001", "--port", port]) == 0
        assert refused(folder, port=port) == "E8204"
    rows = [run.row for run in folder.read().runs]
    assert rows[0] is not None
    assert rows[0].run_files == ("run0001-r1.h5",)
    assert [row.exit_code for row in rows if row] == [0] * 4
