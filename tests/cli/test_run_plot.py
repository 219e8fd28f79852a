"""`edmctl run plot`: which figures go where, what is refused, and what is left alone."""

from __future__ import annotations

import io
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from edmctl.errors import UsageError
from edmctl.jobs.runs.outputs import Target, plot_request
from edmctl.record.disk import hold_lock, release_lock
from edmctl.record.opening import SEAL_BYTES
from edmctl.record.reader import RunFile
from edmctl.report.kinds import KINDS, NAMES, Kind, kind_called
from edmctl.report.panels import NothingToDraw, new_figure
from tests.cli.commands import ROOT, Here
from tests.cli.test_start_up import HEAVY, modules_after

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PNG, PDF = b"\x89PNG\r\n\x1a\n", b"%PDF"
SOME = tuple(kind_called(name) for name in ("gap", "laue", "channel"))
"""Of a run without single pulses and without a path, only the first can be drawn."""


class Terminal(io.StringIO):
    """A stream that says that people read it."""

    def isatty(self) -> bool:
        return True


def sketch(kind: Kind, _: RunFile) -> Figure:
    """A figure that is drawn in no time, where there would be one."""
    if kind in SOME[1:]:
        raise NothingToDraw(f"There is no {kind.name} in this run.")
    figure = new_figure(20.0, 20.0)
    figure.text(0.5, 0.5, kind.name)
    return figure


