"""Elementary functions of the library: exact to a few units in the last place, the same bits with every compiler."""

from __future__ import annotations

import ctypes
import hashlib
import math
import struct
import subprocess
from collections.abc import Callable, Iterator
from decimal import Decimal, localcontext
from pathlib import Path
from random import Random

import pytest

from edmctl.core import build
from edmctl.core.library import library

RANGES = {
    "exp": (-700.0, 700.0),
    "expm1": (-3.0, 3.0),
    "log": (1e-9, 5.0),
    "log1p": (-0.9, 5.0),
    "sin": (-100.0, 100.0),
    "cos": (-100.0, 100.0),
    "sinh": (-3.0, 3.0),
    "cosh": (-3.0, 3.0),
    "atanh": (-0.99, 0.99),
    "atan": (-10.0, 10.0),
}
EXACT: dict[str, Callable[[Decimal], Decimal]] = {
    "exp": lambda x: x.exp(),
    "expm1": lambda x: x.exp() - 1,
    "log": lambda x: x.ln(),
    "log1p": lambda x: (1 + x).ln(),
    "sinh": lambda x: (x.exp() - (-x).exp()) / 2,
    "cosh": lambda x: (x.exp() + (-x).exp()) / 2,
    "atanh": lambda x: ((1 + x) / (1 - x)).ln() / 2,
}


def function(of: ctypes.CDLL, name: str) -> Callable[..., float]:
    found = getattr(of, f"edm_{name}")
    found.restype = ctypes.c_double
    found.argtypes = [ctypes.c_double] * (2 if name == "pow" else 1)
    return found  # type: ignore[no-any-return]


def arguments(name: str, count: int) -> Iterator[float]:
    random, (low, high) = Random(name), RANGES[name]
    for k in range(count):
        yield random.uniform(low, high) if k % 2 or name == "log" else random.uniform(low, high) * 1e-6


@pytest.mark.parametrize("name", EXACT)
def test_a_function_is_exact_to_four_units_in_the_last_place(name: str) -> None:
    compiled = function(library().loaded, name)
    with localcontext() as context:
        context.prec = 40
        for x in arguments(name, 2000):
            exact = EXACT[name](Decimal(x))
            assert abs(Decimal(compiled(x)) - exact) <= 4 * Decimal(math.ulp(float(exact))), x


@pytest.mark.parametrize("name", ["sin", "cos", "atan"])
def test_angles_agree_with_the_c_library(name: str) -> None:
    compiled, known = function(library().loaded, name), getattr(math, name)
    for x in arguments(name, 2000):
        assert compiled(x) == pytest.approx(known(x), rel=1e-15, abs=3e-16), x


def test_powers_are_exact_to_1e_13() -> None:
    compiled, random = function(library().loaded, "pow"), Random(1)
    for _ in range(2000):
        x, y = random.uniform(0.0, 0.6), random.uniform(0.0, 30.0)
        assert compiled(x, y) == pytest.approx(math.pow(x, y), rel=1e-13)


@pytest.mark.parametrize(
    ("name", "x", "value"),
    [
        ("exp", 0.0, 1.0),
        ("exp", 710.0, math.inf),
        ("exp", -746.0, 0.0),
        ("exp", math.inf, math.inf),
        ("exp", -math.inf, 0.0),
        ("exp", math.nan, math.nan),
        ("expm1", -800.0, -1.0),
        ("log", 0.0, -math.inf),
        ("log", -1.0, math.nan),
        ("log", math.inf, math.inf),
        ("log1p", -1.0, -math.inf),
        ("atan", math.inf, math.pi / 2.0),
        ("sin", 1e300, math.nan),
        ("cos", -math.inf, math.nan),
    ],
)
def test_values_at_the_ends(name: str, x: float, value: float) -> None:
    assert function(library().loaded, name)(x) == pytest.approx(value, nan_ok=True)


@pytest.mark.parametrize("x", [0.0, 0.5, 1.0, 2.0, math.inf, math.nan])
@pytest.mark.parametrize("y", [-math.inf, -2.0, 0.0, 2.0, math.inf, math.nan])
def test_powers_at_the_ends(x: float, y: float) -> None:
    known = math.inf if x == 0.0 and y < 0.0 else math.pow(x, y)
    assert function(library().loaded, "pow")(x, y) == pytest.approx(known, nan_ok=True)


def digest(of: ctypes.CDLL) -> str:
    found = hashlib.sha256()
    for name in RANGES:
        compiled = function(of, name)
        for x in arguments(name, 1000):
            found.update(struct.pack("<d", compiled(x)))
    return found.hexdigest()[:16]


@pytest.mark.parametrize(
    "compiler", ["cc", "gcc -O1", "gcc -mfma -O3", pytest.param("zig", marks=pytest.mark.needs("ziglang"))]
)
def test_every_compiler_gives_the_same_bits(compiler: str, tmp_path: Path) -> None:
    """FMA instructions are allowed, but with -ffp-contract=off no sum is made of them."""
    first, *rest = compiler.split()
    command = build.ZIG if first == "zig" else (*build.compiler(), *rest)
    made = tmp_path / f"elementary{build.SUFFIX}"
    source = build.source_folder() / "math" / "elementary.c"
    flags = ("-std=c11", "-ffp-contract=off", "-fPIC", "-shared")
    subprocess.run([*command, *flags, str(source), "-o", str(made)], check=True)
    assert digest(ctypes.CDLL(str(made))) == digest(library().loaded)
