"""Edges of the pulses: begin of the gate, ignition and end of the current, captured by TIM2 and TIM5."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.simulator.plant_records import SCOPE_PULSES, TICK_NS

from .addresses import (
    DMA1,
    PORT_A,
    TIM2,
    TIM5,
    TIM_CCER,
    TIM_CCMR1,
    TIM_CCMR2,
    TIM_CCR1,
    TIM_CCR2,
    TIM_CCR4,
    TIM_CR1,
    TIM_DIER,
    address,
    word,
)
from .circuit import QUEUE
from .compiling import compiled
from .dma import put
from .pins import pin_is
from .registers import BASE_84

if TYPE_CHECKING:
    import numpy as np

    from edmctl.simulator.plant_records import Readings, Scope

    from .circuit import Bench

GATE_SENSE_AT = address(TIM5, TIM_CCR4)
_IGNITION_AT, _END_AT = address(TIM2, TIM_CCR1), address(TIM2, TIM_CCR2)
_CC1DE, _CC2DE, _CC4DE = 1 << 9, 1 << 10, 1 << 12  # requests of TIM_DIER


@compiled
def take_pulses(bench: Bench, scope: Scope, readings: Readings) -> None:
    """Queue the edges of the pulses that the plant has struck in this millisecond."""
    for k in range(readings.pulses):
        at = (scope.at - readings.pulses + k) & (SCOPE_PULSES - 1)
        place = bench.queue_head & (QUEUE - 1)
        start = scope.start_ns[at]
        bench.start_ns[place] = start
        lit = scope.discharge_us[at] > 0.0
        bench.ignition_ns[place] = start + scope.delay_us[at] * 1e3 if lit else -1.0
        bench.end_ns[place] = start + (scope.delay_us[at] + scope.discharge_us[at]) * 1e3
        bench.queue_head += 1


@compiled
def _stamp(r: np.ndarray, after_ns: float) -> int:
    """Count of the capturing timers so long after the begin of the millisecond."""
    return int((r[BASE_84] + int(after_ns * 0.084)) & 0xFFFFFFFF)


@compiled
def _put_chatter(
    r: np.ndarray, memory: np.ndarray, bench: Bench, place: int, first_ns: float, stream: int, source: int
) -> None:
    """Edges of a comparator that chatters within the discharge of a pulse, evenly from `first_ns` on."""
    step = (bench.end_ns[place] - bench.ignition_ns[place]) / (bench.comparator_chatters + 1)
    for k in range(bench.comparator_chatters):
        put(r, memory, DMA1, stream, 3, source, 4, _stamp(r, first_ns + k * step))


@compiled
def send_edges(r: np.ndarray, memory: np.ndarray, bench: Bench, begin_ns: float) -> None:
    """Captures of TIM2 and TIM5 that fall into the millisecond that begins at `begin_ns` (RM0090 §18.3.5).

    Of a pulse that was cut off at `bench.off_ns`, what would have come later does not come, and the end comes then.
    """
    end_ns = begin_ns + TICK_NS
    starts = (
        r[word(TIM5, TIM_CR1)] & 1
        and r[word(TIM5, TIM_CCER)] >> 12 & 11 == 1
        and r[word(TIM5, TIM_CCMR2)] >> 8 & 3 == 1
        and r[word(TIM5, TIM_DIER)] & _CC4DE
        and pin_is(r, PORT_A, 3, 2, 2)
    )
    edges = (
        r[word(TIM2, TIM_CR1)] & 1
        and r[word(TIM2, TIM_CCER)] & 0xBB == 0x31
        and r[word(TIM2, TIM_CCMR1)] & 0x303 == 0x201
        and pin_is(r, PORT_A, 0, 2, 1)
    )
    requests = r[word(TIM2, TIM_DIER)]
    while bench.starts_at < bench.queue_head:
        t = bench.start_ns[bench.starts_at & (QUEUE - 1)]
        if t >= end_ns:
            break
        if starts:
            put(r, memory, DMA1, 3, 6, GATE_SENSE_AT, 4, _stamp(r, t - begin_ns))
        bench.starts_at += 1
    while bench.ignitions_at < bench.queue_head:
        place = bench.ignitions_at & (QUEUE - 1)
        t = bench.ignition_ns[place]
        if t >= end_ns or (t < 0.0 and bench.start_ns[place] >= end_ns):
            break
        if t >= 0.0 and edges and requests & _CC1DE and not (bench.start_ns[place] < bench.off_ns <= t):
            put(r, memory, DMA1, 5, 3, _IGNITION_AT, 4, _stamp(r, t - begin_ns))
            _put_chatter(r, memory, bench, place, t - begin_ns + 200.0, 5, _IGNITION_AT)
        bench.ignitions_at += 1
    while bench.ends_at < bench.queue_head:
        place = bench.ends_at & (QUEUE - 1)
        t = bench.end_ns[place]
        if bench.start_ns[place] < bench.off_ns < t:
            t = max(bench.off_ns, begin_ns)
        if t >= end_ns or bench.start_ns[place] >= end_ns:
            break
        if (
            bench.ignition_ns[place] >= 0.0
            and edges
            and requests & _CC2DE
            and not (bench.start_ns[place] < bench.off_ns <= bench.ignition_ns[place])
        ):
            first_ns = bench.ignition_ns[place] - begin_ns + 100.0
            _put_chatter(r, memory, bench, place, first_ns, 6, _END_AT)
            put(r, memory, DMA1, 6, 3, _END_AT, 4, _stamp(r, t - begin_ns))
        bench.ends_at += 1
