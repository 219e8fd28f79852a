"""Entry point: `edmctl` and `python -m edmctl`."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line. `--version` is answered before anything heavy loads."""
    if sys.argv[1:] == ["--version"]:
        from edmctl import __version__

        sys.stdout.write(f"edmctl {__version__}\n")
        return
    try:
        from edmctl.cli.app import run

        run()
    except KeyboardInterrupt:
        # Before run() handles signals, and after: nothing moves then, and nobody wants a traceback.
        sys.exit(130)


if __name__ == "__main__":
    main()
