"""The front of removal rate against tool wear against roughness: recipes none of which beats another in all three.

    python -m benchmarks.pareto_front [--recipes 400] [--holes 40] [--seed 1] [--spread 0.03] [--json]

Random recipes of the 270 µm copper tool are forecast; those of the best forecasts are machined on the virtual
machine and judged by its truth: true volume over machining time, wear by volume, Ra of the floor. Exit code 1 where
fewer than ten of them are on the front, or not both polarities.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import edmctl
from benchmarks.process_trends import TRIED, Made, one_hole
from edmctl.errors import EdmWarning, ProfileError

if TYPE_CHECKING:
    from collections.abc import Sequence

LEAST_POINTS = 10
LEAST_MRR_UM3_S = 2000.0
"""What removes less is on the front merely by a tiny roughness, and nobody's recipe."""
DEPTH_UM = 25.0


@dataclass(frozen=True, slots=True)
class Point:
    """A recipe and what it comes to."""

    open_voltage_v: float
    current_a: float
    on_time_us: float
    off_time_us: float
    polarity: str
    mrr_um3_s: float
    theta: float
    ra_um: float

    def beats(self, other: Point) -> bool:
        """Whether it is no worse in any and better in one."""
        worse = self.mrr_um3_s < other.mrr_um3_s or self.theta > other.theta or self.ra_um > other.ra_um
        return not worse and self.figures != other.figures

    @property
    def figures(self) -> tuple[float, float, float]:
        """Removal, wear, roughness."""
        return self.mrr_um3_s, self.theta, self.ra_um


def front(points: Sequence[Point]) -> list[Point]:
    """Those that none beats, by removal."""
    kept = [one for one in points if not any(other.beats(one) for other in points)]
    return sorted(kept, key=lambda one: -one.mrr_um3_s)


def drawn(rng: random.Random) -> tuple[tuple[str, ...], Point]:
    """A recipe at its best reference, and the point without figures."""
    volts = rng.choice([40.0, 60.0, 80.0, 100.0])
    current_a = round(0.03 * (1.0 / 0.03) ** rng.random(), 3)
    on_us = round(10.0 * 30.0 ** rng.random(), 1)
    off_us = round(on_us * rng.uniform(0.3, 3.0) + 20.0, 1)
    polarity = rng.choice(["tool-negative", "tool-positive"])
    overrides = (
        f"pulse.open_voltage_v={volts:g}",
        f"pulse.current_a={current_a}",
        f"pulse.frequency_hz={1e6 / (on_us + off_us):.6f}",
        f"pulse.duty={on_us / (on_us + off_us):.6f}",
        f'pulse.polarity="{polarity}"',
        "adaptive.seek_reference=true",
        "servo.forward_um_s=20",
        "servo.back_um_s=20",
    )
    return (*TRIED, f"target.depth_um={DEPTH_UM:g}", *overrides), Point(
        volts, current_a, on_us, off_us, polarity, 0.0, 0.0, 0.0
    )


def forecast_point(recipe: tuple[str, ...], blank: Point) -> Point | None:
    """What the forecast says of a recipe; None where the rules refuse it."""
    try:
        ahead = edmctl.forecast("cu270", overrides=recipe)
    except ProfileError:
        return None
    mrr_um3_s = ahead.mrr_mm3_min * 1e9 / 60.0
    return Point(**{**asdict(blank), "mrr_um3_s": mrr_um3_s, "theta": ahead.wear_um, "ra_um": ahead.ra_um})


def made_point(blank: Point, made: Made) -> Point:
    """What the virtual machine made of it."""
    figures = {"mrr_um3_s": made.mrr_um3_s, "theta": made.theta, "ra_um": made.ra_um}
    return Point(**{**asdict(blank), **figures})


def attempted(case: tuple[tuple[str, ...], int]) -> Made | None:
    """The hole; None where its job ends without one."""
    try:
        return one_hole(("cu270", *case))
    except RuntimeError:
        return None


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recipes", type=int, default=400)
    parser.add_argument("--holes", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--spread", type=float, default=0.03)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    warnings.simplefilter("ignore", EdmWarning)
    rng = random.Random(given.seed)
    asked = [drawn(rng) for _ in range(given.recipes)]
    guesses = [(recipe, forecast_point(recipe, blank)) for recipe, blank in asked]
    known = [(recipe, point) for recipe, point in guesses if point and point.mrr_um3_s >= LEAST_MRR_UM3_S]
    chosen: list[tuple[tuple[str, ...], Point]] = []
    while known and len(chosen) < given.holes:  # the front, then the front of what is left
        best = front([point for _, point in known])
        on_front = sorted((one for one in known if one[1] in best), key=lambda one: one[1].theta)
        chosen += on_front[:: max(1, len(on_front) // (given.holes - len(chosen)))]
        known = [one for one in known if one[1] not in best]
    spread = f"sim.spread={given.spread:g}"
    with ProcessPoolExecutor() as pool:
        made = pool.map(attempted, [((*recipe, spread), given.seed) for recipe, _ in chosen[: given.holes]])
        points = [made_point(point, one) for (_, point), one in zip(chosen, made, strict=False) if one]
    kept = front([point for point in points if point.mrr_um3_s >= LEAST_MRR_UM3_S])
    if given.json:
        print(json.dumps([asdict(point) for point in kept]))
    else:
        print("open V  current A   on µs  off µs  polarity        removal µm³/s   wear  Ra µm")
        for one in kept:
            print(
                f"{one.open_voltage_v:6g}  {one.current_a:9.3f}  {one.on_time_us:6.1f}  {one.off_time_us:6.1f}  "
                f"{one.polarity:14}  {one.mrr_um3_s:13.0f}  {one.theta:5.3f}  {one.ra_um:5.3f}"
            )
    polarities = {one.polarity for one in kept}
    said = f"{len(kept)} of {len(points)} machined recipes on the front, {len(polarities)} polarities"
    print(f"{said}; bar {LEAST_POINTS}", file=sys.stderr)
    return int(len(kept) < LEAST_POINTS or len(polarities) < 2)


if __name__ == "__main__":
    sys.exit(main())
