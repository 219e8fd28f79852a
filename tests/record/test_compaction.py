"""Closing a run compresses in threads, and any thread may need h5py's lock at any time to collect its garbage."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from edmctl.record.compaction import compact

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

    with h5py.File(tmp_path / "a.h5", "w") as source:
        for name in ("gap", "time"):
            source.create_dataset(f"entry/servo/{name}", data=np.arange(200_000.0), chunks=(1000,))
        monkeypatch.setattr(ThreadPoolExecutor, "submit", checked)
        compact(source, tmp_path / "b.h5")
    assert free
    assert all(free)
    with h5py.File(tmp_path / "b.h5") as copied:
        assert copied["entry/servo/time"][-1] == 199_999.0
