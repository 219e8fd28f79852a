"""Adaptive control of a cut: when to jump, and what to change if jumps are not enough. It moves nothing itself.

The order of remedies is flush, then a wider gap, then longer pauses between pulses (decision 0021). Shares of arcs
and shorts count while it sparks, not during a jump and shortly after. An adaptive servo reference follows the share
of arcs: a lower reference ignites more pulses and fills the gap with debris, which makes arcs that remove little.
The best reference depends on flushing and depth; the share of arcs at it does not (decision 0043).
"""

from __future__ import annotations

import math
from collections import deque

from edmctl.dataclasses import dataclass
from edmctl.planning.removal import REFERENCE_MARGIN
from edmctl.procedures.run import Args
from edmctl.profile.model import Profile
from edmctl.record.rows import RunEvent

EVIDENCE_S = 1.0  # arcs or shorts over their limit for this long cause a jump: 2300 pulses, 5 ± 0.5 %
CLEAN_S = 20.0  # below both low thresholds for this long, one remedy is taken back
FREEZE_S = 0.5  # after a jump nothing counts for this long: the servo is still finding the gap
LONGEST_SHARE = 4.0  # longest period in a clean gap, times `jump.period_s`: costs less than 0.5 %
SHORTER, LONGER = 0.5, 1.5
PATIENCE = 5  # jumps in a row at the shortest period without success, after which jumps alone do not help
FLUSH_ABOVE = 2.0  # arcs that cause a jump, relative to those that an adaptive reference keeps
SHORT_S = 0.3  # a short that lasts this long causes a jump: healthy ones clear within 70 ms
MOST_JUMPS = 2
HEALED_S = 10.0  # after this time without such a short the next one counts as a new one


WINDOW_S = 4.0  # arcs are counted over this time before the reference changes: 9000 pulses show 8 ± 0.3 %
DEAD_BAND = 0.12  # relative difference from the target without a change: costs less than 1 % of the removal
GAIN = 0.06  # change of the reference for twice the arcs, relative to the span from all-sparking to all-open
LARGEST_STEP = 0.06


class PulseWindow:
    """Shares of arcs and shorts over the newest `length_s` of what was added."""

    def __init__(self, length_s: float) -> None:
        self._length_s = length_s
        self.clear()

    def clear(self) -> None:
        self._parts: deque[tuple[float, int, int, int]] = deque()
        self._span_s = 0.0
        self._pulses = self._arcs = self._shorts = 0

    def add(self, duration_s: float, pulses: int, arcs: int, shorts: int) -> None:
        self._parts.append((duration_s, pulses, arcs, shorts))
        self._count(duration_s, pulses, arcs, shorts)
        while self._span_s - self._parts[0][0] >= self._length_s - 1e-6:
            old_s, *old = self._parts.popleft()
            self._count(-old_s, *(-count for count in old))

    def _count(self, duration_s: float, pulses: int, arcs: int, shorts: int) -> None:
        self._span_s += duration_s
        self._pulses += pulses
        self._arcs += arcs
        self._shorts += shorts

    @property
    def is_full(self) -> bool:
        return self._span_s >= self._length_s - 1e-6

    @property
    def arcs(self) -> float:
        return self._arcs / self._pulses if self._pulses else 0.0

    @property
    def shorts(self) -> float:
        return self._shorts / self._pulses if self._pulses else 0.0


class ReferenceSearch:
    """The servo reference by the arcs and shorts of the last seconds: `target` share, and the `seen` one."""

    def __init__(self, profile: Profile, highest: float) -> None:
        assert profile.adaptive.arc_target is not None, "a loaded profile has it"
        self.target = profile.adaptive.arc_target
        self.seen = math.nan
        self._span = 1.0 - profile.pulse.rho
        self._lowest, self._highest = profile.pulse.rho + REFERENCE_MARGIN, highest
        self._window = PulseWindow(WINDOW_S)

    def update(self, duration_s: float, pulses: int, arcs: int, shorts: int, reference: float) -> float:
        """Take a slice of sparking; return the next reference. Shorts count as arcs: the gap is too small."""
        self._window.add(duration_s, pulses, arcs, shorts)
        if not self._window.is_full:
            return reference
        self.seen = self._window.arcs + self._window.shorts
        self._window.clear()
        off = math.log(max(self.seen, 0.1 * self.target) / self.target)
        if abs(off) < DEAD_BAND:
            return reference
        step = min(max(GAIN * off / math.log(2.0), -LARGEST_STEP), LARGEST_STEP) * self._span
        return min(max(reference + step, self._lowest), self._highest)


