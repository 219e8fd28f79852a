"""Codes of the events that figures look for: those of procedures, and below 100 the controller's own."""

from __future__ import annotations

from enum import IntEnum


class Told(IntEnum):
    """What an event of a run file tells. The names are those of its writers, who have more codes."""

    JUMP_DONE = 5
    FACE_FITTED = 112
    SITE_MEASURED = 130
    SITE_ESTIMATED = 134
    JUMP_PERIOD = 161
    CHANNEL_MEASURED = 171
