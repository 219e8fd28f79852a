"""Designs for response surfaces and for sampling a space: settings coded to −1 … 1, (runs, factors).

Centre runs are not in them: how many there are, and where in the order, is the study's business.
"""

from __future__ import annotations

import itertools
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from edmctl.study.statistics.fractional import fraction_for

Coded = NDArray[np.float64]

BOX_BEHNKEN = {
    3: ("12", "13", "23"),
    4: ("12", "34", "14", "23", "13", "24"),
    5: ("12", "34", "25", "13", "45", "23", "14", "35", "24", "15"),
    6: ("124", "235", "346", "145", "256", "136"),
    7: ("456", "167", "257", "124", "347", "135", "236"),
}
"""Factors that vary together in each block of runs (Box and Behnken, Technometrics 2, 1960, table 4)."""


def box_behnken(factors: int) -> Coded:
    """Return the Box-Behnken design without centre runs: 12, 24, 40, 48 or 56 runs of 3 to 7 factors.

    Raises ValueError for another number of factors.
    """
    if factors not in BOX_BEHNKEN:
        raise ValueError(f"A Box-Behnken design has 3 to 7 factors, not {factors}.")
    runs = []
    for block in BOX_BEHNKEN[factors]:
        together = [int(digit) - 1 for digit in block]
        settings = np.zeros((2 ** len(together), factors))
        settings[:, together] = list(itertools.product((-1.0, 1.0), repeat=len(together)))
        runs.append(settings)
    return np.vstack(runs)


def central_composite(factors: int, alpha: float | str = "face") -> Coded:
    """Return a central composite design without centre runs: the cube, then the axial points at ± `alpha`.

    The cube is the smallest fraction of resolution 5. `alpha` is a distance, `face` (1) or `rotatable` (fourth root
    of the runs of the cube); where it is beyond 1 everything is scaled so that the axial points are at ± 1: bounds
    of a factor are bounds of what is run. Raises ValueError below two factors or for an alpha that is none.
    """
    if factors < 2:
        raise ValueError("A central composite design has at least 2 factors.")
    cube = fraction_for(factors, 5).coded()
    if alpha == "face":
        distance = 1.0
    elif alpha == "rotatable":
        distance = len(cube) ** 0.25
    elif not isinstance(alpha, str) and 0 < alpha < 10:
        distance = float(alpha)
    else:
        raise ValueError(f"alpha is face, rotatable or a distance up to 10, not {alpha!r}.")
    axial = np.repeat(np.eye(factors), 2, axis=0) * np.tile([-distance, distance], factors)[:, None]
    return np.vstack([cube, axial]) / max(1.0, distance)


MOST_IMPROVED = 200
"""Runs of a Latin hypercube that swaps improve: of more, chance alone fills the space, and swaps take long."""


def latin_hypercube(factors: int, runs: int, seed: int) -> Coded:
    """Return a Latin hypercube: a run in each of `runs` equal slices of each factor, of low centred discrepancy."""
    from scipy.stats import qmc

    way: Literal["random-cd"] | None = "random-cd" if runs <= MOST_IMPROVED else None
    made = qmc.LatinHypercube(factors, optimization=way, rng=np.random.default_rng(seed)).random(runs)
    return np.asarray(made) * 2 - 1


def sobol_points(factors: int, runs: int, seed: int) -> Coded:
    """Return the first points of a scrambled Sobol sequence; a longer one begins with those of a shorter one."""
    from scipy.stats import qmc

    whole = (max(runs, 1) - 1).bit_length()
    made = qmc.Sobol(factors, scramble=True, rng=np.random.default_rng(seed)).random_base2(whole)
    return np.asarray(made[:runs]) * 2 - 1
