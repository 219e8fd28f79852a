"""Faults of the machine, whether the controller or the host detects them: the rows of faults.toml."""

from __future__ import annotations

import tomllib
from pathlib import Path

from edmctl.dataclasses import dataclass
from edmctl.errors import stages_by_hand
from edmctl.link.messages import FaultCode

__all__ = ["FAULTS", "FaultCode", "FaultRow"]


@dataclass(frozen=True, slots=True)
class FaultRow:
    """One fault; faults.toml explains the fields. Codes from 7000 on never leave the host.

    A name in braces in `message` stands for the value of that parameter.
    """

    name: str
    code: int
    detect: str
    message: str
    hint: str
    pulses_off_s: float
    inject: str
    who: str = "controller"
    reaction: str = "retract to 0 V, hold, latch"
    exit_code: int = 6
    error: str = ""

    @property
    def latched(self) -> bool:
        """Whether the controller holds it until CLEAR_FAULT names it."""
        return self.who != "host"


def _rows() -> dict[int, FaultRow]:
    table = tomllib.loads(Path(__file__).with_name("faults.toml").read_text(encoding="utf-8"))
    stages = stages_by_hand()
    return {
        row["code"]: FaultRow(
            name, **{"error": f"E6{row['code']}", **row, "hint": row["hint"].replace("{stages}", stages)}
        )
        for name, row in table.items()
    }


FAULTS = _rows()