@pytest.fixture(autouse=True)
def sketches(monkeypatch: pytest.MonkeyPatch) -> None:
    """What goes where is the question here; how the figures look is one of `tests/report`."""
    monkeypatch.setattr("edmctl.cli.commands.run.draw", sketch)
    monkeypatch.setattr("edmctl.report.page.draw", sketch)


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_all_that_can_be_drawn_goes_beside_the_run_and_is_announced_on_a_terminal(
    here: Here, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edmctl.jobs.runs.outputs.KINDS", SOME)
    said = here("run", "plot", str(run))
    assert said.exit_code == 0, said.err
    assert names_in(run.parent) == ["one-gap.png", "one.h5"]
    assert (run.parent / "one-gap.png").read_bytes().startswith(PNG)
    assert said.out.split() == ["gap", str(run.parent / "one-gap.png")]
    assert [line.split(":")[0] for line in said.err.splitlines()] == ["no laue", "no channel"]
    stderr = Terminal()
    monkeypatch.setattr(sys, "stderr", stderr)
    here("run", "plot", str(run), "--overwrite")
    drawing = [line for line in stderr.getvalue().splitlines() if line.startswith("drawing")]
    assert drawing == [f"drawing {kind.name} ({k} of 3)" for k, kind in enumerate(SOME, 1)]


def test_every_kind_but_the_report_is_drawn_without_being_asked_for(
    here: Here, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def content(_: object, target: Target) -> bytes:
        asked.append(target.name)
        return b"a figure"

    monkeypatch.setattr("edmctl.cli.commands.run._content", content)
    assert here("run", "plot", str(run)).exit_code == 0
    assert asked == [kind.name for kind in KINDS] == list(NAMES[:-1])


def test_named_figures_go_into_a_new_folder_or_the_file_that_is_named(here: Here, run: Path) -> None:
    folder, file = run.parent / "deep" / "figures", run.parent / "fig7.pdf"
    named = ("run", "plot", str(run), "--kind", "gap")
    said = here(*named, "--kind", "gap", "--format", "svg", "--out", str(folder))
    assert said.exit_code == 0, said.err
    assert names_in(folder) == ["one-gap.svg"]
    assert b"<svg" in (folder / "one-gap.svg").read_bytes()[:1000]
    document = here(*named, "-o", str(file), "--json").document
    assert file.read_bytes().startswith(PDF)
    assert (document["command"], document["simulated"], document["seed"]) == ("run plot", True, 3)
    assert document["run_file"] == str(run)
    assert document["result"] == {
        "figures": [{"kind": "gap", "file": str(file), "bytes": file.stat().st_size}],
        "nothing": [],
    }


def test_what_is_there_already_is_kept_unless_it_is_told_to_be_replaced(
    here: Here, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds = tuple(kind for kind in KINDS if kind.name in ("gap", "displacement"))
    monkeypatch.setattr("edmctl.jobs.runs.outputs.KINDS", kinds)
    there, command = run.parent / "one-gap.png", ("run", "plot", str(run))
    there.write_bytes(b"mine")
    refused = here(*command, "--kind", "gap", "--json")
    assert (refused.exit_code, refused.document["error"]["code"]) == (9, "E9011")
    assert "--overwrite" in refused.document["error"]["hint"]
    said = here(*command)
    assert said.exit_code == 0, said.err
    drawn = [word for word in said.out.split() if word.endswith(".png")]
    assert drawn == [str(run.parent / "one-displacement.png")]
    assert "1 figure of that name kept: --overwrite draws them anew" in said.err
    assert here(*command).exit_code == 9, "every figure is there"
    assert there.read_bytes() == b"mine"
    assert here(*command, "--kind", "gap", "--overwrite").exit_code == 0
    assert there.read_bytes().startswith(PNG)


def test_a_figure_that_was_asked_for_and_cannot_be_is_an_error_and_the_others_are_drawn(
    here: Here, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = here("run", "plot", str(run), "--kind", "laue", "--kind", "gap", "--json")
    document = said.document
    assert (said.exit_code, document["error"]["code"]) == (8, "E8091")
    assert "laue" in document["error"]["message"]
    assert [entry["kind"] for entry in document["result"]["figures"]] == ["gap"]
    assert [entry["kind"] for entry in document["result"]["nothing"]] == ["laue"]
    assert names_in(run.parent) == ["one-gap.png", "one.h5"]
    new = run.parent / "new"
    assert here("run", "plot", str(run), "--kind", "laue", "--out", str(new)).exit_code == 8
    assert not new.exists()
    monkeypatch.setattr("edmctl.jobs.runs.outputs.KINDS", SOME[1:])
    said = here("run", "plot", str(run))
    assert (said.exit_code, said.out, "E8091" in said.err) == (8, "", True)


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ("--kind gapp", "E2070"),
        ("--kind gap --kind steps --out two.png", "E2071"),
        ("--out all.svg", "E2071"),
        ("--kind gap --out -", "E2071"),
        ("--kind gap --format gif", "E2072"),
        ("--kind report --format pdf", "E2072"),
        ("--kind gap --format svg --out one.png", "E2072"),
        ("--kind gap --out one.html", "E2072"),
        ("--kind gap --out one.jpg", "E2072"),
        ("--kind report --out one.png", "E2072"),
    ],
)
def test_what_does_not_fit_together_is_a_usage_error(options: str, code: str, tmp_path: Path) -> None:
    words = options.split()
    named = dict(zip(words[::2], words[1::2], strict=True))
    kinds = [value for option, value in zip(words[::2], words[1::2], strict=True) if option == "--kind"]
    out = Path(named["--out"]) if "--out" in named else None
    with pytest.raises(UsageError) as refused:
        plot_request("one", tmp_path, kinds, out, named.get("--format"))
    assert refused.value.code == code


def test_help_hint_and_the_page_of_instructions_name_every_kind(here: Here, run: Path) -> None:
    hint = here("run", "plot", str(run), "--kind", "wavefroms", "--json").document["error"]["hint"]
    assert hint.startswith("Did you mean waveforms? ")
    out = here("run", "plot", "--help").out
    assert all(name in hint and f"  {name} " in out for name in NAMES)
    page = (ROOT / "docs/how-to.md").read_text(encoding="utf-8")
    section = page.partition("## Draw a run")[2].partition("\n## ")[0]
    assert re.findall(r"^\| `(\w+)` \|", section, flags=re.MULTILINE) == list(NAMES)


def test_a_live_run_is_drawn_as_far_as_it_goes_and_a_killed_one_is_refused(
    here: Here, unfinished: Path
) -> None:
    said = here("run", "plot", str(unfinished), "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (9, "E9008")
    assert names_in(unfinished.parent) == ["one.h5.partial"]
    lock = hold_lock(unfinished)
    try:
        said = here("run", "plot", str(unfinished), "--kind", "gap")
    finally:
        release_lock(lock)
    assert said.exit_code == 0, said.err
    assert (unfinished.parent / "one-gap.png").read_bytes().startswith(PNG)


def test_what_a_damaged_file_brings_about_is_its_own_fault(
    here: Here, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> Figure:
        raise ValueError("a text that is none")

    monkeypatch.setattr("edmctl.cli.commands.run.draw", fail)
    monkeypatch.setattr("edmctl.report.comparison.compare", fail)
    commands = (("plot", str(run), "--kind", "gap"), ("compare", str(run), str(run)))
    found = [here("run", *words, "--json").document["error"]["code"] for words in commands]
    assert found == ["E1000", "E1000"]
    run.write_bytes(run.read_bytes()[:-SEAL_BYTES])
    found = [here("run", *words, "--json").document["error"]["code"] for words in commands]
    assert found == ["E9007", "E9007"]


def test_a_file_that_is_no_run_and_a_folder_that_cannot_be_made_are_refused(here: Here, run: Path) -> None:
    taken = run.parent / "taken"
    taken.write_bytes(b"no HDF5")
    said = here("run", "plot", str(taken), "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (9, "E9005")
    said = here("run", "plot", str(run), "--kind", "gap", "--out", str(taken / "figures"), "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (9, "E9012")
    assert said.document["result"] is None


def test_the_report_is_one_page(here: Here, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edmctl.report.page.KINDS", SOME)
    said = here("run", "plot", str(run), "--kind", "report")
    assert said.exit_code == 0, said.err
    page = (run.parent / "one-report.html").read_text(encoding="utf-8")
    assert page.startswith("<!DOCTYPE html>")
    assert page.count("<figure") == 1
    assert "The run came to its end after" in page


def test_help_loads_nothing_heavy_and_a_figure_no_pyplot(run: Path, tmp_path: Path) -> None:
    assert not modules_after(["run", "plot", "--help"], tmp_path) & HEAVY
    loaded = modules_after(["run", "plot", str(run), "--kind", "gap"], tmp_path)
    assert "matplotlib" in loaded
    assert not loaded & {"matplotlib.pyplot", "scipy", "numba", "pydantic"}
