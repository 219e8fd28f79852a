"""Edges of the step pins: TIM10, TIM11 and TIM13 as they count and compare, from one write to the next.

A timer is brought up to the clock before each write to it and at the end of the millisecond; what then stands in it
tells the level of its pin. Period, divider and preloaded compare value act from an update event on (RM0090 §19.3.1,
19.3.8): UG, or the end of a period. A tick that comes late writes late.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .addresses import (
    MODEL_AT,
    TIM10,
    TIM11,
    TIM13,
    TIM_ARR,
    TIM_CCER,
    TIM_CCMR1,
    TIM_CCR1,
    TIM_CR1,
    TIM_EGR,
    TIM_PSC,
    UG,
    word,
)
from .compiling import compiled

if TYPE_CHECKING:
    import numpy as np

CLOCKS_PER_MS = 168_000
# Words of the model for each axis: clock up to which it was followed, count, level of the pin, rising edges; then
# divider, period and compare value that act.
_AT = MODEL_AT + 64
_DONE, _COUNT, _LEVEL, _RISES, _DIVIDER, _PERIOD, _COMPARE = range(7)
_WORDS = 8
TICK_LATE = _AT + 3 * _WORDS
"""Word: clocks of 168 MHz by which the interrupt of this millisecond comes late."""
_ARPE, _OC1PE = 1 << 7, 1 << 3


@compiled
def axis_of(page: int) -> int:
    """Axis whose steps a timer makes, -1 for none."""
    return 0 if page == TIM10 else 1 if page == TIM11 else 2 if page == TIM13 else -1


@compiled
def _look(r: np.ndarray, page: int, at: int) -> None:
    """Level of the pin now: PWM mode 1 is high below the compare value, mode 2 from it on (RM0090 §19.5.6)."""
    mode = r[word(page, TIM_CCMR1)] >> 4 & 7
    below = r[at + _COUNT] < r[at + _COMPARE]
    high = 1 if r[word(page, TIM_CCER)] & 3 == 1 and (below if mode == 6 else mode == 7 and not below) else 0
    if high and not r[at + _LEVEL]:
        r[at + _RISES] += 1
    r[at + _LEVEL] = high


@compiled
def _update(r: np.ndarray, page: int, at: int) -> None:
    """An update event: what was preloaded acts."""
    r[at + _DIVIDER] = r[word(page, TIM_PSC)] + 1
    r[at + _PERIOD] = r[word(page, TIM_ARR)] + 1
    r[at + _COMPARE] = r[word(page, TIM_CCR1)]
    r[at + _COUNT] = 0


@compiled
def follow(r: np.ndarray, page: int, clock: int) -> None:
    """Let a timer count up to a clock of this millisecond."""
    at = _AT + _WORDS * axis_of(page)
    passed = clock - r[at + _DONE]
    if not r[word(page, TIM_CR1)] & 1 or passed <= 0:
        r[at + _DONE] = max(clock, r[at + _DONE])
        return
    length = max(r[at + _DIVIDER], 1) * (2 if page == TIM13 else 1)  # of a count; TIM13 has 84 MHz
    left = passed // length
    r[at + _DONE] += left * length
    while left > 0:
        count, period, compare = r[at + _COUNT], max(r[at + _PERIOD], 1), r[at + _COMPARE]
        goal = compare if count < compare < period else period
        if goal - count > left:
            r[at + _COUNT] += left
            return
        left -= goal - count
        r[at + _COUNT] = goal
        if goal >= period:
            _update(r, page, at)
        _look(r, page, at)


@compiled
def write_step_timer(r: np.ndarray, page: int, offset: int, value: int) -> None:
    """What a write makes of the pin at once; the register holds the value already."""
    at = _AT + _WORDS * axis_of(page)
    if offset == TIM_EGR:
        if value & UG:
            _update(r, page, at)
    elif offset == TIM_ARR and not r[word(page, TIM_CR1)] & _ARPE:
        r[at + _PERIOD] = value + 1
    elif offset == TIM_CCR1 and not r[word(page, TIM_CCMR1)] & _OC1PE:
        r[at + _COMPARE] = value
    _look(r, page, at)


@compiled
def take_steps(r: np.ndarray, page: int) -> int:
    """Rising edges since they were last taken, up to the end of the millisecond; the next one begins."""
    at = _AT + _WORDS * axis_of(page)
    follow(r, page, CLOCKS_PER_MS)
    n = r[at + _RISES]
    r[at + _RISES] = 0
    r[at + _DONE] -= CLOCKS_PER_MS
    return int(n)
