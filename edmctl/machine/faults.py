"""A latched fault as an error that people can act on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.errors import MachineFault
from edmctl.link.faults import FAULTS

if TYPE_CHECKING:
    from collections.abc import Mapping


def fault_error(code: int, settings: Mapping[str, float], where: str = "") -> MachineFault:
    """The error for a latched fault.

    `settings` are the controller's parameters, for the figures in the message; `where` says when and where it
    happened and is appended.
    """
    row = FAULTS.get(code)
    if row is None:
        message = f"The controller latched fault {code}, which this version does not know."
        hint = "Update edmctl, or look the number up in the firmware."
    else:
        message, hint = row.message.format_map(settings), row.hint
    return MachineFault(f"{message}{where}", hint=hint, code=f"E6{code}", fault=code)
