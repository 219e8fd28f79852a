"""`edmctl run show`: one run on a page, finished, killed, or while it goes on."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.cli.run_follow import follow_run
from edmctl.cli.signals import SignalArrived
from edmctl.errors import RunFileError
from edmctl.record.rows import EventLevel, ServoBlock, SlowRow
from tests.cli.commands import CU270, ROOT, environment
from tests.cli.run_files import begun, finished, killed

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.console.views import ProgressView
    from tests.cli.commands import Here

QUICK = ("target.depth_um=8", "measure.settle_s=0.2", "measure.touches=2", "approach.speed_um_s=5.0")


class Seen:
    """A reporter that keeps what it was told."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.states: list[ProgressView] = []

    def progress(self, p: ProgressView) -> None:
        self.states.append(p)

    def note(self, text: str) -> None:
        self.notes.append(text)

    def runs(self, done: int, total: int) -> None:
        """There are none."""

    def close(self) -> None:
        """Nothing to clean."""


def test_a_job_is_shown_with_the_figures_of_its_own_result(here: Here) -> None:
    options = [word for value in QUICK for word in ("--set", value)]
    made = here(
        "machine", "--profile", CU270, *options, "--seed", "3", "--run-id", "one", "--quiet", "--json"
    )
    site = made.document["result"]["sites"][0]
    said = here("run", "show", "runs/one.h5")
    assert (said.exit_code, said.err) == (0, "")
    assert f"{site['depth_um']:.2f} ± {site['depth_u95_um']:.2f} µm" in said.out
    assert f"{site['truth']['depth_um']:.2f} µm" in said.out
    assert "wanted was a depth of 8 ± 2 µm in Cu" in said.out
    assert "No faults, no warnings." in said.out
    assert max(map(len, said.out.splitlines())) <= 80
    shown = here("run", "show", "runs/one.h5", "--json").document
    assert shown["result"]["summary"] == made.document["result"]
    assert (shown["seed"], shown["simulated"], shown["run_file"]) == (3, True, "runs/one.h5")
    (told,) = shown["result"]["sites"]
    assert told["depth_um"] == site["depth_um"]
    assert told["truth_wear_um"] == site["truth"]["wear_um"]
    assert [touch["kind"] for touch in shown["result"]["touches"]][:2] == ["Z1", "Z2"]
    assert shown["result"]["rows"]["servo"] > 1000


def test_what_is_left_of_a_killed_run_is_shown_and_called_so(here: Here, tmp_path: Path) -> None:
    left = killed(tmp_path, "dead")
    said = here("run", "show", str(left), "--json")
    assert said.exit_code == 9
    assert said.document["error"]["code"] == "E9008"
    assert said.document["result"]["status"] == "interrupted"
    assert said.document["result"]["sites"][0]["depth_um"] == 180.0


def test_the_name_without_partial_will_do(here: Here, tmp_path: Path) -> None:
    writer = begun(tmp_path, "living")
    said = here("run", "show", str(tmp_path / "living.h5"))
    writer.finish("done", 0)
    assert (said.exit_code, said.err) == (0, "")
    assert "status        running" in said.out


def test_following_ends_with_the_run_and_tells_its_news(tmp_path: Path) -> None:
    writer = begun(tmp_path, "living")
    looks = 0

    def wait() -> None:
        nonlocal looks
        looks += 1
        if looks > 3:
            writer.finish("done", 0)
            return
        writer.append_servo(servo(20.0 + looks))
        writer.append_slow(slow(20.0 + looks))
        writer.event(20.0 + looks, 130, EventLevel.INFO, f"Look {looks}.")
        writer.flush()

    seen = Seen()
    assert follow_run(tmp_path / "living.h5.partial", seen, wait) == tmp_path / "living.h5"
    assert seen.notes == ["Look 1.", "Look 2.", "Look 3."]
    assert [state.time_s for state in seen.states] == [
        pytest.approx(t) for t in (9.99, 21.0, 22.0, 23.0, 23.0)
    ]
    newest = seen.states[3]
    assert newest.depth_um == pytest.approx(11.5)
    assert newest.gap_v == pytest.approx(9.6)
    assert newest.ratios.normal == pytest.approx(0.7)


def servo(time_s: float) -> ServoBlock:
    one = np.ones(1)
    return ServoBlock(
        one * time_s,
        one * 20.0,
        one * 60.0,
        one * 59.0,
        one * 9.6,
        one * 0.8,
        one * 0.02,
        one.astype(int),
        one.astype(int) * 4,
    )


def slow(time_s: float) -> SlowRow:
    return SlowRow(time_s, 1.0, 0.8, 0.8, 0.2, 0.7, 0.1, 0.0, time_s / 2, 0.5, math.nan)


def test_a_finished_run_is_not_waited_for(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edmctl.cli.run_follow.time.sleep", pytest.fail)
    said = here("run", "show", "--follow", str(finished(tmp_path, "a")), "--quiet")
    assert (said.exit_code, said.err) == (0, "")
    assert "status        done" in said.out


WRITER = """
import sys
from pathlib import Path
from tests.cli.run_files import begun
writer = begun(Path(sys.argv[1]), "living")
print("ready", flush=True)
sys.stdin.read()
"""


def test_following_ends_when_the_writer_is_killed(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path)],
        cwd=ROOT,
        env=environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"ready\n"
        looks = 0

        def wait() -> None:
            nonlocal looks
            looks += 1
            if looks == 2:
                writer.kill()
                writer.wait()

        with pytest.raises(RunFileError) as caught:
            follow_run(tmp_path / "living.h5.partial", Seen(), wait)
    assert (caught.value.code, looks) == ("E9008", 2)


def test_a_file_that_is_taken_away_does_not_hold_its_follower(tmp_path: Path) -> None:
    left = killed(tmp_path, "dead")
    with pytest.raises(RunFileError) as caught:
        follow_run(left, Seen(), pytest.fail)
    assert caught.value.code == "E9008"


def test_ctrl_c_ends_the_following_and_nothing_else(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(_: float) -> None:
        raise SignalArrived(signal.SIGINT)

    monkeypatch.setattr("edmctl.cli.run_follow.time.sleep", stop)
    writer = begun(tmp_path, "living")
    said = here("run", "show", "--follow", str(tmp_path / "living.h5"), "--quiet")
    assert said.exit_code == 130
    assert writer.finish("done", 0) == tmp_path / "living.h5"
