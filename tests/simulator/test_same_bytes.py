"""Plant and controller give the recorded bytes with other compilers and processors, in threads, under sanitizers."""

from __future__ import annotations

import ast
import os
import shlex
import struct
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from benchmarks.processors import OTHER
from edmctl.core import build
from edmctl.core.library import library
from edmctl.simulator import BenchConfig
from edmctl.simulator.plant import Plant
from tests.firmware.test_garbage import program
from tests.simulator.golden_core import SAMPLE, golden, session

ROOT = Path(__file__).parents[2]
FUSED = "-O2 -mfma -mavx2"
SANITIZED = "-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all -g -O1"
TICKS = "20000"
GCC, CLANG, ZIG = (pytest.mark.needs(name) for name in ("gcc", "clang", "ziglang"))


def has_fused() -> bool:
    """Whether this processor has fused multiply-add."""
    try:
        return {"fma", "avx2"} <= set(Path("/proc/cpuinfo").read_text(encoding="utf-8").split())
    except OSError:
        return False


def checked(compiler: str, flags: str, folder: Path, **environ: str) -> subprocess.CompletedProcess[str]:
    """Compare the golden digests with those of a library of that compiler, in a process of its own."""
    command = [sys.executable, "-m", "tests.simulator.golden_core", "--check", "--build", str(folder)]
    return subprocess.run(
        [*command, f"--flags={flags}"],
        cwd=ROOT,
        env={**os.environ, "CC": shlex.join(build.ZIG) if compiler == "zig" else compiler, **environ},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("compiler", "flags"),
    [
        *(pytest.param("gcc", flags, marks=GCC) for flags in ("", "-O1", FUSED)),
        *(pytest.param("clang", flags, marks=CLANG) for flags in ("", FUSED)),
        pytest.param("zig", "", marks=ZIG),
    ],
)
def test_every_compiler_gives_the_recorded_bytes(compiler: str, flags: str, tmp_path: Path) -> None:
    if FUSED in flags and not has_fused():
        pytest.skip("this processor has no fused multiply-add")
    done = checked(compiler, flags, tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


@GCC
@pytest.mark.slow
def test_a_processor_without_fused_multiply_add_gives_the_recorded_bytes(tmp_path: Path) -> None:
    """As far as numpy, OpenBLAS and the C library can be told that they are on one."""
    done = checked("gcc", "", tmp_path, **OTHER)
    assert done.returncode == 0, done.stdout + done.stderr


def sanitizers() -> dict[str, str]:
    """Return the environment of a process that loads a library with sanitizers."""
    asked = [f"-print-file-name=lib{name}.so" for name in ("asan", "ubsan")]
    found = [subprocess.run(["gcc", one], capture_output=True, text=True, check=True).stdout for one in asked]
    places = [place.strip() for place in found]
    if not all(Path(place).is_absolute() for place in places):
        pytest.skip("gcc has no sanitizers")
    return {"LD_PRELOAD": ":".join(places), "ASAN_OPTIONS": "detect_leaks=0"}


@pytest.mark.slow
def test_sanitizers_find_nothing_in_the_golden_sessions(tmp_path: Path) -> None:
    """Nor do they change a byte: sessions with every injection, random schedules, parameters of any value."""
    done = checked("gcc", SANITIZED, tmp_path, **sanitizers())
    assert (done.returncode, done.stderr) == (0, ""), done.stdout + done.stderr


def test_two_threads_give_the_recorded_bytes() -> None:
    """Calls release the interpreter's lock, and the library has no state of its own."""
    with ThreadPoolExecutor(2) as threads:
        digests = list(threads.map(session, SAMPLE[:2]))
    assert digests == [golden()["sessions"][name] for name in SAMPLE[:2]]


def saved_machine(file: Path) -> None:
    """Write the parts of a machine for plant_alone.c."""
    plant = Plant(BenchConfig(offset_um=5.0), seed=1)
    plant.stage_lands(0, 0.0)
    assert plant.in_c().unit
    records = (plant.unit, plant.state, plant.scope, plant.drive, plant.readings)
    random, levels = plant.random, plant.work_under_tool.levels
    rows = (*random.pulse, random.noise, *random.tables, *levels)
    parts = [*(bytes(record) for record in records), *(row.tobytes() for row in rows)]
    assert len(parts) == len(plant.in_c().pointers)
    file.write_bytes(b"".join(struct.pack("<q", len(part)) + part for part in parts))


def compiled(command: Sequence[str], made: Path) -> list[str]:
    folder = build.source_folder()
    sources = [path for part in ("plant", "math") for path in sorted((folder / part).glob("*.c"))]
    flags = ("-std=c11", "-O2", "-ffp-contract=off", "-fno-math-errno", f"-I{folder / 'plant'}")
    alone = Path(__file__).with_name("plant_alone.c")
    subprocess.run([*command, *flags, str(alone), *map(str, sources), "-o", str(made)], check=True)
    return [str(made)]


@ZIG
@pytest.mark.needs("qemu-aarch64")
@pytest.mark.slow
def test_an_arm_processor_gives_the_same_bytes(tmp_path: Path) -> None:
    """A cut of the plant, and random work of the controller, emulated; the digests are those of this processor.

    All golden sessions on such a processor, with its Python and numpy: benchmarks/arm_sessions.py.
    """
    arm = (*build.ZIG, "--target=aarch64-linux-musl")
    machine = tmp_path / "machine"
    saved_machine(machine)
    here = [*compiled(build.compiler(), tmp_path / "here"), str(machine), TICKS]
    there = ["qemu-aarch64", *compiled(arm, tmp_path / "there"), str(machine), TICKS]
    assert said_by(here) == said_by(there)
    hostile = program("hostile", "double", tmp_path)
    subprocess.run(hostile, check=True)
    crossed = [*arm, *hostile[len(build.compiler()) : -1], str(tmp_path / "hostile-arm")]
    subprocess.run(crossed, check=True)
    work = ["7", "20000", "2000"]
    assert said_by([hostile[-1], *work]) == said_by(["qemu-aarch64", crossed[-1], *work])


LOADER = """
#include <stdio.h>
#include <windows.h>
int main(int n, char **words) {
    HMODULE library = LoadLibraryA(words[1]);
    const char *(*sources)(void) = (void *)GetProcAddress(library, "edm_sources");
    double (*power)(double, double) = (void *)GetProcAddress(library, "edm_pow");
    printf("%s %a", sources(), power(1.7, n + 0.3));
    return 0;
}
"""


@ZIG
@pytest.mark.needs("wine")
@pytest.mark.full
def test_the_library_for_windows_loads_and_calculates(tmp_path: Path) -> None:
    """Under wine, in a program that is built with it: there is no Python for Windows here. It takes minutes."""
    windows = (*build.ZIG, "--target=x86_64-windows-gnu")
    made, source = tmp_path / "core.dll", tmp_path / "loader.c"
    build.compile_library(windows, made)
    source.write_text(LOADER)
    program = tmp_path / "loader.exe"
    subprocess.run([*windows, str(source), "-o", str(program)], check=True)
    environ = {**os.environ, "WINEPREFIX": str(tmp_path / "wine"), "WINEDEBUG": "-all"}
    done = subprocess.run(
        ["wine", str(program), str(made)], env=environ, capture_output=True, text=True, check=True
    )
    sources, power = done.stdout.split()
    assert sources == build.digest_of("double")
    assert float.fromhex(power) == library().pow(1.7, 2.3)


def said_by(command: list[str]) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


EXACT = {"inf", "nan", "pi", "sqrt", "isfinite", "isnan", "isinf", "fsum", "floor", "ceil", "hypot"}
INEXACT = {
    "exp",
    "expm1",
    "log",
    "log10",
    "log1p",
    "power",
    "cbrt",
    "sin",
    "cos",
    "tan",
    "tanh",
    "geomspace",
    "logspace",
}


def inexact(tree: ast.Module) -> Iterator[int]:
    """Yield the lines whose last digits depend on a C library, numpy's instructions or BLAS."""
    for node in ast.walk(tree):
        match node:
            case ast.Attribute(value=ast.Name(id="math"), attr=name) if name not in EXACT:
                yield node.lineno
            case ast.Attribute(value=ast.Name(id="np"), attr=name) if name in INEXACT or name in (
                "dot",
                "linalg",
            ):
                yield node.lineno
            case ast.BinOp(op=ast.MatMult()):
                yield node.lineno
            case ast.BinOp(op=ast.Pow(), right=right) if not (
                isinstance(right, ast.Constant) and isinstance(right.value, int)
            ):
                yield node.lineno


def test_the_virtual_machine_calculates_with_the_library() -> None:
    """`library().exp` and others have the same bytes everywhere."""
    sources = sorted((ROOT / "edmctl" / "simulator").glob("*.py"))
    found = {path.name: list(inexact(ast.parse(path.read_text(encoding="utf-8")))) for path in sources}
    assert {name: lines for name, lines in found.items() if lines} == {}


def test_inexact_functions_are_found() -> None:
    lines = "math.exp(x)\nnp.exp(x)\na @ b\nx ** 0.5\nmath.sqrt(x) + np.sum(a) + x ** 2\n"
    assert sorted(inexact(ast.parse(lines))) == [1, 2, 3, 4]
