"""What a process of the command line spares itself at its start."""

from __future__ import annotations

import gc
import os

from edmctl.blas import VARIABLES

FEW_CYCLES = 100_000
"""So many objects more than were freed have the garbage collector look; Python's number is 700. What a command makes
by the thousand, rows and frames, is freed as it goes, and each look at all that was imported takes some 40 ms."""


def spare_start_up() -> None:
    """Spare a process of the command line what it never uses; a program that imports edmctl has it all.

    BLAS keeps to one thread: matrices are small, and threads would only wait for each other, on busy cores 40 ms at
    a time. The garbage collector looks for cycles rarely.
    """
    gc.set_threshold(FEW_CYCLES)
    for name in VARIABLES:
        os.environ.setdefault(name, "1")
