"""Damaged, foreign and missing files: a message and exit code 9, never a traceback, never a write."""

from __future__ import annotations

import os
import random
import re
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

from edmctl.record.reader import open_run
from edmctl.record.writer import RunWriter
from tests.cli.commands import Here, Said
from tests.cli.run_files import finished, killed
from tests.record.samples import a_meta
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


def sealed(folder: Path) -> bytes:
    return finished(folder, "one").read_bytes()


def unsealed(folder: Path) -> bytes:
    content = sealed(folder)[:-SEAL_BYTES]
    return content[: content.rindex(b"\n") if content.endswith(b"\n") else len(content)]


def left_by_a_kill(folder: Path) -> bytes:
    return killed(folder, "dead").read_bytes()


def cut(content: bytes, chance: random.Random) -> bytes:
    return content[: chance.randrange(len(content))]


def changed(content: bytes, chance: random.Random) -> bytes:
    return flipped(content, chance, chance.choice((1, 1, 40)), len(content) - SEAL_BYTES)


def changed_and_cut(content: bytes, chance: random.Random) -> bytes:
    # Most of the metadata lies at the begin.
    damaged = flipped(content, chance, chance.choice((1, 4)), chance.choice((60_000, len(content))))
    return damaged[: chance.choice((len(content), chance.randrange(len(content))))]


@pytest.mark.parametrize(
    ("made", "damage", "is_refused"),
    [
        (sealed, changed, True),
        (sealed, cut, True),
        (left_by_a_kill, changed_and_cut, True),
        (unsealed, changed, False),
    ],
    ids=["changed", "cut", "killed and damaged", "without a check sum"],
)
@pytest.mark.parametrize("seed", tiers(0, slow=(1,), full=(2,)))
def test_a_damaged_file_is_refused_unless_it_may_hold_anything(
    here: Here,
    tmp_path: Path,
    seed: int,
    made: Callable[[Path], bytes],
    damage: Callable[[bytes, random.Random], bytes],
    is_refused: bool,
) -> None:
    content, chance = made(tmp_path / "made"), random.Random(seed)
    path = tmp_path / "damaged" / ("one.h5.partial" if made is left_by_a_kill else "one.h5")
    path.parent.mkdir()
    for _ in range(4):
        path.write_bytes(damage(content, chance))
        codes = [said.exit_code for said in readings(here, path)]
        assert not is_refused or codes[:3] == [9, 9, 9]


def test_a_file_that_was_cut_off_is_told_in_plain_words_and_broken_metadata_is_not_waited_for(
    here: Here, tmp_path: Path
) -> None:
    path = finished(tmp_path, "one")
    path.write_bytes(path.read_bytes()[:20_000])
    said = here("run", "show", str(path))
    assert re.search(r"it is shorter than it says, 20000 of 1\d{5} bytes", said.err)
    assert "eof" not in said.err
    path.unlink()
    path = killed(tmp_path, "dead")
    content = bytearray(path.read_bytes())
    place = content.index(b"OHDR") + 8
    content[place] ^= 8
    path.write_bytes(content)
    for said in readings(here, path)[:3]:
        assert "E9007" in said.err


@pytest.mark.parametrize(
    ("kind", "words"),
    [(kind, READERS[0]) for kind in ("missing", "empty", "folder", "foreign", "text", "later", "fifo")]
    + [("text", words) for words in READERS[1:3]],
)
def test_what_is_no_run_file_is_told(here: Here, tmp_path: Path, kind: str, words: tuple[str, ...]) -> None:
    path = tmp_path / "one.h5"
    if kind == "folder":
        path.mkdir()
    elif kind == "fifo":
        os.mkfifo(path)
    elif kind in ("foreign", "later"):
        with h5py.File(path, "w") as file:
            file.attrs["schema"] = "edmctl-run/3" if kind == "later" else "another/1"
    elif kind != "missing":
        path.write_text("t_s,u_V\n0,1\n" if kind == "text" else "")
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


def test_a_killed_run_is_recovered_once(here: Here, tmp_path: Path) -> None:
    left = killed(tmp_path, "cut")
    said = here("run", "recover", str(left))
    assert (said.exit_code, said.err) == (0, "")
    assert "1 000 of servo" in said.out
    assert "status `recovered`" in said.out
    with open_run(left.with_suffix("")) as run:
        assert run.text("/entry/status") == "recovered"
    said = here("run", "recover", str(left.with_suffix("")))
    assert (said.exit_code, "nothing to recover" in said.out) == (0, True)
    said = here("run", "recover", str(left))
    assert said.exit_code == 9
    assert "E9001" in said.err
    assert "--out" in said.err
    assert "--run-id" not in said.err
    document = here("run", "recover", str(left), "--out", str(tmp_path / "new.h5"), "--json").document
    assert (document["run_file"], document["simulated"]) == (str(tmp_path / "new.h5"), True)
    assert document["result"]["rows"]["/entry/servo"] == 1_000
    assert document["result"]["status"] == "recovered"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cut.h5", "cut.h5.partial", "new.h5"]


@pytest.mark.parametrize("content", [b"", b"something else", b"\x89HDF\r\n\x1a\n" + bytes(500)])
def test_what_is_no_run_file_is_not_recovered(here: Here, tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.h5.partial"
    path.write_bytes(content)
    said = here("run", "recover", str(path))
    assert (said.exit_code, "help:" in said.err) == (9, True)
    assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


def test_a_run_that_goes_on_is_left_alone(here: Here, tmp_path: Path) -> None:
    writer = RunWriter.create(tmp_path / "run.h5", a_meta())
    said = here("run", "recover", str(tmp_path / "run.h5.partial"))
    assert (said.exit_code, "E9014" in said.err) == (9, True)
    assert writer.finish("done", 0).exists()
