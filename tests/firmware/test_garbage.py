"""Senseless bytes, frames and readings under sanitizers: no command out of noise, no undefined behaviour."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from edmctl.core.build import REALS, compiler, source_folder
from tests.needs import build_with_sanitizers
from tests.tiers import tiers

PROGRAMS = Path(__file__).parent
PARTS = ("core", "gen", "math")
SANITIZERS = "-fsanitize=address,undefined,float-cast-overflow"


def program(name: str, real: str, folder: Path, *flags: str) -> list[str]:
    """Return the command that builds a program over the core, and its path as the last word."""
    source = source_folder()
    parts = [str(path) for part in PARTS for path in sorted((source / part).glob("*.c"))]
    kind = ["-DEDM_REAL_DOUBLE"] if real == "double" else []
    include = [f"-I{source / 'core'}", f"-I{source / 'gen'}"]
    warn = ["-std=c11", "-O1", "-g", "-ffp-contract=off", "-fno-math-errno"]
    return [
        *compiler(),
        *warn,
        *kind,
        *flags,
        *include,
        str(PROGRAMS / f"{name}.c"),
        *parts,
        "-o",
        str(folder / name),
    ]


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("megabytes", tiers(slow=(1,), full=(20,)))
def test_garbage_is_no_command_and_does_no_harm(real: str, megabytes: int, tmp_path: Path) -> None:
    command = program("garbage", real, tmp_path, SANITIZERS, "-fno-sanitize-recover=all")
    build_with_sanitizers(command)
    done = subprocess.run([command[-1], "1", str(megabytes)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"{megabytes << 20} bytes of garbage" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("real", REALS)
def test_the_sources_compile_without_a_warning(real: str, tmp_path: Path) -> None:
    folder, parts = source_folder(), (*PARTS, "host", "plant", "operators")
    flags = ["-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Werror"]
    for path in sorted(path for part in parts for path in (folder / part).glob("*.c")):
        kind = ["-DEDM_REAL_DOUBLE"] if real == "double" else []
        include = [f"-I{folder / 'core'}", f"-I{folder / 'gen'}"]
        command = [*compiler(), "-std=c11", "-O2", *flags, *kind, *include, "-c", str(path)]
        done = subprocess.run(
            [*command, "-o", str(tmp_path / "part.o")], capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, "")
