"""Entry point: `edmctl` and `python -m edmctl`."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import ModuleType


def main() -> None:
    """Run the command line. `--version` is answered before anything heavy loads."""
    try:
        if sys.argv[1:] == ["--version"] and _says_version():
            return
        spare_start_up()
        from edmctl.cli.app import run

        run()
    except KeyboardInterrupt:
        # Before run() handles signals: nothing moves then, and nobody wants a traceback.
        import signal

        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)


def spare_start_up() -> None:
    """Spare a process of the command line what it never uses; a program that imports edmctl has it all.

    BLAS keeps to one thread: matrices are small, and threads would only wait for each other, on busy cores 40 ms at
    a time. Numba is told that there is no BLAS, which no compiled loop calls: looking for it takes 0.2 s.
    """
    for library in ("OPENBLAS", "MKL", "OMP"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    sys.meta_path.insert(0, _NoBlasForNumba())


class _NoBlasForNumba:
    """Finds no SciPy for the module of numba that asks for its BLAS as it is loaded; everybody else finds it."""

    def find_spec(self, name: str, path: object = None, target: ModuleType | None = None) -> None:
        """Leave every module to the finders behind this one, save for that question."""
        asking = sys.modules.get("numba.np.arraymath") if name == "scipy.linalg" else None
        if asking is not None and not hasattr(asking, "_HAVE_BLAS"):
            raise ModuleNotFoundError("compiled loops of edmctl call no BLAS", name=name)


def _says_version() -> bool:
    """Write the version; False where stdout takes none, which `run` knows how to report."""
    from edmctl.version import __version__

    try:
        sys.stdout.write(f"edmctl {__version__}\n")
        sys.stdout.flush()
    except (AttributeError, OSError):
        return False
    return True


if __name__ == "__main__":
    main()
