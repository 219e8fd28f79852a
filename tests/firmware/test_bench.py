"""A bench under the core: kept in a file and taken up, several in one process, in both arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

from edmctl.link import messages as m
from edmctl.link.frame import encode_frame
from edmctl.simulator import BenchConfig, open_bench
from edmctl.simulator.saving import bench_state, restored_bench
from tests.firmware.cuts import cut


def test_two_cores_in_one_process_know_nothing_of_each_other() -> None:
    one, other = cut("firmware", 0.2), cut("firmware", 0.2, seed=3)
    before = bytes(one.plant.state)
    other.controller.advance(500)
    assert bytes(one.plant.state) == before
    assert one.controller.state is m.State.MACHINING
    assert other.controller.fault == 1001


def test_a_bench_that_was_kept_goes_on_as_the_one_that_was_not() -> None:
    bench = cut("firmware", 0.5)
    boots = bench.controller.boot_count
    again = restored_bench(bench_state(bench))
    twin = restored_bench(bench_state(bench))
    assert bench.controller.state is m.State.MACHINING
    assert (again.controller.state, again.controller.boot_count) == (m.State.IDLE, boots + 1)
    assert again.plant.state.depth_um == bench.plant.state.depth_um
    for each in (again, twin):
        each.controller.advance(100)
    assert bytes(again.plant.state) == bytes(twin.plant.state)


def test_a_latched_fault_and_its_records_are_kept() -> None:
    bench = cut("firmware", 0.5)
    bench.controller.advance(500)
    assert bench.controller.fault == 1001
    again = restored_bench(bench_state(bench))
    assert (again.controller.fault, again.controller.state) == (1001, m.State.FAULT)
    assert again.controller.black_box.frozen_tick == bench.controller.black_box.frozen_tick
    frozen, kept = bench.controller.waveforms.frozen, again.controller.waveforms.frozen
    assert frozen is not None
    assert kept is not None
    assert np.array_equal(frozen.rows.view(np.float64), kept.rows.view(np.float64))


def test_frames_that_do_not_fit_are_not_lost_in_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Given more bytes at once than it ever is, the core answers more than its memory of the line holds."""
    controller = open_bench(BenchConfig(), 1).controller
    asked = encode_frame(m.GetSchema.ID, 1, 9, 0, m.GetSchema(0).pack()) * 2000
    controller.receive(asked)
    assert len(controller.link.take_output()) > 2000 * 243  # of each page
    monkeypatch.setattr("edmctl.simulator.controller.MOST_AT_ONCE", len(asked))
    with pytest.raises(RuntimeError, match="frames of the core did not fit"):
        controller.receive(asked)


def test_float_arithmetic_cuts_as_deep() -> None:
    """A board calculates in float: what is chaotic about sparks comes out otherwise, what counts does not."""
    exact, board = cut("firmware", 4.0), cut("firmware-float", 4.0)
    assert board.controller.state is exact.controller.state is m.State.MACHINING
    assert board.plant.state.depth_um == pytest.approx(exact.plant.state.depth_um, rel=0.05)
    assert board.controller.seen.pulse_no == exact.controller.seen.pulse_no
