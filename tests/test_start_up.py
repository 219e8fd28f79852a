"""Start of a process: garbage of a run is freed before the next one, and a wrong clock is a clear error."""

from __future__ import annotations

import subprocess
import sys
import time
import weakref

import pytest

import edmctl
from edmctl.app import main
from edmctl.errors import PreconditionError
from edmctl.start_up import collect_garbage


class Machine:
    """Refers to itself, as a virtual machine does to its parts."""

    def __init__(self) -> None:
        self.itself = self


def test_a_machine_that_refers_to_itself_is_freed_before_the_next_run() -> None:
    seen = weakref.ref(Machine())
    assert seen() is not None
    collect_garbage()
    assert seen() is None


SCRIPT = """
import gc
from edmctl.start_up import collect_garbage, spare_start_up
collect_garbage()
print(gc.get_freeze_count() > 0)
spare_start_up()
collect_garbage()
print(gc.get_freeze_count() > 0)
"""


def test_only_a_process_of_edmctl_itself_keeps_objects_out_of_the_search() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]


def test_a_clock_beyond_its_range_is_a_clear_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def late() -> float:
        raise OverflowError("timestamp too large to convert to C _PyTime_t")

    monkeypatch.setattr(time, "time", late)
    for call in (edmctl.connect, lambda: edmctl.calibrate_files("record.csv")):
        with pytest.raises(PreconditionError) as error:
            call()
        assert error.value.code == "E8096"
    assert main(["run", "list"]) == 8
    assert "error[E8096]" in capsys.readouterr().err
