"""A cut under the image is that of the core on the host, byte for byte, whichever compiler has made the image."""

from __future__ import annotations

import ctypes as ct
from typing import Any

import pytest

from edmctl.link import messages as m
from tests.firmware import board_twin
from tests.firmware.board_twin import Cut
from tests.needs import BOARD_COMPILERS, EMULATOR

pytestmark = EMULATOR
SECONDS, SEED = 2.0, 2


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ct.CDLL:
    return board_twin.built(tmp_path_factory.mktemp("twin"))


@pytest.fixture(scope="module")
def zig_cut(library: ct.CDLL) -> Cut:
    return _cut("zig", library)


@pytest.fixture(scope="module")
def gcc_cut(library: ct.CDLL) -> Cut:
    return _cut("gcc", library)


def _cut(name: str, library: ct.CDLL) -> Cut:
    return board_twin.cut(SECONDS, SEED, name, library)


@pytest.mark.parametrize("name", BOARD_COMPILERS)
def test_the_core_on_the_host_sends_the_same_bytes(request: pytest.FixtureRequest, name: str) -> None:
    cut: Cut = request.getfixturevalue(f"{name}_cut")
    assert cut.bench.controller.state is m.State.MACHINING
    assert cut.twin_ticks > 1000 * SECONDS
    assert cut.pulses > 2000 * SECONDS
    assert len(cut.uart) > 15_000 * SECONDS
    assert cut.uart == cut.twin_sent


@pytest.mark.needs("arm-none-eabi-gcc")
def test_both_compilers_make_the_same_bytes(zig_cut: Cut, gcc_cut: Cut) -> None:
    assert zig_cut.line == gcc_cut.line
    assert zig_cut.uart == gcc_cut.uart


def test_a_reading_that_differs_shows(library: ct.CDLL, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is compared is the arithmetic: the twin differs where the gap voltage of one millisecond does."""
    millisecond = board_twin.Twin.millisecond

    def changed(self: Any, readings: bytes, line: bytes) -> None:
        data = bytearray(readings)
        if self.ticks == 1500:
            data[10] ^= 0x40  # of the mantissa of gap_v
        millisecond(self, bytes(data), line)

    monkeypatch.setattr(board_twin.Twin, "millisecond", changed)
    cut = board_twin.cut(SECONDS / 2, SEED, None, library)
    assert cut.uart != cut.twin_sent
    assert cut.uart[:1000] == cut.twin_sent[:1000]
