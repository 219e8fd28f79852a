"""`edmctl run …` of runs that are no finished job: what they wanted, what they found, how deep they got."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from edmctl.record.rows import Summary, profile_leaves
from tests.cli.commands import Here
from tests.cli.run_files import killed
from tests.record.samples import PROFILE, a_meta, finished, slow_row

DEEP = {"target": {"kind": "depth", "depth_um": 180.0, "tolerance_um": 2.0}}
PROCEDURES: dict[tuple[str, ...], str] = {
    ("measure-wear", "--reference"): "wear reference",
    ("approach", "--contact"): "contact touch",
}
WEAR = {"z2_um": 61.3, "wear_um": 3.468, "wear_u95_um": 0.991, "depth_um": 7.951, "depth_u95_um": 0.42}


def made(folder: Path, run_id: str, *command: str, found: Mapping[str, object] | None = None) -> Path:
    """The file of a run of `command` that found something, or left a hole."""
    leaves = profile_leaves({**PROFILE, **DEEP, "jump": {"height_um": 60.0, "period_s": 10.0}})
    procedure = PROCEDURES.get(command, command[0])
    meta = replace(
        a_meta(), run_id=run_id, command=("edmctl", *command), procedure=procedure, profile_leaves=leaves
    )
    path = folder / f"{run_id}.h5"
    if found is not None:
        return finished(path, Summary(json.dumps(found)), meta=meta)
    row = replace(slow_row(120), depth_um=153.06, wear_um=40.0, depth_u95_um=6.5)
    return finished(path, row, meta=meta, end=("machine fault", 6))


@pytest.mark.parametrize(
    ("command", "wanted"),
    [
        (("machine",), "wanted was a depth of 180 ± 2 µm"),
        (("measure-wear",), "wanted was to measure wear"),
        (("measure-wear", "--reference"), "wanted was to touch the pad"),
        (("approach",), "wanted was to find the spark gap"),
        (("approach", "--contact"), "wanted was to find the surface"),
        (("jump-flush", "-n", "4"), "wanted was to jump 60 µm every 10 s"),
    ],
)
def test_what_was_wanted_is_said_by_the_command(
    here: Here, tmp_path: Path, command: tuple[str, ...], wanted: str
) -> None:
    path = made(tmp_path, "a", *command, found={"touches": 3})
    assert wanted in " ".join(here("run", "show", str(path)).out.split())
    explained = here("run", "explain", str(path)).out
    assert wanted in " ".join(explained.split())
    assert ("Found: touches 3." in explained) is (command != ("machine",))


def test_what_was_found_is_told_in_words_and_the_depth_is_listed(here: Here, tmp_path: Path) -> None:
    path = made(tmp_path, "a", "measure-wear", found=WEAR)
    shown = " ".join(here("run", "show", str(path)).out.split())
    assert "Z2 61.30 µm; wear 3.47 ± 0.99 µm; depth 7.95 ± 0.42 µm" in shown
    (line,) = (line for line in here("run", "list", str(tmp_path)).out.splitlines() if line.startswith("a "))
    assert "7.95 ± 0.42   3.47 ± 0.99" in line


def test_a_hole_that_was_left_is_told_as_deep_as_estimated(here: Here, tmp_path: Path) -> None:
    left = made(tmp_path, "left", "machine")
    assert "about 153.1 ± 6.5 µm (estimated)" in here("run", "show", str(left)).out
    assert here("run", "show", str(left), "--json").document["result"]["est_depth_u95_um"] == 6.5
    listed = here("run", "list", str(tmp_path)).out
    assert " ~153.1 " in listed
    assert "\n~ estimated by feed and energy, not touched." in listed
    compared = here("run", "compare", str(left), str(left)).out
    (line,) = (line for line in compared.splitlines() if line.startswith("depth "))
    assert line.split("   ")[0] == "depth when left (estimated), µm"
    assert "153.1 ± 6.5" in line


def test_a_recovered_run_was_killed_and_not_refused(here: Here, tmp_path: Path) -> None:
    here("run", "recover", str(killed(tmp_path, "dead")))
    said = " ".join(here("run", "explain", str(tmp_path / "dead.h5")).out.split())
    assert "was killed" in said
    assert "refused" not in said
    assert "exit code" not in said


def test_a_file_name_stays_on_its_line(here: Here, tmp_path: Path) -> None:
    made(tmp_path, "left", "machine").rename(tmp_path / "two\nlines\x1b[2J.h5")
    (tmp_path / "no\nfile.h5").write_text("no HDF5 at all")
    listed = here("run", "list", str(tmp_path)).out
    assert [line.split()[0] for line in listed.splitlines()[1:3]].count(r"two\nlines\x1b[2J") == 1
    assert r"no\nfile.h5" in listed
    assert "\x1b[2J" not in listed
