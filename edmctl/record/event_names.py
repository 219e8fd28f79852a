"""What the numbers in a run file tell: states of the controller, and codes of the events that figures look for."""

from __future__ import annotations

from enum import IntEnum


class State(IntEnum):
    """States of the controller, by the names of the protocol."""

    BOOT = 0
    IDLE = 1
    ARMED = 2
    APPROACH = 3
    MACHINING = 4
    JUMP = 5
    TOUCH = 6
    MOVING = 7
    FAULT = 8
    ESTOP = 9


class Told(IntEnum):
    """What an event of a run file tells: below 100 by the controller, else by procedures, who have more codes."""

    JUMP_DONE = 5
    TOUCH = 6
    FACE_FITTED = 112
    SITE_MEASURED = 130
    LEFT_UNMEASURED = 133
    SITE_ESTIMATED = 134
    ENDED_EARLY = 160
    JUMP_PERIOD = 161
    CHANNEL_MEASURED = 171
