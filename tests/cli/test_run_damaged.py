"""Damaged, foreign and missing files: a message and exit code 9, never a traceback, never a write."""

from __future__ import annotations

import os
import random
import re
import shutil
from pathlib import Path

import h5py
import pytest

from edmctl.record.reader import open_run
from edmctl.record.writer import RunWriter
from tests.cli.commands import Here, Said
from tests.cli.run_files import finished, killed
from tests.record.samples import a_meta, fill
from tests.tiers import tiers

READERS = (("show",), ("explain",), ("export", "-t", "events"), ("list",))
SEAL_BYTES = 62
"""More than the line behind the HDF5 data."""


def readings(here: Here, path: Path) -> list[Said]:
    """What each command says of the file; none changes it."""
    before = path.read_bytes()
    said = [here("run", words[0], str(path), *words[1:]) for words in READERS]
    assert path.read_bytes() == before
    assert [path.name] == [other.name for other in path.parent.iterdir()]
    for one in said:
        assert one.exit_code in (0, 9), one
        assert one.exit_code == 0 or "error[E900" in one.err, one
    return said


def flipped(content: bytes, chance: random.Random, flips: int, below: int) -> bytes:
    changed = bytearray(content)
    for _ in range(flips):
        changed[chance.randrange(below)] ^= 1 << chance.randrange(8)
    return bytes(changed)


@pytest.mark.parametrize("seed", tiers(0, slow=(1,), full=(2,)))
def test_a_sealed_file_that_was_changed_is_refused(here: Here, tmp_path: Path, seed: int) -> None:
    path = finished(tmp_path, "one")
    content, chance = path.read_bytes(), random.Random(seed)
    for _ in range(8):
        path.write_bytes(flipped(content, chance, chance.choice((1, 1, 40)), len(content) - SEAL_BYTES))
        assert [said.exit_code for said in readings(here, path)][:3] == [9, 9, 9]


@pytest.mark.parametrize("seed", tiers(0, slow=(1,), full=(2,)))
def test_a_file_that_was_cut_anywhere_is_refused(here: Here, tmp_path: Path, seed: int) -> None:
    path = finished(tmp_path, "one")
    content, chance = path.read_bytes(), random.Random(seed)
    for _ in range(8):
        path.write_bytes(content[: chance.randrange(len(content))])
        assert [said.exit_code for said in readings(here, path)][:3] == [9, 9, 9]


def test_a_file_that_was_cut_off_is_told_in_plain_words(here: Here, tmp_path: Path) -> None:
    path = finished(tmp_path, "one")
    path.write_bytes(path.read_bytes()[:20_000])
    said = here("run", "show", str(path))
    assert re.search(r"it is shorter than it says, 20000 of 1\d{5} bytes", said.err)
    assert "eof" not in said.err


@pytest.mark.parametrize("seed", tiers(0, slow=(1,), full=(2,)))
def test_what_a_killed_writer_left_may_be_damaged_too(here: Here, tmp_path: Path, seed: int) -> None:
    path = killed(tmp_path, "dead")
    content, chance = path.read_bytes(), random.Random(seed)
    for _ in range(8):
        # Most of the metadata lies at the begin.
        below = chance.choice((60_000, len(content)))
        damaged = flipped(content, chance, chance.choice((1, 4)), below)
        path.write_bytes(damaged[: chance.choice((len(content), chance.randrange(len(content))))])
        assert [said.exit_code for said in readings(here, path)][:3] == [9, 9, 9]


@pytest.mark.parametrize("seed", tiers(0, slow=(1,)))
def test_a_file_without_a_check_sum_may_hold_anything(here: Here, tmp_path: Path, seed: int) -> None:
    path = finished(tmp_path, "one")
    content, chance = path.read_bytes()[:-SEAL_BYTES], random.Random(seed)
    content = content[: content.rindex(b"\n") if content.endswith(b"\n") else len(content)]
    for _ in range(8):
        path.write_bytes(flipped(content, chance, chance.choice((1, 4, 40)), len(content)))
        readings(here, path)


def test_metadata_that_never_fits_is_not_waited_for(here: Here, tmp_path: Path) -> None:
    path = killed(tmp_path, "dead")
    content = bytearray(path.read_bytes())
    place = content.index(b"OHDR") + 8
    content[place] ^= 8
    path.write_bytes(content)
    for said in readings(here, path)[:3]:
        assert "E9007" in said.err


@pytest.mark.parametrize("kind", ["missing", "empty", "folder", "foreign", "text", "later", "fifo"])
@pytest.mark.parametrize("words", READERS[:3])
def test_what_is_no_run_file_is_told(here: Here, tmp_path: Path, kind: str, words: tuple[str, ...]) -> None:
    path = tmp_path / "one.h5"
    if kind == "empty":
        path.touch()
    elif kind == "folder":
        path.mkdir()
    elif kind == "text":
        path.write_text("t_s,u_V\n0,1\n")
    elif kind == "fifo":
        if not hasattr(os, "mkfifo"):
            pytest.skip("Windows has no pipes with names.")
        os.mkfifo(path)
    elif kind in ("foreign", "later"):
        with h5py.File(path, "w") as file:
            file.attrs["schema"] = "edmctl-run/3" if kind == "later" else "another/1"
    said = here("run", words[0], str(path), *words[1:])
    assert said.exit_code == 9
    assert ("E9006" if kind == "later" else "E9005") in said.err
    assert "= help:" in said.err


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read everything")
def test_a_file_that_may_not_be_read_is_told(here: Here, tmp_path: Path) -> None:
    path = finished(tmp_path, "one")
    path.chmod(0)
    for said in (here("run", "show", str(path)), here("run", "list", str(path))):
        assert said.exit_code == 9
        assert "Permission denied" in said.err


@pytest.fixture
def left_behind(tmp_path: Path) -> Path:
    """What a left_behind writer leaves behind."""
    writer = RunWriter.create(tmp_path / "living.h5", a_meta())
    fill(writer)
    writer.flush()
    left = tmp_path / "runs" / "cut.h5.partial"
    left.parent.mkdir()
    shutil.copyfile(tmp_path / "living.h5.partial", left)
    writer.abandon("done", 0)
    return left


def test_a_killed_run_is_recovered(here: Here, left_behind: Path) -> None:
    said = here("run", "recover", str(left_behind))
    assert (said.exit_code, said.err) == (0, "")
    assert "10 000 of servo" in said.out
    assert "status `recovered`" in said.out
    with open_run(left_behind.with_suffix("")) as run:
        assert run.text("/entry/status") == "recovered"


def test_the_document_says_what_came_back(here: Here, left_behind: Path, tmp_path: Path) -> None:
    said = here("run", "recover", str(left_behind), "--out", str(tmp_path / "new.h5"), "--json")
    document = said.document
    assert document["run_file"] == str(tmp_path / "new.h5")
    assert document["result"]["rows"]["/entry/servo"] == 10_000
    assert document["result"]["status"] == "recovered"
    assert document["simulated"] is True


def test_a_complete_file_needs_nothing(here: Here, left_behind: Path) -> None:
    here("run", "recover", str(left_behind))
    said = here("run", "recover", str(left_behind.with_suffix("")))
    assert said.exit_code == 0
    assert "nothing to recover" in said.out
    assert len(list(left_behind.parent.iterdir())) == 2


def test_a_second_time_is_refused(here: Here, left_behind: Path) -> None:
    here("run", "recover", str(left_behind))
    said = here("run", "recover", str(left_behind))
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
