"""Builds the wheels of all platforms on this computer: `python -m tools.wheels FOLDER [TARGET ...]`.

Needs the packages hatchling and ziglang.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from edmctl.core.build import TARGETS


def main(arguments: list[str]) -> int:
    """Build; return the exit code."""
    if not arguments or arguments[0].startswith("-") or not set(arguments[1:]) <= TARGETS.keys():
        sys.stderr.write(
            f"usage: python -m tools.wheels FOLDER [TARGET ...]\ntargets: {', '.join(TARGETS)}\n"
        )
        return 2
    folder = Path(arguments[0]).resolve()
    for target in arguments[1:] or TARGETS:
        command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
        environ = {**os.environ, "EDMCTL_TARGET": target}
        subprocess.run(command, cwd=Path(__file__).parents[1], check=True, env=environ)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
