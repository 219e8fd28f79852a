"""Compiled code: told where it takes long, kept where there is a disk, made again where what was kept is damaged."""

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING

import numba
import pytest
from numba.core.caching import IndexDataCacheFile

from edmctl.actuator import compiling
from edmctl.actuator.compiling import cached, compiling_told
from edmctl.simulator.config import CONTROLLERS, compiling_takes

if TYPE_CHECKING:
    from pathlib import Path
    from typing import NoReturn


@pytest.fixture
def kept_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder for compiled code."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compiling, "_unkept", [])
    return tmp_path


def doubled(x: float) -> float:
    """Return twice that."""
    return 2.0 * x


def told_by_a_new_process() -> list[str]:
    """Use the function as if for the first time; what is said of it."""
    told: list[str] = []
    with compiling_told(told.append):
        assert cached(doubled)(4.0) == 8.0
    return told


def test_a_compilation_is_told_once(kept_in: Path) -> None:
    (line,) = told_by_a_new_process()
    assert line.startswith("compiling, once")
    assert told_by_a_new_process() == []


def test_what_is_told_of_an_emulated_board_is_another_time(kept_in: Path) -> None:
    told: dict[str, str] = {}
    for controller in CONTROLLERS:
        said: list[str] = []
        with compiling_told(said.append, compiling_takes(controller)):
            assert cached(doubled)(4.0) == 8.0
        told[controller] = said[0] if said else ""
        for kept in kept_in.rglob("*.nb?"):
            kept.unlink()
    assert told["python"] == told["firmware"] == "compiling, once for this installation: some 20 s"
    assert "minutes" in told["stm32"]


def test_a_long_compilation_is_told_again_and_again(kept_in: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "TOLD_EVERY_S", 1e-4)
    first, *others = told_by_a_new_process()
    assert first.startswith("compiling, once")
    assert others
    assert all(line.startswith("still compiling") for line in others)


@pytest.mark.parametrize("length", [0, 1, 100])
@pytest.mark.parametrize("kind", ["nbi", "nbc"])
def test_code_that_was_cut_short_is_made_again(kept_in: Path, kind: str, length: int) -> None:
    told_by_a_new_process()
    (damaged,) = kept_in.rglob(f"*.{kind}")
    os.truncate(damaged, length)
    assert told_by_a_new_process()
    assert told_by_a_new_process() == []


def test_a_full_disk_costs_time_alone_and_is_told(kept_in: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> NoReturn:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(IndexDataCacheFile, "_save_data", full)
    _, last = told_by_a_new_process()
    assert "No space left on device" in last
    assert "NUMBA_CACHE_DIR" in last


def test_without_a_folder_that_can_be_written_nothing_is_kept(
    kept_in: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (kept_in / "file").touch()
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(kept_in / "file" / "folder"))
    monkeypatch.setattr(numba.config, "CACHE_LOCATOR_CLASSES", "UserProvidedCacheLocator")
    _, last = told_by_a_new_process()
    assert "NUMBA_CACHE_DIR" in last
