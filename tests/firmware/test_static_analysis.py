"""What clang-tidy and cppcheck find in the sources by the chosen rules: nothing."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.needs import program

FIRMWARE = Path(__file__).parents[2] / "firmware"
PARTS = ("core", "math", "board", "plant", "operators", "host")
SOURCES = sorted(str(path) for part in PARTS for path in FIRMWARE.glob(f"{part}/*.c"))
REALS = ("-DEDM_REAL_DOUBLE", "-UEDM_REAL_DOUBLE")

pytestmark = [pytest.mark.slow, pytest.mark.needs("clang-tidy", "cppcheck")]


def said_by(name: str, *arguments: str) -> str:
    done = subprocess.run(
        [program(name) or name, *arguments], capture_output=True, encoding="utf-8", check=False
    )
    return f"{done.stdout}{done.stderr}" if done.returncode else ""


def test_clang_tidy_finds_nothing() -> None:
    """In a board's arithmetic; the other differs in a type."""
    assert SOURCES
    options = ("-std=c11", f"-I{FIRMWARE}", f"-I{FIRMWARE / 'core'}")
    assert said_by("clang-tidy", "--quiet", *SOURCES, "--", *options) == ""


@pytest.mark.parametrize("real", REALS)
def test_cppcheck_finds_nothing(real: str) -> None:
    rules = "--enable=warning,style,performance,portability"
    said = said_by(
        "cppcheck",
        "--quiet",
        "--std=c11",
        rules,
        "--inline-suppr",
        "--suppress=missingIncludeSystem",
        "--error-exitcode=1",
        real,
        f"-I{FIRMWARE}",
        f"-I{FIRMWARE / 'core'}",
        *SOURCES,
    )
    assert said == ""


def test_the_rules_are_not_empty(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.c"
    wrong.write_text(
        "int f(int i) { int a[2] = {0}; if (i == 1) { a[2] = i; } return a[0]; }\n", encoding="utf-8"
    )
    config = f"--config-file={FIRMWARE / '.clang-tidy'}"
    assert "clang-analyzer" in said_by("clang-tidy", "--quiet", config, str(wrong), "--", "-std=c11")
    cppcheck = ("--quiet", "--error-exitcode=1", str(wrong))
    assert "arrayIndexOutOfBounds" in said_by("cppcheck", *cppcheck)
