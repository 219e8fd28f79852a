"""Nothing that was flushed is lost to a full disk, a taken name or a second writer; kills are in test_recovery."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from edmctl.errors import RunFileError
from edmctl.record import recovery
from edmctl.record.reader import open_run
from edmctl.record.rows import RunMeta
from edmctl.record.writer import RunWriter
from tests.record.samples import fill
from tests.tiers import tiers

ROOT = Path(__file__).parents[2]

COMMON = """
from pathlib import Path
from edmctl.record.rows import SlowRow
from edmctl.record.writer import RunWriter
from tests.record.samples import a_meta, servo_block
"""

CREATED = """
writer = RunWriter.create(Path({path!r}), a_meta())
"""

FULL_FROM_THE_START = """
import resource, signal
from edmctl.errors import RunFileError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, resource.RLIM_INFINITY))
try:
    RunWriter.create(Path({path!r}), a_meta())
except RunFileError as error:
    assert "File too large" in error.message, error.message
    print(error.code, error.exit_code)
"""

KILLED = (
    CREATED
    + """
for k in range(1_000_000):
    writer.append(servo_block(100 * k, 100))
    if k % 20 == 19:
        writer.flush()
        print(100 * (k + 1), flush=True)
"""
)

FULL_DISK = (
    CREATED
    + """
import resource, signal
from edmctl.errors import RunFileError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
writer.append(servo_block(0, 1000))
writer.flush()
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, resource.RLIM_INFINITY))
failures = []
for k in range(10, 4000):
    try:
        writer.append(servo_block(100 * k, 100))
        writer.append(SlowRow(k, 1.0, 0.8, 0.8, 0.2, 0.7, 0.1, 0.0, depth_um=1.0, wear_um=1.0, power_w=0.1))
        if k % 7 == 0:
            writer.flush()
    except RunFileError as error:
        failures.append(error)
assert len(failures) == 1, failures
error = failures[0]
assert error.exit_code == 9 and error.code == "E9003", error.code
assert "File too large" in error.message and {path!r} in error.message, error.message
assert "Free some space" in error.hint, error.hint
try:
    writer.finish("done", 0)
except RunFileError:
    print("refused")
print(writer.path)
"""
)

FULL_AT_THE_END = """
import os, resource, signal
from edmctl.errors import RunFileError
from tests.record.samples import fill
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
whole = RunWriter.create(Path({path!r} + ".whole"), a_meta())
fill(whole)
limit = whole.finish("done", 0).stat().st_size + {more_bytes}
writer = RunWriter.create(Path({path!r}), a_meta())
writer.append(servo_block(0, 1000))
writer.flush()
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
try:
    fill(writer)
    writer.finish("done", 0)
except RunFileError as error:
    print(error.code)
