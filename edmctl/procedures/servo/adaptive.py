"""The law of adaptive machining: when to jump, and what to change where jumps are not enough. Moves nothing itself.

The order of remedies is flush, then a wider gap, then longer pauses between pulses (decision 0021). The gap is
judged by the shares of arcs and shorts while it sparks, not during a jump and not for half a second after one.
"""

from __future__ import annotations

import math

from edmctl.dataclasses import dataclass
from edmctl.procedures.run import Args
from edmctl.procedures.servo.pulse_window import PulseWindow
from edmctl.procedures.servo.reference_search import ReferenceSearch
from edmctl.profile.model import Profile
from edmctl.record.rows import RunEvent

EVIDENCE_S = 1.0
"""Arcs and shorts over their high thresholds for so long ask for a jump: 2300 pulses tell 5 % within 0.5 %."""
CLEAN_S = 20.0
"""Below both low thresholds for so long, one remedy is taken back."""
FREEZE_S = 0.5
"""After a jump the gap is not judged for so long: the servo is still finding it."""
LONGEST_SHARE = 4.0
"""Of `jump.period_s`: the longest period in a gap that stays clean. Jumps every 40 s cost less than 0.5 % there."""
SHORTER, LONGER = 0.5, 1.5
PATIENCE = 5
"""So many jumps in a row at the shortest period without success: jumps alone do not help."""
FLUSH_ABOVE = 2.0
"""Times the arcs that an adaptive reference keeps: more ask for a jump."""
SHORT_S = 0.3
"""A short that lasts so long is answered: healthy ones clear within 70 ms."""
MOST_JUMPS = 2
HEALED_S = 10.0
"""After so long without such a short the next one counts as a new one."""


@dataclass(frozen=True, slots=True)
class Change:
    """Something that the law has changed, and why."""

    code: RunEvent
    message: str
    args: Args


