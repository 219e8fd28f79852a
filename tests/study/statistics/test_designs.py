"""Designs are what tables of the literature say, and balanced."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from edmctl.study.statistics.designs import (
    array_for,
    arrays,
    box_behnken,
    central_composite,
    fraction_for,
    fraction_of,
    hiding_words,
    latin_hypercube,
    letters_of,
    sobol_points,
)


def unbalanced_pairs(levels: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of columns in which some pair of levels is more frequent than another."""
    found = []
    for one, other in itertools.combinations(range(levels.shape[1]), 2):
        wide, high = int(levels[:, other].max()) + 1, int(levels[:, one].max()) + 1
        seen = np.bincount(levels[:, one] * wide + levels[:, other], minlength=high * wide)
        if len(set(seen.tolist())) > 1:
            found.append((one, other))
    return found


@pytest.mark.parametrize("name", arrays())
def test_every_array_is_what_its_name_says_and_pairwise_balanced(name: str) -> None:
    levels = arrays()[name].levels
    runs, columns = name.split(" ", 1)
    promised = [
        int(n) for part in columns.strip("()").split() for n in [part.split("^")[0]] * int(part.split("^")[1])
    ]
    assert len(levels) == int(runs[1:])
    assert list(arrays()[name].counts) == promised
    assert unbalanced_pairs(levels) == []
    assert len(np.unique(levels, axis=0)) == len(levels)


@pytest.mark.parametrize(
    ("name", "row", "levels"),
    [  # rows of Taguchi's tables, numbered from 1
        ("L8 (2^7)", 3, "1221122"),
        ("L9 (3^4)", 5, "2231"),
        ("L12 (2^11)", 4, "12122122112"),
        ("L16 (2^15)", 6, "122112222112211"),
        ("L18 (2^1 3^7)", 8, "13232131"),
        ("L25 (5^6)", 8, "234512"),
        ("L27 (3^13)", 5, "1222222333111"),
        ("L36 (2^11 3^12)", 25, "21122212211132123313122"),
    ],
)
def test_column_numbers_of_papers_hold(name: str, row: int, levels: str) -> None:
    assert "".join(str(level + 1) for level in arrays()[name].levels[row - 1]) == levels


@pytest.mark.parametrize(
    ("counts", "wanted", "name", "columns"),
    [
        ([3, 3, 3], None, "L9 (3^4)", (0, 1, 2)),
        ([3, 2, 3], None, "L18 (2^1 3^7)", (1, 0, 2)),
        ([6, 3, 3], None, "L18 (6^1 3^6)", (0, 1, 2)),
        ([2, 4], None, "L8 (4^1 2^4)", (1, 0)),
        ([3] * 4, "L27", "L27 (3^13)", (0, 1, 2, 3)),
        ([2] * 8, None, "L12 (2^11)", tuple(range(8))),
        ([5, 5], None, "L25 (5^6)", (0, 1)),
    ],
)
def test_the_smallest_array_that_holds_the_factors(
    counts: list[int], wanted: str | None, name: str, columns: tuple[int, ...]
) -> None:
    found, chosen = array_for(counts, wanted)
    assert (found.name, chosen) == (name, columns)
    assert [found.counts[column] for column in chosen] == counts


def test_an_array_that_cannot_be_is_refused_with_what_was_asked() -> None:
    with pytest.raises(ValueError, match="L9 has no columns for these factors by their levels: 5 of 3"):
        array_for([3] * 5, "L9")
    with pytest.raises(ValueError, match=r"There is no array L10; there are L4 \(2\^3\), L8"):
        array_for([3], "L10")


@pytest.mark.parametrize(("factors", "runs"), [(3, 12), (4, 24), (5, 40), (6, 48), (7, 56)])
def test_box_behnken_has_the_published_runs_and_estimates_its_surface(factors: int, runs: int) -> None:
    coded = box_behnken(factors)
    assert coded.shape == (runs, factors)
    assert len(np.unique(coded, axis=0)) == runs
    assert np.abs(coded).sum(axis=1).max() == np.abs(coded).sum(axis=1).min()  # no corner, no axis
    products = [coded[:, a] * coded[:, b] for a, b in itertools.combinations(range(factors), 2)]
    linear = np.column_stack([coded, *products])
    assert np.allclose(linear.T @ linear, np.diag(np.diag(linear.T @ linear)))
    with_centre = np.vstack([coded, np.zeros(factors)])
    pairs = [with_centre[:, a] * with_centre[:, b] for a, b in itertools.combinations(range(factors), 2)]
    surface = np.column_stack([np.ones(runs + 1), with_centre, with_centre**2, *pairs])
    assert np.linalg.matrix_rank(surface) == surface.shape[1]