print(writer.path)
"""


def start(script: str, path: Path, **values: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", (COMMON + script).format(path=str(path), **values)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=environment)


@pytest.mark.parametrize("limit", tiers(600_000, slow=(400_000, 1_000_000)))
def test_a_full_disk_fails_once_and_keeps_what_was_flushed(tmp_path: Path, limit: int) -> None:
    with start(FULL_DISK, tmp_path / "run.h5", limit=limit) as writer:
        out, err = writer.communicate(timeout=60)
    assert err == ""
    assert writer.returncode == 0
    assert out.splitlines() == ["refused", str(tmp_path / "run.h5.partial")]
    with open_run(tmp_path / "run.h5.partial") as run:
        servo = run.columns("/entry/servo")
    rows = len(servo["time"])
    assert rows >= 1000
    np.testing.assert_array_equal(servo["time"][:1000], 0.01 * np.arange(1000))
    np.testing.assert_array_equal(servo["state"][:1000], np.arange(1000) % 10)


@pytest.mark.parametrize("more_bytes", tiers(-1, slow=(-600, 600), full=(-2000, 60_000)))
def test_a_disk_full_just_before_the_end_is_an_error_and_no_crash(tmp_path: Path, more_bytes: int) -> None:
    with start(FULL_AT_THE_END, tmp_path / "run.h5", more_bytes=more_bytes) as writer:
        out, err = writer.communicate(timeout=60)
    assert (err, writer.returncode) == ("", 0)
    assert out.splitlines() == ["E9003", str(tmp_path / "run.h5.partial")]
    with open_run(tmp_path / "run.h5.partial") as run:
        times = run.columns("/entry/servo")["time"]
    np.testing.assert_array_equal(times[:1000], 0.01 * np.arange(1000))


def test_a_file_that_is_not_compressed_for_want_of_space_keeps_none_that_was_reserved(
    tmp_path: Path, meta: RunMeta, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_room(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(recovery, "write_anew", no_room)
    writer = RunWriter.create(tmp_path / "run.h5", meta)
    fill(writer)
    content = writer.finish("done", 0).read_bytes()
    end_address = int.from_bytes(content[28:36], "little")  # superblock version 3
    assert content[8] == 3
    assert len(content) == end_address
    assert [p.name for p in tmp_path.iterdir()] == ["run.h5"]
    with open_run(tmp_path / "run.h5") as run:
        assert run.rows("/entry/servo") == 10_000


def test_a_file_system_that_cannot_reserve_will_do(
    tmp_path: Path, meta: RunMeta, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(descriptor: int, offset: int, length: int) -> None:
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    monkeypatch.setattr(os, "posix_fallocate", refuse)
    with open_run(RunWriter.create(tmp_path / "run.h5", meta).finish("done", 0)) as run:
        assert run.is_finished


@pytest.mark.parametrize(
    ("taken", "name", "code", "message", "hint"),
    [
        ("run.h5", "run.h5", "E9001", "exists already", "--run-id"),
        ("run.h5.partial", "run.h5", "E9001", "exists already", "--run-id"),
        ("link.h5", "link.h5", "E9001", "exists already", "--run-id"),
        ("file", "file/run.h5", "E9002", "is not a folder", "--out"),
        ("file", "x" * 300 + ".h5", "E9002", "name too long", "--out"),
    ],
)
def test_a_name_that_is_taken_or_impossible_is_refused_at_the_start(
    tmp_path: Path, meta: RunMeta, taken: str, name: str, code: str, message: str, hint: str
) -> None:
    if taken == "link.h5":
        (tmp_path / taken).symlink_to(tmp_path / "nowhere.h5")
    else:
        (tmp_path / taken).write_text("mine")
    with pytest.raises(RunFileError, match=message) as refusal:
        RunWriter.create(tmp_path / name, meta)
    assert refusal.value.code == code
    assert hint in refusal.value.hint
    assert [p.name for p in tmp_path.iterdir()] == [taken]
    assert taken == "link.h5" or (tmp_path / taken).read_text() == "mine"


@pytest.fixture(params=[True, False], ids=["links", "no links"])
def hard_links(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """File systems with and without them."""

    def refuse(source: Path, target: Path) -> None:
        raise PermissionError(1, "Operation not permitted")

    if not request.param:
        monkeypatch.setattr(os, "link", refuse)


@pytest.mark.usefixtures("hard_links")
def test_the_end_takes_no_name_from_others_and_makes_no_empty_run(tmp_path: Path, meta: RunMeta) -> None:
    path, partial = tmp_path / "run.h5", tmp_path / "run.h5.partial"
    gone = RunWriter.create(path, meta)
    with pytest.raises(RunFileError, match="exists already"):
        RunWriter.create(path, meta)
    partial.unlink()
    with pytest.raises(RunFileError, match="No such file") as refusal:
        gone.finish("done", 0)
    assert (refusal.value.code, "was moved or deleted" in refusal.value.hint) == ("E9004", True)
    assert list(tmp_path.iterdir()) == []
    writer = RunWriter.create(path, meta)
    path.write_text("somebody else's")
    with pytest.raises(RunFileError) as refusal:
        writer.finish("done", 0)
    assert (refusal.value.code, "run.h5.partial" in refusal.value.hint) == ("E9004", True)
    assert path.read_text() == "somebody else's"
    with open_run(partial) as run:
        assert run.text("/entry/status") == "done"
    for file in (path, partial):
        file.unlink()
    assert RunWriter.create(path, meta).finish("interrupted", 130) == path
    with open_run(path) as run:
        assert (run.text("/entry/status"), run.number("/entry/exit_code")) == ("interrupted", 130)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("limit", tiers(3000, slow=(0, 20_000)))
def test_a_disk_full_from_the_start_leaves_nothing(tmp_path: Path, limit: int) -> None:
    with start(FULL_FROM_THE_START, tmp_path / "run.h5", limit=limit) as writer:
        out, err = writer.communicate(timeout=60)
    assert (out, err, writer.returncode) == ("E9002 9\n", "", 0)
    assert list(tmp_path.iterdir()) == []
