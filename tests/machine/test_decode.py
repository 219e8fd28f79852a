"""Wire records as columns: joined frames, exact gaps, pauses between pulses."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest

from edmctl.link.messages import PulseBlocks, PulseLog, Pulses, Tlm
from edmctl.link.session import Session
from edmctl.link.transport import MergedTlm
from edmctl.machine.decode import pulse_batches, pulse_block_batch, telemetry_block
from edmctl.machine.inbox import SampleStream
from edmctl.machine.interface import TelemetrySettings
from edmctl.simulator import BenchConfig, open_bench


def open_session() -> Session:
    session = Session(open_bench(BenchConfig(), 1).transport, Random(1))
    session.open()
    return session


def seconds(t_us: int) -> float:
    return 1e-6 * t_us


def a_tlm(counter: int, t0_us: int, z_um: list[float]) -> Tlm:
    rows = np.zeros(len(z_um), Tlm.record_dtype())
    rows["displacement_um"] = np.round(1000.0 * np.array(z_um))
    rows["actuator_v"] = 400
    rows["gap_v"] = 1920
    rows["n_arc"] = 2
    return Tlm(counter, t0_us, 10_000, len(z_um), 0, rows.tobytes())


def some_pulses(pulse_no: int, t0_us: int, n: int) -> Pulses:
    rows = np.zeros(n, Pulses.record_dtype())
    rows["delay_us"] = 123
    rows["plateau_v"] = 44
    return Pulses(0, pulse_no, t0_us, 434_783, n, rows.tobytes())


def test_frames_joined_give_the_columns_of_the_frames_one_by_one() -> None:
    frames = [a_tlm(7, 1_000_000, [1.5, -2.25]), a_tlm(8, 1_020_000, [3.0])]
    block = telemetry_block(frames, seconds, 0)
    assert block.time_s == pytest.approx([1.0, 1.01, 1.02])
    assert block.displacement_um == pytest.approx([1.5, -2.25, 3.0])
    assert block.actuator_v == pytest.approx([1.0, 1.0, 1.0])
    assert block.gap_v == pytest.approx([9.6, 9.6, 9.6])
    assert block.n_arc.tolist() == [2, 2, 2]


def test_times_follow_each_frame_and_not_the_first_alone() -> None:
    block = telemetry_block([a_tlm(1, 0, [0.0, 0.0]), a_tlm(3, 500_000, [0.0])], seconds, 1)
    assert block.time_s == pytest.approx([0.0, 0.01, 0.5])


@pytest.mark.parametrize(
    ("previous", "counters", "lost"),
    [(None, [5, 6, 7], 0), (4, [5], 0), (4, [7, 9], 3), (0xFFFF, [0], 0), (0xFFFE, [1], 2)],
)
def test_lost_frames_are_counted_across_the_wrap(
    previous: int | None, counters: list[int], lost: int
) -> None:
    def tlm(counter: int) -> Tlm:
        return a_tlm(counter, (counter + 10) % (1 << 16) * 20_000, [0.0, 0.0])

    stream = SampleStream(open_session())
    stream.begin(TelemetrySettings(10_000, 2, PulseLog.OFF))
    if previous is not None:
        assert stream.wrong([tlm(previous)]) == ""
    assert stream.wrong([tlm(counter) for counter in counters]) == ""
    assert stream.missing == lost


def test_frames_that_were_merged_are_judged_as_one_by_one() -> None:
    stream = SampleStream(open_session())
    stream.begin(TelemetrySettings(10_000, 2, PulseLog.OFF))
    rows = a_tlm(0, 0, 6 * [1.0]).records
    assert stream.wrong([MergedTlm(7, 0, 10_000, 6, 0, rows, 3)]) == ""
    assert stream.missing == 0
    assert stream.wrong([a_tlm(9, 80_000, [1.0, 1.0])]) == ""
    assert stream.missing == 1
    assert "TLM with 6 samples" in stream.wrong([MergedTlm(12, 100_000, 10_000, 6, 0, rows, 2)])


def test_a_pause_between_pulses_begins_a_new_train() -> None:
    first, second = some_pulses(0, 0, 10), some_pulses(10, 4348, 10)
    after_a_jump = some_pulses(20, 900_000, 5)
    trains = pulse_batches([first, second, after_a_jump], seconds)
    assert [(train.first_pulse, len(train.pulse_class)) for train in trains] == [(0, 20), (20, 5)]
    assert trains[1].start_s == pytest.approx(0.9)
    assert trains[0].delay_us[0] == pytest.approx(12.3)
    assert trains[0].plateau_v[0] == pytest.approx(22.0)


def test_pulse_sums_keep_their_units_and_times() -> None:
    rows = np.zeros(2, PulseBlocks.record_dtype())
    rows["energy_uj"] = 52_345
    rows["n_normal"] = 20
    batch = pulse_block_batch([PulseBlocks(0, 46, 2_000_000, 434_783, 23, 2, rows.tobytes())], seconds)
    assert batch.energy_uj == pytest.approx([5234.5, 5234.5])
    assert batch.time_s == pytest.approx([2.0, 2.0 + 23 * 434.783e-6])
    assert batch.n_normal.tolist() == [20, 20]
