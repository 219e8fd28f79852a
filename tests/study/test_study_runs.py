"""Runs of a study: rows that stay, whoever dies; the same table from one process, and two."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from edmctl.dataclasses import replace
from edmctl.errors import PreconditionError
from edmctl.jobs.parallel import FEEDER, Lost, Pool, perform, pool_of
from edmctl.study.folder import StudyFolder, open_folder, read_rows
from edmctl.study.results import Judgement, RunState
from edmctl.study.running import run_virtual
from edmctl.study.table import missing_manual, reported_values, table_of
from tests.cli.commands import in_process_of_its_own
from tests.study.studies import Unseen, come_to, made, make_some, outcome, written


def spawned() -> Executor:
    return ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"))


TWO = Pool(spawned, 2, lambda executor: executor.shutdown(wait=False, cancel_futures=True))


class Stopped(Exception):
    """Ends a study in the middle."""


@pytest.mark.slow
def test_what_was_finished_before_a_stop_stays_and_the_rest_follows(
    tmp_path: Path, whole: StudyFolder
) -> None:
    study = made(tmp_path)

    class Stopping(Unseen):
        def runs(self, done: int, total: int) -> None:
            if done == 2:
                raise Stopped

    with pytest.raises(Stopped):
        run_virtual(study, Stopping())
    kept = outcome(study.read())[:2]
    assert run_virtual(open_folder(study.path), Unseen()) == 2
    assert outcome(study.read())[:2] == kept
    assert outcome(study.read()) == outcome(whole.read())


def square_or_die(task: tuple[int, str]) -> int:
    number, flag = task
    try:
        os.close(os.open(flag, os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        return number * number
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


def die(number: int) -> int:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def die_beside(task: tuple[int, Path]) -> int:
    """Die as number 1, while another is under way where one comes; the others take longer than that dying does."""
    number, folder = task
    if number == 1:
        for _ in range(100):
            if any(folder.iterdir()):
                break
            time.sleep(0.02)
        shutil.rmtree(folder)
        folder.mkdir()
        os.kill(os.getpid(), signal.SIGKILL)
    (folder / str(number)).touch()
    time.sleep(1.0)
    (folder / str(number)).unlink(missing_ok=True)
    return number


@pytest.mark.slow
def test_nobody_is_lost_beside_one_that_dies(tmp_path: Path) -> None:
    found: dict[int, int | Lost] = {}
    perform(die_beside, [(number, tmp_path) for number in range(3)], TWO, found.__setitem__)
    assert isinstance(found.pop(1), Lost)
    assert found == {0: 0, 2: 2}


@pytest.mark.slow
def test_a_killed_worker_costs_no_result(tmp_path: Path) -> None:
    flag = str(tmp_path / "killed")
    found: dict[int, int | Lost] = {}
    perform(square_or_die, [(n, flag) for n in range(8)], TWO, found.__setitem__)
    assert found == {n: n * n for n in range(8)}
    found.clear()
    perform(die, list(range(4)), TWO, found.__setitem__)
    assert isinstance(found.pop(1), Lost)
    assert found == {0: 0, 2: 2, 3: 3}


@pytest.mark.slow
def test_two_workers_make_the_same_table(tmp_path: Path, whole: StudyFolder) -> None:
    study = made(tmp_path)
    run_virtual(study, Unseen(), None, TWO)
    assert outcome(study.read()) == outcome(whole.read())


def test_a_row_has_settings_responses_truth_and_host(whole: StudyFolder) -> None:
    first: dict[str, Any] = table_of(whole.read())[0]
    assert first["exit_code"] == 0
    assert first["servo.reference"] in (0.7, 0.8)
    assert first["machining_time_s"] > 0
    assert abs(first["depth_um"] - first["truth.depth_um"]) <= first["depth_um_u95"]
    shares = [first[f"{kind}_share"] for kind in ("open", "normal", "arc", "short")]
    assert sum(shares) == pytest.approx(1.0, abs=1e-5)
    assert first["host"]
    assert list(first)[-5:] == ["run_file", "run_sha256", "started", "duration_s", "host"]


def test_a_line_that_was_cut_off_is_no_row(tmp_path: Path, whole: StudyFolder) -> None:
    (file,) = [path for path in whole.rows.glob("*.jsonl") if path.stat().st_size > 1000]
    lines = file.read_bytes().splitlines(keepends=True)
    rows = tmp_path / "rows"
    rows.mkdir()
    (rows / "a.jsonl").write_bytes(b"".join(lines[:2]) + lines[2][:100])
    (rows / "b.jsonl").write_bytes(lines[1] + b"\0" * 20 + b"\n" + b'{"row": "run"}\n' + lines[3])
    found = read_rows(rows)
    assert (sorted(found.attempts), found.torn) == ([1, 2, 4], 3)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b'"attempt": 1', b'"attempt": "1"'),
        (b'"responses": {"time_s": ', b'"responses": {"time_s": true, "other": '),
        (b'"settings": {', b'"settings": 7, "seen": {'),
        (b'"seed": ', b'"seed": 0.5, "seed_was": '),
    ],
)
def test_a_row_of_wrong_kinds_is_no_row(
    tmp_path: Path, whole: StudyFolder, before: bytes, after: bytes
) -> None:
    (file,) = [path for path in whole.rows.glob("*.jsonl") if path.stat().st_size > 1000]
    first = file.read_bytes().splitlines(keepends=True)[0]
    assert before in first
    (tmp_path / "a.jsonl").write_bytes(first.replace(before, after, 1))
    found = read_rows(tmp_path)
    assert (dict(found.attempts), found.torn) == ({}, 1)


def test_people_report_and_judge(tmp_path: Path) -> None:
    study = made(tmp_path)
    come_to(study, lambda run: {"machining_time_s": 20.0})
    assert missing_manual(study.read()) == [(number, ("ra_um",)) for number in (1, 2, 3, 4)]
    with study.writer() as writer:
        for text in ("ra_um=0.31", "ra_um=0.33"):
            writer.told(study.read().run(1), reported_values(study.read(), [text]))
    assert study.read().run(1).value("ra_um") == 0.33
    for judgement, state in (
        (Judgement.REJECT, RunState.REJECTED),
        (Judgement.ACCEPT, RunState.DONE),
        (Judgement.REPEAT, RunState.OPEN),
    ):
        with study.writer() as writer:
            writer.judged(study.read().run(1), judgement, "a chip")
        assert study.read().run(1).state is state
    make_some(study, 1)
    again = study.read().run(1)
    assert again.state is RunState.DONE
    assert again.row is not None
    assert again.row.attempt == 2
    assert again.value("ra_um") is None  # that was another hole


def test_one_command_makes_runs_at_a_time(tmp_path: Path) -> None:
    study = made(tmp_path)
    with study.claimed(), pytest.raises(PreconditionError) as busy:
        run_virtual(study, Unseen())
    assert busy.value.code == "E8201"


def test_a_recipe_that_changed_under_the_study_is_refused(tmp_path: Path) -> None:
    study = made(tmp_path)
    other = replace(study, recipes={point: ("other", "hash") for point in study.recipes})
    with pytest.raises(PreconditionError) as refused:
        run_virtual(other, Unseen())
    assert refused.value.code == "E8203"


CLUSTER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=None, silence_logs=50) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


@pytest.mark.slow
@pytest.mark.needs("distributed")
def test_a_dask_cluster_makes_the_same_table(tmp_path: Path, whole: StudyFolder) -> None:
    script = tmp_path / "cluster.py"
    script.write_text(CLUSTER, encoding="utf-8")
    file, out = written(tmp_path), tmp_path / "out"
    cluster = subprocess.Popen(
        [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=tmp_path
    )
    try:
        assert cluster.stdout is not None
        address = cluster.stdout.readline().strip()
        done = in_process_of_its_own(
            "study", "run", str(file), "--out", str(out), "--dask", address, "-q", cwd=tmp_path
        )
        assert done.exit_code == 0, done.err
    finally:
        cluster.communicate()
    assert outcome(open_folder(out).read()) == outcome(whole.read())
    nobody = in_process_of_its_own(
        "study", "resume", str(out), "--dask", "tcp://127.0.0.1:9", "-q", cwd=tmp_path
    )
    assert nobody.exit_code == 8
    assert "E8212" in nobody.err


def test_what_a_broken_pool_s_own_threads_say_is_not_told_and_all_else_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    heard: list[str] = []
    monkeypatch.setattr(threading, "excepthook", lambda raised: heard.append(raised.thread.name))

    def fail() -> None:
        raise OSError("bad file descriptor")

    class AtOnce(Executor):
        """Runs a task while it is handed over, with a thread beside it that fails."""

        def submit(self, function, /, *arguments, **named):  # type: ignore[no-untyped-def]
            for name in (FEEDER, "another"):
                thread = threading.Thread(target=fail, name=name)
                thread.start()
                thread.join()
            done: Future[int] = Future()
            done.set_result(function(*arguments, **named))
            return done

    results: dict[int, object] = {}
    perform(lambda task: 2 * task, [1, 2], pool_of(AtOnce, 1), results.__setitem__)
    assert results == {0: 2, 1: 4}
    assert set(heard) == {"another"}
    threading.excepthook(SimpleNamespace(thread=SimpleNamespace(name=FEEDER)))  # type: ignore[arg-type]
    assert FEEDER in heard  # afterwards all is as it was


UNGUARDED = """
from edmctl.jobs.parallel import perform, process_pool, silent_program
perform(abs, [1, 2], process_pool(1, silent_program()), print)
"""


def test_a_script_without_a_guard_is_refused_soon(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED, encoding="utf-8")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert done.stderr.rstrip().rpartition("\n")[2].startswith("E8218; help: Put its calls under")
