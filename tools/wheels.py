"""Builds the wheels of all platforms on this computer: `python -m tools.wheels FOLDER [TARGET ...]`.

Needs the packages hatchling and ziglang.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from edmctl.core.build import ZIG
from edmctl.dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Target:
    """A platform that zig builds for: its name there, the ending of a library, the tag of a wheel."""

    zig: str
    suffix: str
    tag: str

    @property
    def command(self) -> tuple[str, ...]:
        """The compiler for this platform."""
        return (*ZIG, f"--target={self.zig}")


TARGETS = {
    "linux-x86_64": Target("x86_64-linux-gnu.2.17", ".so", "manylinux_2_17_x86_64.manylinux2014_x86_64"),
    "linux-aarch64": Target("aarch64-linux-gnu.2.17", ".so", "manylinux_2_17_aarch64.manylinux2014_aarch64"),
    "musl-x86_64": Target("x86_64-linux-musl", ".so", "musllinux_1_2_x86_64"),
    "macos-x86_64": Target("x86_64-macos.11.0", ".dylib", "macosx_11_0_x86_64"),
    "macos-arm64": Target("aarch64-macos.11.0", ".dylib", "macosx_11_0_arm64"),
    "windows-x86_64": Target("x86_64-windows-gnu", ".dll", "win_amd64"),
    "windows-arm64": Target("aarch64-windows-gnu", ".dll", "win_arm64"),
}
"""The platforms of the wheels."""


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
