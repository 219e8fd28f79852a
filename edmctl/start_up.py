"""What a process of its own spares itself: one of the command line, or a worker of many runs."""

from __future__ import annotations

import gc
import os
import time

from edmctl import failures
from edmctl.blas import VARIABLES

FEW_CYCLES = 200_000
"""Objects made since the last search for cycles at which Python searches again; its own number is 700. Rows and
frames are freed without a search, and each search looks at all that was imported, for some 20 ms."""


def spare_start_up() -> None:
    """Spare this process what edmctl never uses; a program that imports edmctl has it all.

    BLAS keeps to one thread: matrices are small, and threads would only wait for each other, on busy cores 40 ms at
    a time. The garbage collector looks for cycles rarely, and pydantic looks for no plugins in all packages that
    are installed.
    """
    gc.set_threshold(FEW_CYCLES)
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    for name in VARIABLES:
        os.environ.setdefault(name, "1")


def is_spared() -> bool:
    """Return whether this process has called `spare_start_up`."""
    return gc.get_threshold()[0] == FEW_CYCLES


def collect_garbage() -> None:
    """Free the virtual machine of the run before: plant and controller refer to each other.

    In a process that is spared, what is left is not looked at again: modules and caches, 20 ms each time.
    """
    gc.collect()
    if is_spared():
        gc.freeze()


def refuse_wrong_clock() -> None:
    """Raise PreconditionError E8096 if the clock of this computer is beyond what Python can represent (2262)."""
    try:
        time.time()
    except OverflowError:
        raise failures.clock_wrong() from None
