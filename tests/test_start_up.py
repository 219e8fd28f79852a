"""Garbage of a run is freed before the next one, and what a process keeps is not searched again."""

import subprocess
import sys
import weakref

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
