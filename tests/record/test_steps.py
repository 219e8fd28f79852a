"""Columns that are stored in steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.record import layout
from edmctl.record.reader import open_run
from edmctl.record.writer import RunWriter
from tests.record.samples import train

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.record.rows import RunMeta


def test_pulses_that_wait_while_whole_chunks_are_written_keep_their_values(
    tmp_path: Path, meta: RunMeta
) -> None:
    """A long train fills chunks and leaves a rest, which is written by the next flush."""
    pulses = 2 * layout.PULSES.chunk_rows + 1000
    writer = RunWriter.create(tmp_path / "run.h5", meta, monotonic_s=lambda: 0.0)
    values = train(0, pulses, 0.0)
    delay_us = values.delay_us % 130.0
    writer.append(
        type(values)(0, 0.0, 4e-4, values.pulse_class, delay_us, 130.0 - delay_us, values.plateau_v)
    )
    with open_run(writer.finish("done", 0)) as run:
        read = run.columns(layout.PULSES.path)
    assert read["td"] == pytest.approx(delay_us, abs=0.051)
    assert read["te"] == pytest.approx(130.0 - delay_us, abs=0.051)
    assert np.all(read["u"] == 22.5)