@pytest.mark.parametrize(("alpha", "reach"), [("face", 1.0), ("rotatable", 2**0.5), (1.2, 1.2)])
def test_a_central_composite_design_stays_within_its_bounds(alpha: float | str, reach: float) -> None:
    coded = central_composite(2, alpha)
    assert coded.shape == (8, 2)
    assert np.abs(coded).max() == pytest.approx(1)
    assert np.abs(coded[:4]) == pytest.approx(1 / reach)


def test_a_central_composite_design_of_many_factors_has_a_fraction_for_a_cube() -> None:
    assert len(central_composite(5)) == 16 + 10
    assert len(central_composite(8)) == 64 + 16


@pytest.mark.parametrize(
    ("factors", "resolution", "runs", "reached"),
    [
        (3, 3, 4, 3),
        (4, 4, 8, 4),
        (5, 5, 16, 5),
        (7, 3, 8, 3),
        (7, 4, 16, 4),
        (8, 5, 64, 5),
        (11, 4, 32, 4),
        (3, 5, 8, None),
    ],
)
def test_the_smallest_fraction_of_a_resolution(
    factors: int, resolution: int, runs: int, reached: int | None
) -> None:
    found = fraction_for(factors, resolution)
    assert (found.runs, found.resolution) == (runs, reached)
    coded = found.coded()
    assert np.allclose(coded.T @ coded, runs * np.eye(factors))


def test_aliases_of_the_textbook_fraction() -> None:
    # Box, Hunter and Hunter: 2^(4-1) with D = ABC has I = ABCD, AB + CD, AC + BD, AD + BC.
    found = fraction_of(4, ["D = ABC"])
    assert [letters_of(word) for word in found.defining_words()] == ["ABCD"]
    told = {"+".join(letters_of(word) for word, _ in group) for group in found.aliases()}
    assert told == {"AB+CD", "AC+BD", "AD+BC"}


@pytest.mark.parametrize("generators", [["E=ABC", "F=-BCD"], ["D=-AB", "E=AC", "F=BC"]])
def test_aliases_are_columns_that_are_equal_or_opposite(generators: list[str]) -> None:
    found = fraction_of(6, generators)
    coded = found.coded()
    told = {}
    for group in found.aliases():
        for (one, s), (other, t) in itertools.combinations(group, 2):
            told[one, other] = s * t
    effects = [frozenset(word) for size in (1, 2) for word in itertools.combinations(range(6), size)]
    for one, other in itertools.combinations(effects, 2):
        product = coded[:, sorted(one)].prod(axis=1) @ coded[:, sorted(other)].prod(axis=1) / len(coded)
        sign = told.get((one, other), told.get((other, one), 0))
        assert product == pytest.approx(sign), (letters_of(one), letters_of(other))


@pytest.mark.parametrize(
    ("generators", "said"),
    [
        (["D=ABX"], "is no generator"),
        (["D=A"], "is no generator"),
        (["D=ABC", "D=AB"], "D has two generators"),
        (["D=ABC", "E=AD"], "The generator of E uses D"),
    ],
)
def test_a_generator_that_is_none(generators: list[str], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        fraction_of(5, generators)


def test_samples_of_a_space() -> None:
    square = latin_hypercube(3, 10, seed=4)
    assert np.sort(((square + 1) * 5).astype(int), axis=0).tolist() == [[n] * 3 for n in range(10)]
    assert np.array_equal(square, latin_hypercube(3, 10, seed=4))
    assert np.array_equal(sobol_points(2, 5, seed=1), sobol_points(2, 16, seed=1)[:5])
    assert np.abs(sobol_points(2, 16, seed=1)).max() <= 1


@pytest.mark.parametrize(
    ("factors", "count", "least"), [(3, 1, 3), (3, 2, 2), (4, 2, 2), (5, 2, 3), (6, 3, 3)]
)
def test_blocks_hide_the_longest_products(factors: int, count: int, least: int) -> None:
    """Box, Hunter and Hunter, table 5B.1: none hides a main effect."""
    hidden = [frozenset[int]()]
    for word in hiding_words(factors, count):
        hidden += [known ^ word for known in hidden]
    assert len(hidden) == 2**count
    assert min(map(len, hidden[1:])) == least
    assert hiding_words(2, 2) == ()
