"""`edmctl run compare`: what was different about runs, and whether their results differ beyond uncertainty."""

from __future__ import annotations

import math
from pathlib import Path

import h5py
import numpy as np
import pytest

from edmctl.cli.render.runs_tables import letter
from tests.cli.commands import Here


@pytest.fixture
def runs(run_file: Path, tmp_path: Path) -> tuple[Path, Path]:
    """Return two files of other recipes that may be changed: without the check sum behind their end."""
    one, two = tmp_path / "one.h5", tmp_path / "two.h5"
    for path in (one, two):
        with h5py.File(run_file) as old, h5py.File(path, "w") as new:
            new.attrs.update(old.attrs)
            old.copy("entry", new)
    with h5py.File(two, "r+") as file:
        file["/entry/seed"][...] = 5
        file["/entry/profile/values"].attrs["servo.reference"] = 0.78
    return one, two


def with_results(path: Path, **values: float) -> None:
    """Change the result of a run."""
    with h5py.File(path, "r+") as file:
        rows = file["/entry/results"][:]
        for name, value in values.items():
            rows[name] = value
        file["/entry/results"][...] = rows


def test_runs_differ_in_what_was_set_and_in_nothing_else(here: Here, runs: tuple[Path, Path]) -> None:
    said = here("run", "compare", *map(str, runs), "--json")
    assert said.exit_code == 0, said.err
    differs = {setting["key"]: setting["values"] for setting in said.document["result"]["differs"]}
    assert differs == {"servo.reference": ["0.8", "0.78"], "seed": ["3", "5"]}
    same = here("run", "compare", str(runs[0]), str(runs[0])).out
    assert "Nothing was set differently in A, B." in same
    assert "true depth (simulated), µm" in same
    assert " *" not in same.partition("\n± is")[0]


@pytest.mark.parametrize(("second_um", "beyond"), [(8.9, False), (9.1, True), (7.1, False), (6.9, True)])
def test_a_difference_counts_beyond_the_uncertainty_of_both(
    here: Here, runs: tuple[Path, Path], second_um: float, beyond: bool
) -> None:
    one, two = runs
    with_results(one, depth=8.0, depth_u95=0.6)
    with_results(two, depth=second_um, depth_u95=0.8)
    result = here("run", "compare", str(one), str(two), "--json").document["result"]
    (depth,) = (quantity for quantity in result["quantities"] if quantity["key"] == "depth_um")
    first, second = depth["amounts"]
    assert (first["value"], first["difference"], first["beyond"]) == (8.0, 0.0, False)
    assert second["difference"] == pytest.approx(second_um - 8.0)
    assert second["difference_u95"] == pytest.approx(math.hypot(0.6, 0.8))
    assert second["beyond"] is beyond
    lines = here("run", "compare", str(one), str(two)).out.splitlines()
    assert [line.endswith("*") for line in lines if line.startswith("depth,")] == [beyond]


def test_a_hole_through_a_sheet_has_no_depth_to_compare(here: Here, runs: tuple[Path, Path]) -> None:
    one, two = runs
    with_results(one, depth=8.0, depth_u95=0.1)
    with_results(two, through=1, depth=np.nan, depth_u95=np.nan)
    quantities = here("run", "compare", str(one), str(two), "--json").document["result"]["quantities"]
    found = {quantity["key"]: quantity for quantity in quantities}
    second = found["depth_um"]["amounts"][1]
    assert (second["value"], second["difference"], second["beyond"]) == (None, None, False)
    with h5py.File(two) as file:
        thickness_um, wear_um = file["/entry/sample/thickness"][()], file["/entry/results"]["wear"][0]
    assert found["wear_ratio_lin"]["amounts"][1]["value"] == pytest.approx(wear_um / thickness_um)
    assert found["mrr_mm3_min"]["amounts"][1]["u95"] is None
    both = here("run", "compare", str(two), str(two)).out.splitlines()
    assert not any(line.startswith("depth,") for line in both)


def test_the_table_names_runs_by_letters(here: Here, runs: tuple[Path, Path]) -> None:
    one, two = runs
    lines = here("run", "compare", str(one), str(two), str(one)).out.splitlines()
    assert [line.split()[:2] for line in lines[1:4]] == [["A", str(one)], ["B", str(two)], ["C", str(one)]]
    (header,) = (line for line in lines if line.startswith("result "))
    assert header.split("   ")[-1].strip() == "C − A"
    (depth,) = (line for line in lines if line.startswith("depth,"))
    assert depth.count("±") == 5
    assert [letter(number) for number in (0, 25, 26, 52)] == ["A", "Z", "A2", "A3"]


def test_numbers_are_grouped_and_what_is_unknown_is_a_dash(here: Here, runs: tuple[Path, Path]) -> None:
    one, two = runs
    with h5py.File(two, "r+") as file:
        file["/entry/seed"][...] = -1
        file["/entry/profile/values"].attrs["jump.height_um"] = 61.5
    with_results(two, pulses=1_981_705)
    out = here("run", "compare", str(one), str(two)).out.splitlines()
    (seed,) = (line for line in out if line.startswith("seed "))
    assert seed.split() == ["seed", "3", "–"]
    (height,) = (line for line in out if line.startswith("jump.height_um"))
    assert height.split()[0] == "jump.height_um"
    (pulses,) = (line for line in out if line.startswith("pulses "))
    assert "1 981 705" in pulses


@pytest.mark.slow
def test_the_figure_is_drawn_into_a_new_file_only(here: Here, runs: tuple[Path, Path]) -> None:
    figure = runs[0].parent / "both.svg"
    arguments = ("run", "compare", *map(str, runs), "--out", str(figure))
    said = here(*arguments)
    assert said.exit_code == 0, said.err
    assert said.out.rstrip().endswith(f"Figure {figure}")
    content = figure.read_bytes()
    assert b"tool wear" in content
    for options, code in ((arguments, "E9011"), ((*arguments[:-1], "both.gif"), "E2011")):
        assert here(*options, "--json").document["error"]["code"] == code
    assert figure.read_bytes() == content


@pytest.mark.parametrize(
    ("arguments", "exit_code", "code"),
    [
        (("one.h5",), 2, "E2073"),
        (("one.h5", "three.h5"), 9, "E9005"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    here: Here, runs: tuple[Path, Path], arguments: tuple[str, ...], exit_code: int, code: str
) -> None:
    said = here("run", "compare", *(str(runs[0].with_name(name)) for name in arguments), "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (exit_code, code)
