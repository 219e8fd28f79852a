"""What builds, runs and examines the firmware: a test that needs it is skipped where it is missing.

EDMCTL_REQUIRE_FIRMWARE=1 turns the skip into a failure, for all that `pip install -e ".[emulator]"` brings (the
compiler zig, unicorn, clang-tidy, cppcheck), and for sanitizers where the system has a C compiler. GCC for ARM,
which no package brings, stays a skip.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import pytest

from edmctl.errors import PreconditionError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import TypeVar

    _T = TypeVar("_T")

VARIABLE = "EDMCTL_REQUIRE_FIRMWARE"
NO_COMPILER = "E8093"
ARM_GCC = "arm-none-eabi-gcc"


def missing(what: str) -> NoReturn:
    """Skip the test, or fail it where the firmware is required."""
    if os.environ.get(VARIABLE) == "1":
        pytest.fail(f"{what}, and {VARIABLE}=1 asks for it", pytrace=False)
    pytest.skip(what)


def built_here(build: Callable[[], _T]) -> _T:
    """Return what is built; without a compiler the test is skipped."""
    try:
        return build()
    except PreconditionError as error:
        if error.code == NO_COMPILER:
            missing(error.message)
        raise


def need_package(name: str) -> None:
    """Go on where a package is installed."""
    if importlib.util.find_spec(name) is None:
        missing(f"the package {name} is not installed")


def need_board_compiler(name: str) -> None:
    """Go on where a compiler of images is: `zig`, or `gcc`, which may be missing whatever is required."""
    if name == "zig":
        need_package("ziglang")
    elif shutil.which(ARM_GCC) is None:
        pytest.skip(f"there is no {ARM_GCC}")


def program(name: str) -> str:
    """Where a program of the extra `test` is: beside Python, or else on the path."""
    found = shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name)
    if found is None:
        missing(f"{name} is not installed")
    return found


def build_with_sanitizers(command: Sequence[str]) -> None:
    """Build a program with AddressSanitizer; zig, the compiler of whoever has no other one, has none."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        if "ziglang" in command:
            pytest.skip("zig has no AddressSanitizer")
        missing(f"{command[0]} builds nothing with sanitizers: {done.stderr[-300:]}")
