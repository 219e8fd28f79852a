"""`edmctl run recover`: what a user sees of it; the work itself is tested in tests/record/test_recovery.py."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from edmctl.record.reader import open_run
from edmctl.record.writer import RunWriter
from tests.cli.commands import Here
from tests.record.samples import a_meta, fill


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    """What a killed writer leaves behind."""
    writer = RunWriter.create(tmp_path / "living.h5", a_meta())
    fill(writer)
    writer.flush()
    left = tmp_path / "runs" / "cut.h5.partial"
    left.parent.mkdir()
    shutil.copyfile(tmp_path / "living.h5.partial", left)
    writer.abandon("done", 0)
    return left


def test_a_killed_run_is_recovered(here: Here, killed: Path) -> None:
    said = here("run", "recover", str(killed))
    assert (said.exit_code, said.err) == (0, "")
    assert "10 000 of servo" in said.out
    assert "status `recovered`" in said.out
    with open_run(killed.with_suffix("")) as run:
        assert run.text("/entry/status") == "recovered"


def test_the_document_says_what_came_back(here: Here, killed: Path, tmp_path: Path) -> None:
    said = here("run", "recover", str(killed), "--out", str(tmp_path / "new.h5"), "--json")
    document = said.document
    assert document["run_file"] == str(tmp_path / "new.h5")
    assert document["result"]["rows"]["/entry/servo"] == 10_000
    assert document["result"]["status"] == "recovered"
    assert document["simulated"] is True


def test_a_complete_file_needs_nothing(here: Here, killed: Path) -> None:
    here("run", "recover", str(killed))
    said = here("run", "recover", str(killed.with_suffix("")))
    assert said.exit_code == 0
    assert "nothing to recover" in said.out
    assert len(list(killed.parent.iterdir())) == 2


def test_a_second_time_is_refused(here: Here, killed: Path) -> None:
    here("run", "recover", str(killed))
    said = here("run", "recover", str(killed))
    assert said.exit_code == 9
    assert "E9001" in said.err
    assert "--out" in said.err
    assert "--run-id" not in said.err


@pytest.mark.parametrize("content", [b"", b"something else", b"\x89HDF\r\n\x1a\n" + bytes(500)])
def test_what_is_no_run_file_is_refused(here: Here, tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.h5.partial"
    path.write_bytes(content)
    said = here("run", "recover", str(path))
    assert said.exit_code == 9
    assert "help:" in said.err
    assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


def test_a_run_that_goes_on_is_left_alone(here: Here, tmp_path: Path) -> None:
    writer = RunWriter.create(tmp_path / "run.h5", a_meta())
    said = here("run", "recover", str(tmp_path / "run.h5.partial"))
    assert said.exit_code == 9
    assert "E9014" in said.err
    assert writer.finish("done", 0).exists()
