"""`edmctl run compare`: what was different about runs, and whether their results differ beyond uncertainty."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from edmctl.app import main
from edmctl.cli.render.runs_tables import letter
from tests.cli.commands import SHALLOW, Here


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The files of two shallow holes with another servo reference and another seed."""
    folder = tmp_path_factory.mktemp("recorded")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EDMCTL_HOME", str(folder / "home"))
        patch.chdir(folder)
        for name, seed, reference in (("one", "4", "0.8"), ("two", "5", "0.78")):
            setting = f"servo.reference={reference}"
            options = ("--set", setting, "--seed", seed, "--run-id", name, "--quiet")
            assert main(("machine", *SHALLOW, *options)) == 0
    return folder / "runs" / "one.h5", folder / "runs" / "two.h5"


@pytest.fixture
def runs(recorded: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Path]:
    """Copies of them in a folder of their own."""
    one, two = (Path(shutil.copy(path, tmp_path / path.name)) for path in recorded)
    return one, two


def with_results(path: Path, **values: float) -> None:
    """Change the result of a run."""
    with h5py.File(path, "r+") as file:
        rows = file["/entry/results"][:]
        for name, value in values.items():
            rows[name] = value
        file["/entry/results"][...] = rows


@pytest.fixture
def unsealed_runs(runs: tuple[Path, Path]) -> tuple[Path, Path]:
    one, two = (unsealed(run, run.with_name(f"open-{run.name}")) for run in runs)
    return one, two


def unsealed(source: Path, target: Path) -> Path:
    """A copy that may be changed: without the check sum behind its end."""
    with h5py.File(source) as old, h5py.File(target, "w") as new:
        for name, value in old.attrs.items():
            new.attrs[name] = value
        old.copy("entry", new)
    return target


def test_runs_differ_in_what_was_set_and_in_nothing_else(here: Here, runs: tuple[Path, Path]) -> None:
    said = here("run", "compare", *map(str, runs), "--json")
    assert said.exit_code == 0, said.err
    differs = {setting["key"]: setting["values"] for setting in said.document["result"]["differs"]}
    set_apart = {"servo.reference": ["0.8", "0.78"], "machine": ["SIM-4", "SIM-5"], "seed": ["4", "5"]}
    follows = {"measure.expected_gap_um", "work.removal_um3_per_uj"}  # what the reference lets expect
    assert {key: values for key, values in differs.items() if key not in follows} == set_apart
    assert differs.keys() == set_apart.keys() | follows


@pytest.mark.parametrize(("second_um", "beyond"), [(8.9, False), (9.1, True), (7.1, False), (6.9, True)])
def test_a_difference_counts_beyond_the_uncertainty_of_both(
    here: Here, unsealed_runs: tuple[Path, Path], second_um: float, beyond: bool
) -> None:
    one, two = unsealed_runs
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


def test_a_hole_through_a_sheet_has_no_depth_to_compare(here: Here, unsealed_runs: tuple[Path, Path]) -> None:
    one, two = unsealed_runs
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


def test_numbers_are_grouped_and_what_is_unknown_is_a_dash(
    here: Here, unsealed_runs: tuple[Path, Path]
) -> None:
    one, two = unsealed_runs
    with h5py.File(two, "r+") as file:
        file["/entry/seed"][...] = -1
        file["/entry/profile/values"].attrs["jump.height_um"] = 61.5
    with_results(two, pulses=1_981_705)
    out = here("run", "compare", str(one), str(two)).out.splitlines()
    (seed,) = (line for line in out if line.startswith("seed "))
    assert seed.split() == ["seed", "4", "–"]
    (height,) = (line for line in out if line.startswith("jump.height_um"))
    assert height.split()[0] == "jump.height_um"
    (pulses,) = (line for line in out if line.startswith("pulses "))
    assert "1 981 705" in pulses


def test_runs_that_were_the_same_differ_in_nothing(here: Here, runs: tuple[Path, Path]) -> None:
    said = here("run", "compare", str(runs[0]), str(runs[0]))
    assert "Nothing was set differently in A, B." in said.out
    assert "true depth (simulated), µm" in said.out
    assert " *" not in said.out.partition("\n± is")[0]


@pytest.mark.slow
def test_the_figure_is_drawn_into_a_new_file_only(here: Here, runs: tuple[Path, Path]) -> None:
    figure = runs[0].parent / "both.svg"
    arguments = ("run", "compare", *map(str, runs), "--out", str(figure))
    said = here(*arguments)
    assert said.exit_code == 0, said.err
    assert said.out.rstrip().endswith(f"Figure {figure}")
    content = figure.read_bytes()
    assert b"tool wear" in content
    again = here(*arguments, "--json")
    assert (again.exit_code, again.document["error"]["code"]) == (9, "E9011")
    assert figure.read_bytes() == content


@pytest.mark.parametrize(
    ("arguments", "exit_code", "code"),
    [
        (("one.h5",), 2, "E2073"),
        (("one.h5", "two.h5", "--out", "both.gif"), 2, "E2011"),
        (("one.h5", "three.h5"), 9, "E9005"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    here: Here,
    runs: tuple[Path, Path],
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    exit_code: int,
    code: str,
) -> None:
    monkeypatch.chdir(runs[0].parent)
    said = here("run", "compare", *arguments, "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (exit_code, code)
