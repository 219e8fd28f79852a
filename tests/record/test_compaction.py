"""Closing a run compresses in threads, and any thread may need h5py's lock at any time to collect its garbage."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import h5py

from edmctl.record.writer import RunWriter
from tests.record.samples import a_meta, fill

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_no_thread_is_waited_for_with_the_lock_of_h5py(
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
    writer = RunWriter.create(tmp_path / "run.h5", a_meta())
    fill(writer)
    writer.finish("done", 0)
    assert free
    assert all(free)