class AdaptiveControl:
    """Jump period, servo reference and duty of one cut.

    `period_s` is NaN without jumps; `reference` and `duty` are what machine and generator should have now. `asking`
    holds the shares of arcs and shorts that ask for the next jump, of those over their limits alone; it is empty
    when the clock asks. `changes` collects what was changed until somebody takes it.
    """

    def __init__(self, profile: Profile, start_s: float) -> None:
        jump = profile.jump
        self._jump, self._limits = jump, profile.adaptive
        self._adaptive = jump.mode == "adaptive"
        self._reference_0, self._duty_0 = profile.servo.reference, profile.pulse.duty
        self._last_s = start_s
        self._freeze_s = 0.0
        self._evidence = PulseWindow(EVIDENCE_S)
        self._clean = PulseWindow(CLEAN_S)
        self._since_jump = PulseWindow(math.inf)
        self._in_vain = 0
        self._at_once = ""
        self.asking: dict[str, float] = {}
        self.period_s = math.nan if jump.mode == "off" else jump.period_s
        self.reference, self.duty = self._reference_0, self._duty_0
        self.changes: list[Change] = []
        limits, self._search = profile.adaptive, None
        self._arc_high = limits.arc_high
        if limits.seek_reference:
            self._search = ReferenceSearch(profile, self._highest)
            self._arc_high = max(limits.arc_high, FLUSH_ABOVE * self._search.target)

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
        if self._search:
            self._seek(self._search, duration_s, pulses, arcs, shorts)
        if not self._adaptive:
            return
        for window in (self._evidence, self._clean, self._since_jump):
            window.add(duration_s, pulses, arcs, shorts)
        limits, evidence, clean = self._limits, self._evidence, self._clean
        if evidence.is_full and (evidence.arcs > self._arc_high or evidence.shorts > limits.short_high):
            self._flush(evidence.arcs, evidence.shorts)
        elif clean.is_full and clean.arcs < limits.arc_low and clean.shorts < limits.short_low:
            self._relax(clean.arcs, clean.shorts)

    @property
    def clock_due_s(self) -> float:
        """When the clock asks for the next jump; infinity without jumps."""
        return math.inf if math.isnan(self.period_s) else self._last_s + self.period_s

    def due(self, now_s: float) -> str:
        """Return why to jump now; empty while there is no reason."""
        if self._at_once:
            return self._at_once
        return f"{self.period_s:.3g} s have passed" if now_s >= self.clock_due_s else ""

    @property
    def arcs(self) -> float:
        """Share of arcs since the last jump."""
        return self._since_jump.arcs

    @property
    def shorts(self) -> float:
        """Share of shorts since the last jump."""
        return self._since_jump.shorts

    def jumped(self, now_s: float) -> None:
        """Count the time from here; see whether jumps at the shortest period help."""
        self._last_s = now_s
        self._at_once = ""
        self.asking = {}
        arcs = self._since_jump.arcs
        self._since_jump.clear()
        if not self._adaptive or self.period_s > self._jump.period_min_s or arcs <= self._arc_high:
            self._in_vain = 0
            return
        self._in_vain += 1
        if self._in_vain >= PATIENCE:
            self._in_vain = 0
            self._step_back(
                self._limits.reference_step,
                f"{100 * arcs:.0f} % arcs although it jumps every {self.period_s:g} s",
                {"arcs": arcs, "period_s": self.period_s},
            )

    def soften(self, reference_step: float, duty_share: float, reason: str) -> None:
        """Raise the reference and shorten the duty together, as the answer to a burn."""
        self._set_reference(min(self._highest, self.reference + reference_step), reason, {})
        self._set_duty(max(self._lowest_duty, self.duty * duty_share), reason, {})

    @property
    def _highest(self) -> float:
        return max(self._reference_0, self._limits.reference_max)

    @property
    def _lowest_duty(self) -> float:
        return min(self._duty_0, self._limits.duty_min)

    def _seek(self, search: ReferenceSearch, duration_s: float, pulses: int, arcs: int, shorts: int) -> None:
        reference = search.update(duration_s, pulses, arcs, shorts, self.reference)
        if reference != self.reference:
            reason = (
                f"{100 * search.seen:.1f} % arcs and shorts, and {100 * search.target:.1f} % remove the most"
            )
            self._set_reference(round(reference, 3), reason, {"arcs": search.seen})

    def _flush(self, arcs: float, shorts: float) -> None:
        seen = f"{100 * arcs:.1f} % arcs and {100 * shorts:.1f} % shorts in the last {EVIDENCE_S:g} s"
        self._at_once = seen
        limits = {"arcs": self._arc_high, "shorts": self._limits.short_high}
        shares = {"arcs": arcs, "shorts": shorts}
        self.asking = {name: share for name, share in shares.items() if share > limits[name]}
        self._evidence.clear()
        self._clean.clear()
        self._set_period(max(self._jump.period_min_s, SHORTER * self.period_s), seen, arcs, shorts)

    def _relax(self, arcs: float, shorts: float) -> None:
        """Take back the last remedy first."""
        seen = f"only {100 * arcs:.1f} % arcs and {100 * shorts:.1f} % shorts in {CLEAN_S:g} s"
        args: Args = {"arcs": arcs, "shorts": shorts}
        self._clean.clear()
        if self.duty < self._duty_0:
            self._set_duty(min(self._duty_0, self.duty / (1.0 - self._limits.duty_step)), seen, args)
        elif self._search is None and self.reference > self._reference_0:
            reference = max(self._reference_0, self.reference - self._limits.reference_step)
            self._set_reference(reference, seen, args)
        else:
            longest_s = LONGEST_SHARE * self._jump.period_s
            self._set_period(min(longest_s, LONGER * self.period_s), seen, arcs, shorts)

    def _step_back(self, reference_step: float, reason: str, args: Args) -> None:
        """A wider gap first, then longer pauses."""
        if self._search is None and self.reference < self._highest and reference_step > 0.0:
            self._set_reference(min(self._highest, self.reference + reference_step), reason, args)
        else:
            duty = max(self._lowest_duty, self.duty * (1.0 - self._limits.duty_step))
            self._set_duty(duty, reason, args)

    def _set_period(self, period_s: float, reason: str, arcs: float, shorts: float) -> None:
        if period_s == self.period_s:
            return
        args = {"from_s": self.period_s, "to_s": period_s, "arcs": arcs, "shorts": shorts}
        self._note(
            RunEvent.JUMP_PERIOD, f"Jump period {self.period_s:.3g} → {period_s:.3g} s: {reason}.", args
        )
        self.period_s = period_s

    def _set_reference(self, reference: float, reason: str, args: Args) -> None:
        if reference == self.reference:
            return
        message = f"Servo reference {self.reference:.3g} → {reference:.3g}: {reason}."
        self._note(RunEvent.REFERENCE_CHANGED, message, {"from": self.reference, "to": reference, **args})
        self.reference = reference

    def _set_duty(self, duty: float, reason: str, args: Args) -> None:
        if duty == self.duty:
            return
        message = f"Duty {self.duty:.3g} → {duty:.3g}: {reason}."
        self._note(RunEvent.DUTY_CHANGED, message, {"from": self.duty, "to": duty, **args})
        self.duty = duty

    def _note(self, code: RunEvent, message: str, args: Args) -> None:
        self.changes.append(Change(code, message, args))


class ShortRecovery:
    """Counts how long every pulse has been a short, and the jumps made for it."""

    def __init__(self) -> None:
        self._shorted_s = 0.0
        self._healthy_s = 0.0
        self.jumps = 0

    def update(self, duration_s: float, pulses: int, shorts: int, *, sparking: bool) -> None:
        """Judge a slice."""
        if not sparking or pulses == 0:
            return
        if shorts == pulses:
            self._shorted_s += duration_s
            self._healthy_s = 0.0
            return
        self._shorted_s = 0.0
        self._healthy_s += duration_s
        if self._healthy_s > HEALED_S:
            self.jumps = 0

    def due(self) -> str:
        """Return why to jump now; empty while there is no reason, or when it has been tried often enough."""
        if self._shorted_s < SHORT_S - 1e-6 or self.jumps >= MOST_JUMPS:
            return ""
        return f"a short has lasted {self._shorted_s:.1f} s"

    def jumped(self) -> None:
        """Count the jump that was made."""
        self._shorted_s = 0.0
        self.jumps += 1
