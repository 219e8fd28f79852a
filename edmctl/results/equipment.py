"""What is connected to this computer, and the checks of it."""

from __future__ import annotations

from enum import StrEnum

from edmctl.dataclasses import dataclass


class CheckStatus(StrEnum):
    """How a check came out."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True, slots=True)
class Check:
    """One line of `doctor`; `fix` is empty where there is nothing to put right."""

    name: str
    status: CheckStatus
    message: str
    fix: str = ""


@dataclass(frozen=True, slots=True)
class Controller:
    """Who answered at a port. `fault` is the number of the latched fault, 0 for none."""

    serial: str
    firmware: str
    protocol: str
    state: str
    fault: int
    fault_name: str
    simulated: bool


@dataclass(frozen=True, slots=True)
class PortRow:
    """A port. `known`: `auto` may ask it; `controller` and `error` are None where it was not asked."""

    device: str
    description: str
    usb_id: str
    usb_serial: str
    held_by: str
    in_setup: bool
    known: bool
    controller: Controller | None
    error: str | None
