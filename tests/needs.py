"""What a test needs beyond the extra `test`: packages of other extras, and programs.

`@pytest.mark.needs("unicorn", "ziglang")` skips the test where one of them is missing. EDMCTL_REQUIRE_EXTRAS=1,
which the gate sets, makes the skip a failure. Programs that no extra installs may always be missing.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

VARIABLE = "EDMCTL_REQUIRE_EXTRAS"
EXTRAS = {
    "clang-tidy": "emulator",
    "cppcheck": "emulator",
    "hatchling": "emulator",
    "distributed": "interop",
    "nexusformat": "interop",
    "optuna": "interop",
    "pyarrow": "interop",
    "ruff": "lint",
    "silx": "interop",
    "unicorn": "emulator",
    "xarray": "interop",
    "ziglang": "emulator",
}
"""Extra of pyproject.toml that installs a package or program."""
PROGRAMS = ("clang-tidy", "cppcheck")
EMULATOR = pytest.mark.needs("unicorn", "ziglang")
BOARD_COMPILERS = [
    pytest.param("gcc", marks=pytest.mark.needs("arm-none-eabi-gcc")),
    pytest.param("zig", marks=pytest.mark.needs("ziglang")),
]
"""Compilers of a board's image, as values of a parametrised test."""


def program(name: str) -> str | None:
    """Return the path of a program: beside Python, or on the path."""
    return shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)


def skip_without(names: Sequence[str]) -> None:
    """Skip the test without one of these packages or programs, or fail where extras are required."""
    for name in names:
        is_package = name in EXTRAS and name not in PROGRAMS
        if (importlib.util.find_spec(name) if is_package else program(name)) is not None:
            continue
        if name not in EXTRAS:
            pytest.skip(f"needs {name}")
        reason = f'needs {name}: pip install -e ".[{EXTRAS[name]}]"'
        if os.environ.get(VARIABLE) == "1":
            pytest.fail(f"{reason} ({VARIABLE}=1)", pytrace=False)
        pytest.skip(reason)


def build_with_sanitizers(command: Sequence[str]) -> None:
    """Build a program with AddressSanitizer; the test is skipped with zig, which has none."""
    if "ziglang" in command:
        pytest.skip("zig has no AddressSanitizer")
    subprocess.run(command, check=True, capture_output=True)
