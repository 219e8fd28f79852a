"""What a process of the command line spares itself at its start."""

from __future__ import annotations

import gc
import os
import sys
from typing import TYPE_CHECKING

from edmctl.blas import VARIABLES

if TYPE_CHECKING:
    from types import ModuleType


FEW_CYCLES = 50_000
"""So many objects more than were freed have the garbage collector look; Python's number is 700. What a command makes
by the thousand, rows and frames, is freed as it goes, and each look at all that was imported takes some 40 ms."""


def spare_start_up() -> None:
    """Spare a process of the command line what it never uses; a program that imports edmctl has it all.

    BLAS keeps to one thread: matrices are small, and threads would only wait for each other, on busy cores 40 ms at
    a time. Numba is told that there is no BLAS, which no compiled loop calls: looking for it takes 0.2 s. The
    garbage collector looks for cycles rarely.
    """
    gc.set_threshold(FEW_CYCLES)
    for name in VARIABLES:
        os.environ.setdefault(name, "1")
    sys.meta_path.insert(0, _NoBlasForNumba())


class _NoBlasForNumba:
    """Finds no SciPy for the module of numba that asks for its BLAS as it is loaded; everybody else finds it."""

    def find_spec(self, name: str, path: object = None, target: ModuleType | None = None) -> None:
        """Leave every module to the finders behind this one, save for that question."""
        asking = sys.modules.get("numba.np.arraymath") if name == "scipy.linalg" else None
        if asking is not None and not hasattr(asking, "_HAVE_BLAS"):
            raise ModuleNotFoundError("compiled loops of edmctl call no BLAS", name=name)