@dataclass(frozen=True, slots=True)
class Change:
    """A changed setting, and why."""

    code: RunEvent
    message: str
    args: Args


_SETTINGS = {
    "period_s": (RunEvent.JUMP_PERIOD, "Jump period", "_s"),
    "reference": (RunEvent.REFERENCE_CHANGED, "Servo reference", ""),
    "duty": (RunEvent.DUTY_CHANGED, "Duty", ""),
}
"""What the adaptive control changes: event, name, and suffix of its unit."""


class AdaptiveControl:
    """Jump period, servo reference and duty of one cut.

    `period_s` is NaN without jumps. `asking` has the shares of arcs and shorts that cause the next jump, none if the
    period does. `since_jump` has the pulses since the last jump, `changes` the changes until they are carried out.
    """

    def __init__(self, profile: Profile, start_s: float) -> None:
        jump = profile.jump
        self._jump, self._limits = jump, profile.adaptive
        self._adaptive = jump.mode == "adaptive"
        self._reference_0, self._duty_0 = profile.servo.reference, profile.pulse.duty
        self._last_s, self._freeze_s = start_s, 0.0
        self._evidence, self._clean = PulseWindow(EVIDENCE_S), PulseWindow(CLEAN_S)
        self.since_jump = PulseWindow(math.inf)
        self._in_vain, self._at_once = 0, ""
        self.asking: dict[str, float] = {}
        self.period_s = math.nan if jump.mode == "off" else jump.period_s
        self.reference, self.duty = self._reference_0, self._duty_0
        self.changes: list[Change] = []
        self._search, self._arc_high = None, self._limits.arc_high
        if self._limits.seek_reference:
            self._search = ReferenceSearch(profile, self._highest)
            self._arc_high = max(self._arc_high, FLUSH_ABOVE * self._search.target)

    def update(self, duration_s: float, pulses: int, arcs: int, shorts: int, *, sparking: bool) -> None:
        """Judge a slice; `sparking` is False during jumps."""
        if not (self._adaptive or self._search):
            return
        if not sparking:
            self._freeze_s = FREEZE_S
            self._evidence.clear()
            return
        if self._freeze_s > 0.0:
            self._freeze_s -= duration_s
            return
        if search := self._search:
            reference = search.update(duration_s, pulses, arcs, shorts, self.reference)
            if reference != self.reference:
                seen, target = 100 * search.seen, 100 * search.target
                reason = f"{seen:.1f} % arcs and shorts, and {target:.1f} % remove the most"
                self._change("reference", round(reference, 3), reason, {"arcs": search.seen})
        if not self._adaptive:
            return
        for window in (self._evidence, self._clean, self.since_jump):
            window.add(duration_s, pulses, arcs, shorts)
        limits, evidence, clean = self._limits, self._evidence, self._clean
        if evidence.is_full and (evidence.arcs > self._arc_high or evidence.shorts > limits.short_high):
            self._flush(evidence.arcs, evidence.shorts)
        elif clean.is_full and clean.arcs < limits.arc_low and clean.shorts < limits.short_low:
            self._relax(clean.arcs, clean.shorts)

    @property
    def clock_due_s(self) -> float:
        """When the next periodic jump is due; infinity without jumps."""
        return math.inf if math.isnan(self.period_s) else self._last_s + self.period_s

    def due(self, now_s: float) -> str:
        """Return the reason to jump now; empty without one."""
        if self._at_once:
            return self._at_once
        return f"{self.period_s:.3g} s have passed" if now_s >= self.clock_due_s else ""

    def jumped(self, now_s: float) -> None:
        self._last_s = now_s
        self._at_once = ""
        self.asking = {}
        arcs = self.since_jump.arcs
        self.since_jump.clear()
        if not self._adaptive or self.period_s > self._jump.period_min_s or arcs <= self._arc_high:
            self._in_vain = 0
            return
        self._in_vain += 1
        if self._in_vain >= PATIENCE:
            self._in_vain = 0
            reason = f"{100 * arcs:.0f} % arcs although it jumps every {self.period_s:g} s"
            args: Args = {"arcs": arcs, "period_s": self.period_s}
            step = self._limits.reference_step
            # A wider gap first, then longer pauses.
            if self._search is None and self.reference < self._highest and step > 0.0:
                self._change("reference", min(self._highest, self.reference + step), reason, args)
            else:
                duty = max(self._lowest_duty, self.duty * (1.0 - self._limits.duty_step))
                self._change("duty", duty, reason, args)

    def soften(self, reference_step: float, duty_share: float, reason: str) -> None:
        """Raise the reference and reduce the duty, after a burn."""
        self._change("reference", min(self._highest, self.reference + reference_step), reason, {})
        self._change("duty", max(self._lowest_duty, self.duty * duty_share), reason, {})

    @property
    def _highest(self) -> float:
        return max(self._reference_0, self._limits.reference_max)

    @property
    def _lowest_duty(self) -> float:
        return min(self._duty_0, self._limits.duty_min)

    def _flush(self, arcs: float, shorts: float) -> None:
        shares = {"arcs": arcs, "shorts": shorts}
        limits = {"arcs": self._arc_high, "shorts": self._limits.short_high}
        seen = f"{100 * arcs:.1f} % arcs and {100 * shorts:.1f} % shorts"
        self._at_once = f"{seen} in the last {EVIDENCE_S:g} s"
        self.asking = {name: share for name, share in shares.items() if share > limits[name]}
        self._evidence.clear()
        self._clean.clear()
        period_s = max(self._jump.period_min_s, SHORTER * self.period_s)
        self._change("period_s", period_s, self._at_once, shares)

    def _relax(self, arcs: float, shorts: float) -> None:
        seen = f"only {100 * arcs:.1f} % arcs and {100 * shorts:.1f} % shorts in {CLEAN_S:g} s"
        args: Args = {"arcs": arcs, "shorts": shorts}
        self._clean.clear()
        if self.duty < self._duty_0:
            self._change("duty", min(self._duty_0, self.duty / (1.0 - self._limits.duty_step)), seen, args)
        elif self._search is None and self.reference > self._reference_0:
            reference = max(self._reference_0, self.reference - self._limits.reference_step)
            self._change("reference", reference, seen, args)
        else:
            longest_s = LONGEST_SHARE * self._jump.period_s
            self._change("period_s", min(longest_s, LONGER * self.period_s), seen, args)

    def _change(self, name: str, value: float, reason: str, args: Args) -> None:
        before = getattr(self, name)
        if value == before:
            return
        code, label, unit = _SETTINGS[name]
        message = f"{label} {before:.3g} → {value:.3g}{unit.replace('_', ' ')}: {reason}."
        self.changes.append(Change(code, message, {f"from{unit}": before, f"to{unit}": value, **args}))
        setattr(self, name, value)


class ShortRecovery:
    """How long every pulse has been a short, and the number of jumps made for it."""

    def __init__(self) -> None:
        self._shorted_s = self._healthy_s = 0.0
        self.jumps = 0

    def update(self, duration_s: float, pulses: int, shorts: int, *, sparking: bool) -> None:
        if not sparking or pulses == 0:
            return
        if shorts == pulses:
            self._shorted_s, self._healthy_s = self._shorted_s + duration_s, 0.0
            return
        self._shorted_s, self._healthy_s = 0.0, self._healthy_s + duration_s
        if self._healthy_s > HEALED_S:
            self.jumps = 0

    def due(self) -> str:
        """Return the reason to jump now; empty without one, and after enough jumps."""
        if self._shorted_s < SHORT_S - 1e-6 or self.jumps >= MOST_JUMPS:
            return ""
        return f"a short has lasted {self._shorted_s:.1f} s"

    def jumped(self) -> None:
        self._shorted_s = 0.0
        self.jumps += 1
