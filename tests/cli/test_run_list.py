"""`edmctl run list`: every run of a folder, whatever became of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from edmctl.cli.render.runs_tables import render_runs
from edmctl.cli.render.terminal import Style
from edmctl.labels import Basis, Verdict
from edmctl.record.reader import read_head
from edmctl.record.writer import RunWriter
from edmctl.wording import file_size, start_utc
from tests.cli.commands import Here
from tests.cli.run_files import begun, finished, killed
from tests.record.samples import a_meta, a_site_row


def test_a_row_says_what_became_of_a_run_and_the_newest_stands_last(here: Here, tmp_path: Path) -> None:
    finished(tmp_path, "a", "2026-03-01T12:00:00+00:00", status="machine fault")
    finished(tmp_path, "b", "2026-01-01T12:00:00+00:00")
    finished(tmp_path, "c", "2026-02-01T23:30:00-05:00")
    said = here("run", "list", str(tmp_path))
    assert (said.exit_code, said.err) == (0, "")
    lines = said.out.splitlines()[1:4]
    newest_last = [["b", "2026-01-01"], ["c", "2026-02-02"], ["a", "2026-03-01"]]
    assert [line.split()[:2] for line in lines] == newest_last
    for told in ("machine fault (6)", "cu270", "180.00 ± 0.90", "70.00 ± 1.10", "14 min 30 s"):
        assert told in lines[-1]
    run = here("run", "list", str(tmp_path), "--json").document["result"]["runs"][-1]
    assert (run["depth_um"], run["wear_u95_um"], run["error"]) == (180.0, 1.1, None)
    assert (run["sites"], run["seed"], run["simulated"], run["exit_code"]) == (1, 7, True, 6)


def test_a_run_that_another_one_continued_names_it(tmp_path: Path) -> None:
    for run_id, parent, status, code in (("c1", "", "stopped", 130), ("c1-r1", "c1", "done", 0)):
        meta = replace(a_meta(), run_id=run_id, parent_run=parent)
        RunWriter.create(tmp_path / f"{run_id}.h5", meta).finish(status, code)
    heads = [read_head(tmp_path / f"{name}.h5") for name in ("c1", "c1-r1")]
    first, second = render_runs(heads).splitlines()[1:3]
    assert "continued by c1-r1" in first
    assert "stopped" not in first
    assert "done" in second
    assert "stopped (130)" in render_runs(heads[:1])


def test_what_was_not_touched_is_marked(here: Here, tmp_path: Path) -> None:
    bases = {
        Basis.ESTIMATED: "~180.00 ± 0.90",
        Basis.MODEL: "≈180.00 ± 0.90",
        Basis.TOUCHED: " 180.00 ± 0.90",
    }
    for basis in bases:
        writer = RunWriter.create(tmp_path / f"{basis}.h5", a_meta())
        writer.append(replace(a_site_row(), depth_basis=basis, verdict=Verdict.SHOWN))
        writer.finish("done", 0)
    said = here("run", "list", str(tmp_path)).out
    rows = {line.split()[0]: line for line in said.splitlines() if "±" in line}
    for basis, text in bases.items():
        assert text in rows[basis]
        assert " 70.00 ± 1.10" in rows[basis]
    assert "~ estimated by feed and energy, not touched." in said
    assert "≈ touched without a sensor" in said


def test_files_that_cannot_be_read_are_rows_too(here: Here, tmp_path: Path) -> None:
    finished(tmp_path, "sound")
    (tmp_path / "empty.h5").touch()
    (tmp_path / "text.h5").write_text("no HDF5 at all")
    (tmp_path / "notes.txt").write_text("no run file")
    cut = finished(tmp_path, "cut")
    cut.write_bytes(cut.read_bytes()[:5000])
    (tmp_path / "lost.h5").symlink_to("nowhere")
    said = here("run", "list", str(tmp_path))
    assert said.exit_code == 0
    words = {line.split()[0]: line for line in said.out.splitlines()[1:6]}
    assert "done" in words["sound"]
    assert "damaged" in words["cut"]
    for name in ("empty", "text", "lost"):
        assert "no run file" in words[name]
    assert f"{tmp_path / 'empty.h5'} is empty." in said.out
    runs = here("run", "list", str(tmp_path), "--json").document["result"]["runs"]
    assert sorted(run["error"]["code"] for run in runs if run["error"]) == ["E9005"] * 3 + ["E9007"]


def test_a_live_run_is_told_from_a_killed_one_and_a_recovered_run_is_listed_once(
    here: Here, tmp_path: Path
) -> None:
    writer, left = begun(tmp_path, "living"), killed(tmp_path, "dead")

    def listed() -> dict[str, tuple[str, int | None, str]]:
        runs = here("run", "list", str(tmp_path), "--json").document["result"]["runs"]
        return {run["run_id"]: (run["status"], run["exit_code"], Path(run["path"]).name) for run in runs}

    assert listed() == {
        "living": ("running", None, "living.h5.partial"),
        "dead": ("interrupted", None, "dead.h5.partial"),
    }
    writer.finish("done", 0)
    here("run", "recover", str(left))
    assert listed() == {"living": ("done", 0, "living.h5"), "dead": ("recovered", None, "dead.h5")}


def test_listing_does_not_read_the_rows(here: Here, tmp_path: Path) -> None:
    path = finished(tmp_path, "a")
    content = bytearray(path.read_bytes())
    content[-20] ^= 0x04  # the check sum
    path.write_bytes(content)
    (run,) = here("run", "list", str(tmp_path), "--json").document["result"]["runs"]
    assert run["status"] == "done"
    assert here("run", "show", str(path)).exit_code == 9


def test_a_folder_without_runs_and_a_name_of_nothing_are_reported(here: Here, tmp_path: Path) -> None:
    for folder in ((), (str(tmp_path),)):
        said = here("run", "list", *folder)
        assert (said.exit_code, said.out) == (0, f"No run files in {folder[0] if folder else 'runs'}.\n")
    for name in ("nowhere", str(tmp_path / "typo")):
        said = here("run", "list", name, "--json")
        assert (said.exit_code, said.document["error"]["code"]) == (9, "E9005")
        assert f"neither a folder nor a run {name}" in said.document["error"]["message"]


@pytest.mark.parametrize("columns", [60, 80, 140])
def test_the_table_fits_the_terminal(tmp_path: Path, columns: int) -> None:
    heads = [read_head(finished(tmp_path, run_id)) for run_id in ("a", "b")]
    text = render_runs(heads, Style(colour=False, live=False, columns=columns))
    assert max(map(len, text.splitlines())) <= columns
    assert "180.00 ± 0.90" in text
    assert ("Hidden columns" in text) == (columns < 140)


def test_where_nothing_else_can_go_status_and_names_get_shorter(tmp_path: Path) -> None:
    name = "measure-wear-20260102T103519.506Z"
    heads = [
        replace(read_head(finished(tmp_path, name)), status="objective not reached", exit_code=7),
        read_head(finished(tmp_path, "a")),
    ]
    for columns, shown in ((70, name), (40, "measure-wear-20")):
        text = render_runs(heads, Style(colour=False, live=False, columns=columns))
        assert max(map(len, text.splitlines())) <= columns
        assert f"{shown}   exit 7" in text


@pytest.mark.parametrize(
    ("size_bytes", "text"),
    [(0, "0 B"), (999, "999 B"), (1000, "1.0 kB"), (215_640, "216 kB"), (2_092_156, "2.1 MB")],
)
def test_sizes_are_read_at_a_glance(size_bytes: int, text: str) -> None:
    assert file_size(size_bytes) == text
    assert start_utc("\x1b[2J") == "?[2J", "a text out of a file cannot command the terminal"
