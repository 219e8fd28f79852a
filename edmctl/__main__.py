"""Entry point: `edmctl` and `python -m edmctl`."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Run the command line. `--version` is answered before anything heavy loads.

    A worker process that runs the launcher anew, because that has no `if __name__ == "__main__":`, does nothing.
    """
    processes = sys.modules.get("multiprocessing.process")
    if processes is not None and processes.current_process().name != "MainProcess":
        return
    try:
        if sys.argv[1:] == ["--version"] and _says_version():
            return
        from edmctl.start_up import spare_start_up

        spare_start_up()
        from edmctl.app import run

        run()
    except KeyboardInterrupt:
        # Before run() handles signals: nothing moves then, and nobody wants a traceback.
        import signal

        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)


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
