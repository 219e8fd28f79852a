"""A bench under the core: what its line holds, and float beside double."""

from __future__ import annotations

import pytest

from edmctl.link import messages as m
from edmctl.link.frame import encode_frame
from edmctl.simulator import BenchConfig, open_bench
from tests.firmware.cuts import cut


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
