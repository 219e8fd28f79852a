"""What the reference circuits of docs/build-the-machine.md share: checks, what the firmware needs, tolerances.

Nothing of them was built. What is needed comes from the sources of the firmware and from the defaults of the
protocol, so a change there shows as a check that fails (tests/tools/test_build_the_machine.py).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import pi

from tools.generate.board_source import numbers
from tools.generate.schema import load_schema

KOHM, PF, NF, UF = 1e3, 1e-12, 1e-9, 1e-6
VDDA_V, VDDA_SPREAD = 3.3, 0.02
LOW_V, HIGH_SHARE = 0.8, 0.7
"""An input of the chip is low below the one, and high above this share of the supply."""
LEAKAGE_A = 1e-6
"""Of a pin that floats while the chip is in reset."""
INNER_PULL_OHM = (30 * KOHM, 50 * KOHM)
COMPARATOR_V = 5e-3
"""Offset of a comparator, without trimming."""
STRAY_F = 200 * PF
"""Of the gap and the wires to it."""
SAFE_V, SAFE_S = 60.0, 5.0
"""Touchable, and how long that may take after switching off (IEC 60204-1, 6.2.4)."""


@dataclass(frozen=True, slots=True)
class Check:
    """A line of the page: what it is about, what is needed, what the worst case reaches; `ok`: it holds."""

    what: str
    need: str
    reached: str
    ok: bool


@dataclass(frozen=True, slots=True)
class Circuit:
    """A reference circuit: its parts and its checks."""

    name: str
    parts: tuple[tuple[str, str], ...]
    checks: tuple[Check, ...]


@dataclass(frozen=True, slots=True)
class Needs:
    """Figures of the firmware and of the protocol that circuits have to meet."""

    scale: dict[str, float] = field(default_factory=lambda: numbers("board", "scale.h"))
    limits: dict[str, float] = field(default_factory=lambda: numbers("core", "limits.h"))
    measure: dict[str, float] = field(default_factory=lambda: numbers("board", "measure.c"))
    params: dict[str, float] = field(
        default_factory=lambda: {p.name: p.default for p in load_schema().params}
    )

    @property
    def settle_us(self) -> float:
        """After the gate has opened, until samples are taken for the open voltage."""
        return self.measure["SETTLE_COUNTS"]

    @property
    def top(self) -> float:
        """Count of a converter at full scale."""
        return self.scale["ADC_TOP"]


def parallel(*ohms: float) -> float:
    """Resistance of resistors side by side."""
    return 1.0 / sum(1.0 / ohm for ohm in ohms)


def corner_hz(ohm: float, farad: float) -> float:
    """Corner of a low-pass of the first order."""
    return 1.0 / (2.0 * pi * ohm * farad)


def within(value: float, wanted: float, share: float) -> bool:
    """Whether a value is the wanted one within a share of it."""
    return abs(value - wanted) <= share * abs(wanted)
