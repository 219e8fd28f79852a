"""A bench under the core: kept in a file and taken up, several in one process, cutting as the other does."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.errors import RunFileError
from edmctl.link import messages as m
from edmctl.link.frame import encode_frame
from edmctl.simulator import BenchConfig, firmware_controller, open_bench
from edmctl.simulator.saving import bench_state, restored_bench
from tests.firmware.cuts import cut
from tests.tiers import tiers

if TYPE_CHECKING:
    from edmctl.core.build import Build


@pytest.mark.parametrize("frequency_hz", [2300.0, 50_000.0])
@pytest.mark.parametrize("seconds", tiers(2.0, slow=(60.0,)))
def test_a_cut_is_the_same_to_the_last_byte(core: Build, seconds: float, frequency_hz: float) -> None:
    lines = bytearray(), bytearray()
    benches = [
        cut(kind, seconds, frequency_hz, heard=heard)
        for kind, heard in zip(("python", "firmware"), lines, strict=True)
    ]
    assert lines[0] == lines[1]
    assert benches[0].controller.state is m.State.MACHINING
    assert benches[0].plant.state.depth_um > 0.1
    assert bytes(benches[0].plant.state) == bytes(benches[1].plant.state)


def test_two_cores_in_one_process_know_nothing_of_each_other(core: Build) -> None:
    one, other = cut("firmware", 0.2), cut("firmware", 0.2, seed=3)
    before = bytes(one.plant.state)
    other.controller.advance(500)
    assert bytes(one.plant.state) == before
    assert one.controller.state is m.State.MACHINING
    assert other.controller.fault == 1001


def test_a_bench_that_was_kept_goes_on_as_the_one_that_was_not(core: Build) -> None:
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


def test_a_latched_fault_and_its_records_are_kept(core: Build) -> None:
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


def test_frames_that_do_not_fit_are_not_lost_in_silence(core: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    """Given more bytes at once than it ever is, the core answers more than its memory of the line holds."""
    controller = open_bench(BenchConfig(controller="firmware"), 1).controller
    asked = encode_frame(m.GetSchema.ID, 1, 9, 0, m.GetSchema(0).pack()) * 2000
    controller.receive(asked)
    assert len(controller.link.take_output()) > 2000 * 243  # of each page
    monkeypatch.setattr(firmware_controller, "MOST_AT_ONCE", len(asked))
    with pytest.raises(RuntimeError, match="frames of the core did not fit"):
        controller.receive(asked)


def test_a_bench_of_another_firmware_is_refused(core: Build) -> None:
    state = dict(bench_state(cut("firmware", 0.1)))
    state["controller"] = {**state["controller"], "sources": "another"}  # type: ignore[dict-item]
    with pytest.raises(RunFileError, match="another build of the firmware's core") as caught:
        restored_bench(state)
    assert caught.value.code == "E9021"
