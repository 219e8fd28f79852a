"""The person at a virtual machine: hands are injections, eyes look at the plant; what is allowed is still asked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from edmctl.board.first_start.person import Act, Asked, Done, Question
from edmctl.link.messages import Axis
from edmctl.simulator import VirtualBench
from edmctl.simulator.injection import parse_injection
from edmctl.simulator.injector import BATTERY_V, LOW_BATTERY_V

BEFORE = "+HV_SUPPLY +AMPLIFIER_DEAD"
"""What a machine is at first: both supplies off."""
BATTERIES = {"battery-volts": str(BATTERY_V), "low-battery-volts": str(LOW_BATTERY_V)}

_LOOKED_AT = {"x-direction": Axis.X, "y-direction": Axis.Y, "theta-direction": Axis.THETA}
_MOVED = (100.0, 100.0, 1.0)  # µm, µm and degrees: more than a stage's repeatability


class ProgramHands:
    """Acts on a virtual machine by `do`, which gets each change; `asked` allows steps and sees the stages."""

    def __init__(self, asked: Asked, do: Callable[[str], None]) -> None:
        self._asked, self._do = asked, do
        self._change(BEFORE)

    def act(self, act: Act) -> Done:
        """Do it, unless the answers leave it out."""
        done = self._asked.act(act) if self._asked.has_answered(act.key) else Done.DONE
        if done is Done.DONE:
            self._change(act.changes)
        return done

    def answer(self, question: Question) -> str:
        """Return the voltage of a battery unless the answers have it; ask for everything else."""
        if question.key in BATTERIES and not self._asked.has_answered(question.key):
            return BATTERIES[question.key]
        return self._asked.answer(question)

    def _change(self, changes: str) -> None:
        for change in changes.split():
            self._do(change)


class VirtualHands(ProgramHands):
    """Acts on a virtual machine in this process, and looks at its stages."""

    def __init__(self, bench: VirtualBench, asked: Asked) -> None:
        def do(change: str) -> None:
            if change[0] == "+":
                bench.inject(parse_injection(f"{change[1:]}@0"))
            else:
                bench.controller.injector.mend(change[1:])

        self._plant = bench.plant
        self._places: list[float] = []
        super().__init__(asked, do)

    def answer(self, question: Question) -> str:
        """Look which way a stage has moved unless the answers tell."""
        if question.key == "stages":
            self._places = self._now()
        if question.key not in _LOOKED_AT or self._asked.has_answered(question.key):
            return super().answer(question)
        axis = _LOOKED_AT[question.key]
        ways = [new - old for new, old in zip(self._now(), self._places, strict=True)]
        moved = [abs(way) >= least for way, least in zip(ways, _MOVED, strict=True)]
        if not moved[axis]:
            return "other" if any(moved) else "none"
        return "plus" if ways[axis] > 0.0 else "minus"

    def _now(self) -> list[float]:
        return [*map(float, self._plant.position_um), self._plant.theta_deg]


def written_hands(path: Path, asked: Asked) -> ProgramHands:
    """Return hands at a served virtual machine, by the file that `edmctl simulate serve --acts` reads."""

    def do(change: str) -> None:
        with path.open("a", encoding="ascii") as acts:
            acts.write(f"{change}\n")

    return ProgramHands(asked, do)
