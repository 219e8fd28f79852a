"""A run file without an end, or with damage, becomes a complete one; the old file stays as it is."""

from __future__ import annotations

import os
import random
import shutil
import signal
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from edmctl.errors import RunFileError
from edmctl.record import layout, recovery
from edmctl.record.disk import is_live
from edmctl.record.opening import SEAL_BYTES, open_file, verify_checksum
from edmctl.record.reader import open_run
from edmctl.record.recovery import is_complete, recover, recover_damaged, write_anew
from edmctl.record.writer import RunWriter
from tests.golden import once
from tests.record.samples import a_meta, fill, finished, servo_block
from tests.record.test_crash import KILLED, start
from tests.tiers import tiers


@pytest.fixture
def killed(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a killed writer leaves behind."""

    def make(folder: Path) -> None:
        writer = RunWriter.create(folder / "living" / "run.h5", a_meta())
        fill(writer)
        writer.flush()
        shutil.copyfile(folder / "living" / "run.h5.partial", folder / "run.h5.partial")
        writer.finish("done", 0)

    (tmp_path / "runs").mkdir()
    made = once(tmp_path_factory, "killed-writer", make) / "run.h5.partial"
    return Path(shutil.copyfile(made, tmp_path / "runs" / "run.h5.partial"))


def code_of(call: Callable[[], object]) -> str:
    """Return the code of the error that a call ends with."""
    with pytest.raises(RunFileError) as refusal:
        call()
    return refusal.value.code


def flipped(path: Path, bit: int, new: Path) -> Path:
    """A copy of `path` with one bit turned."""
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    new.write_bytes(content)
    return new


def test_a_killed_run_becomes_a_complete_file_with_every_row(killed: Path) -> None:
    before, taken = killed.read_bytes(), killed.with_suffix("")
    taken.write_text("mine")
    assert code_of(lambda: recover(killed)) == "E9001"
    assert taken.read_text() == "mine"
    taken.unlink()
    made = recover(killed)
    assert (made.path, made.lost_rows, made.unread_rows) == (killed.with_suffix(""), {}, {})
    assert killed.read_bytes() == before
    assert sorted(p.name for p in killed.parent.iterdir()) == ["run.h5", "run.h5.partial"]
    assert verify_checksum(made.path)
    assert is_complete(made.path)
    with h5py.File(made.path), open_run(made.path) as new, open_run(killed) as old:
        assert new.is_finished
        assert (new.text("/entry/status"), new.number("/entry/exit_code")) == ("recovered", -1)
        assert new.text("/entry/recovery").startswith("from run.h5.partial by edmctl")
        assert new.text("/entry/end_time")[:2] == "20"
        assert new.profile_values() == old.profile_values()
        for table in layout.TABLES:
            assert new.rows(table.path) == old.rows(table.path)
            if table.is_compound:
                assert old.table(table.path).tobytes() == new.table(table.path).tobytes()
            else:
                for name, column in old.columns(table.path).items():
                    np.testing.assert_array_equal(column, new.column(table.path, name))


def test_columns_that_a_kill_left_unequal_are_cut_to_the_shortest(tmp_path: Path) -> None:
    writer = RunWriter.create(tmp_path / "living.h5", a_meta())
    fill(writer)
    writer.flush()
    writer._file["/entry/servo/s"].resize((9_000,))
    writer._file.flush()
    shutil.copyfile(tmp_path / "living.h5.partial", tmp_path / "torn.h5.partial")
    made = recover(tmp_path / "torn.h5.partial")
    assert made.rows["/entry/servo"] == 9_000
    assert made.lost_rows == {"/entry/servo": 1_000}
    with h5py.File(made.path) as run:
        assert {len(run[f"/entry/servo/{name}"]) for name in run["/entry/servo"]} == {9_000}
        assert run["/entry/data/time"] == run["/entry/servo/time"]
    writer.finish("done", 0)


@pytest.mark.parametrize("seed", tiers(0, slow=(1,), full=(2,)))
def test_a_writer_killed_at_any_instant_loses_no_flushed_row(tmp_path: Path, seed: int) -> None:
    chance, partial = random.Random(seed), tmp_path / "run.h5.partial"
    with start(KILLED, tmp_path / "run.h5") as writer:
        assert writer.stdout is not None
        for _ in range(chance.randrange(1, 30)):
            flushed = int(writer.stdout.readline())
        assert is_live(partial)
        assert code_of(lambda: recover(partial)) == "E9014"
        os.kill(writer.pid, signal.SIGKILL)
    assert not is_live(partial)
    with pytest.raises(OSError, match="already open for write"):
        h5py.File(partial, "r")
    with open_run(partial) as old, open_run(recover(partial).path) as new:
        assert (old.is_finished, new.is_finished) == (False, True)
        for run in (old, new):
            k = np.arange(run.rows("/entry/servo"))
            assert len(k) >= flushed
            np.testing.assert_array_equal(run.column("/entry/servo", "time"), 0.01 * k)
            current_a = run.column("/entry/servo", "current")
            np.testing.assert_array_equal(current_a[:flushed], (k[:flushed] + 0.6).astype(np.float32))


def test_a_run_that_died_while_it_was_closed_keeps_its_status(killed: Path) -> None:
    begun = killed.with_name("run.h5.closing")
    begun.write_bytes(b"half a file")
    made = recover(killed).path
    assert not begun.exists()
    with h5py.File(made, "r+") as ended:
        ended["/entry/status"][()] = b"machine fault"
        ended["/entry/exit_code"][()] = 6
    with open_run(recover(made.rename(killed.with_name("closing.h5.partial"))).path) as run:
        assert run.text("/entry/status") == "machine fault"
        assert run.number("/entry/exit_code") == 6


def test_any_flipped_bit_or_cut_of_a_finished_file_is_found_before_it_is_read(
    run_path: Path, tmp_path: Path
) -> None:
    chance, content = random.Random(4), run_path.read_bytes()
    broken = tmp_path / "broken.h5"
    bits = [chance.randrange(8 * len(content)) for _ in range(40)]
    lengths = [0, 1, 7, 8, 100, 2000, len(content) // 2, len(content) - SEAL_BYTES - 1, len(content) - 1]
    for bit in bits:
        flipped(run_path, bit, broken)
        before = broken.read_bytes()
        assert code_of(lambda: open_run(broken)) in ("E9005", "E9007")
        assert broken.read_bytes() == before
    for length in lengths:
        broken.write_bytes(content[:length])
        assert code_of(lambda: open_run(broken)) in ("E9005", "E9007"), length


def with_damaged_chunk(path: Path, column: str, new: Path) -> Path:
    with h5py.File(path) as run:
        chunk = run[column].id.get_chunk_info(0)
    return flipped(path, 8 * (chunk.byte_offset + chunk.size // 2), new)


def test_a_damaged_column_costs_that_column(write_run: Callable[[str], Path], tmp_path: Path) -> None:
    path = write_run("whole.h5")
    broken = with_damaged_chunk(path, "/entry/servo/v_cmd", tmp_path / "broken.h5")
    assert code_of(lambda: recover(broken)) == "E9007"
    made = recover_damaged(broken)
    assert (made.path, made.lost_rows) == (tmp_path / "broken.recovered.h5", {})
    assert made.unread_rows == {"/entry/servo/v_cmd": 10_000}  # all in one chunk
    with open_run(path) as old, open_run(made.path) as new:
        assert new.text("/entry/status") == "recovered"
        assert new.table("/entry/results").tobytes() == old.table("/entry/results").tobytes()
        assert new.profile_values() == old.profile_values()
        assert new.summary() == old.summary()
        assert np.isnan(new.column("/entry/servo", "v_cmd")).all()
        for name in ("time", "z_sensor", "state"):
            np.testing.assert_array_equal(new.column("/entry/servo", name), old.column("/entry/servo", name))
        for scalar in layout.SCALARS:
            if scalar.dtype == "text" and scalar.source:
                assert new.text(scalar.path) == old.text(scalar.path), scalar.path


def test_rows_whose_time_is_lost_end_the_table(run_path: Path, tmp_path: Path) -> None:
    made = recover_damaged(with_damaged_chunk(run_path, "/entry/servo/time", tmp_path / "broken.h5"))
    assert (made.rows["/entry/servo"], made.lost_rows) == (0, {"/entry/servo": 10_000})
    assert made.rows["/entry/slow"] == 30


@pytest.mark.parametrize("share", tiers(0.5, slow=(0.35, 0.6)))
def test_a_killed_file_that_lost_its_end_gives_what_is_left(killed: Path, share: float) -> None:
    content = killed.read_bytes()
    killed.write_bytes(content[: int(share * len(content))])
    assert code_of(lambda: recover(killed)) == "E9007"
    made = recover_damaged(killed)
    assert made.rows["/entry/servo"] > 0
    with open_run(made.path) as run:
        k = np.arange(run.rows("/entry/servo"))
        np.testing.assert_array_equal(run.column("/entry/servo", "time"), 0.01 * k)


@pytest.mark.parametrize("open_end", tiers(True, slow=(False,)))
def test_texts_without_an_end_are_found_before_hdf5_goes_through_them(
    killed: Path, run_path: Path, tmp_path: Path, open_end: bool
) -> None:
    content = bytearray((killed if open_end else run_path).read_bytes())
    heap = content.index(b"GCOL\x01\0\0\0")
    content[heap + 512 : heap + 4096] = bytes(4096 - 512)
    broken = tmp_path / ("endless.h5.partial" if open_end else "endless.h5")
    broken.write_bytes(content)
    assert code_of(lambda: open_run(broken)) == "E9007"
    with pytest.raises(RunFileError):
        open_file(broken, verify=False)
    assert recover_damaged(broken).rows["/entry/servo"] == 10_000


def test_a_file_that_claims_more_rows_than_it_can_hold_is_damaged(killed: Path) -> None:
    made = recover(killed).path
    with h5py.File(made, "r+") as file:
        del file["/entry/events"]
        kind = layout.EVENTS.row_type
        file.create_dataset("/entry/events", (10**13,), kind, chunks=(64,), maxshape=(None,))
    assert code_of(lambda: recover(made)) == "E9007"
    assert recover_damaged(made).rows["/entry/events"] == 0


def test_two_recoveries_at_once_do_not_meet(killed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second begins and ends while the first copies."""
    first_copy = write_anew

    def interleaved(*arguments: Any) -> None:
        monkeypatch.setattr(recovery, "write_anew", first_copy)
        monkeypatch.setattr(os, "getpid", lambda: 4242)
        second = recover(killed)
        assert verify_checksum(second.path)
        first_copy(*arguments)

    monkeypatch.setattr(recovery, "write_anew", interleaved)
    assert code_of(lambda: recover(killed)) == "E9001"
    assert verify_checksum(killed.with_suffix(""))
    assert sorted(p.name for p in killed.parent.iterdir()) == ["run.h5", "run.h5.partial"]


TOLD_BY_HDF5 = (
    "Can't close file (file write failed: time = now\n, errno = 28, error message = 'No', buf = 0x55e2)"
)


@pytest.mark.parametrize(
    "error",
    tiers(OSError(TOLD_BY_HDF5), slow=(OSError(28, TOLD_BY_HDF5), RuntimeError(TOLD_BY_HDF5))),
)
def test_a_full_disk_is_not_called_damage(
    killed: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def full(*arguments: object) -> None:
        raise error

    monkeypatch.setattr(recovery, "write_anew", full)
    with pytest.raises(RunFileError) as refusal:
        recover(killed)
    assert str(refusal.value).endswith("run.h5: No space left on device.")
    assert refusal.value.code == "E9002"


@pytest.mark.parametrize("seed", tiers(1, slow=(0, 2), full=(3,)))
def test_salvage_of_any_damage_ends_in_a_file_or_an_error(run_path: Path, tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)
    content = bytearray(run_path.read_bytes())
    for _ in range(seed * 20 + 1):
        content[chance.randrange(8, len(content))] ^= 1 << chance.randrange(8)
    broken = tmp_path / "broken.h5"
    broken.write_bytes(content)
    new = tmp_path / "broken.recovered.h5"
    refusal = None
    try:
        recover_damaged(broken)
    except RunFileError as error:
        refusal = error
    if refusal is None:
        open_run(new).close()
    else:
        assert (refusal.code, "beyond recovery" in refusal.message) == ("E9007", True)
        assert not new.exists()
    assert broken.read_bytes() == bytes(content)
    assert {p.name for p in tmp_path.iterdir()} <= {"run.h5", "broken.h5", "broken.recovered.h5"}


def test_no_thread_of_the_closing_is_waited_for_with_the_lock_of_h5py(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thread that collected a handle as it started, while the copy held the lock, kept `machine` for ever."""
    submit, free = ThreadPoolExecutor.submit, list[bool]()

    def checked(self: ThreadPoolExecutor, *args: Any) -> Any:
        other = threading.Thread(target=h5py.h5s.create_simple, args=((3,),), daemon=True)
        other.start()
        other.join(20.0)
        free.append(not other.is_alive())
        return submit(self, *args)

    monkeypatch.setattr(ThreadPoolExecutor, "submit", checked)
    finished(tmp_path / "run.h5", servo_block(0, 1000))
    assert free
    assert all(free)
