"""Codes of the events that procedures write into the run file. Those below 100 are the controller's own."""

from __future__ import annotations

from enum import IntEnum


class RunEvent(IntEnum):
    """A decision or a result of a procedure."""

    ARMED = 100
    CONDITIONED = 101
    STAGE_MOVED = 102
    APPROACHED = 103
    SELF_TESTED = 105
    READING = 110
    READING_REJECTED = 111
    FACE_FITTED = 112
    TOUCH_DOUBTED = 113
    DOUBT_WITHDRAWN = 114
    CUT_PLANNED = 120
    CUT_ENDED = 121
    JUMPED = 122
    CUT_DECIDED = 123
    CUT_GIVEN_UP = 124
    SITE_MEASURED = 130
    TARGET_REACHED = 131
    TARGET_MISSED = 132
    LEFT_UNMEASURED = 133
    SITE_ESTIMATED = 134
    RESUMED = 135
    SITES_LEFT = 136
    VERDICT = 137
    ARCING = 140
    SHORTING = 141
    Z_MISMATCH = 142
    LINE_NOISE = 143
    LINK = 144
    SETUP_WRONG = 145
    CONTROLLER_LOG = 150
    ENDED_EARLY = 160
    JUMP_PERIOD = 161
    REFERENCE_CHANGED = 162
    DUTY_CHANGED = 163
    SHORT_RECOVERY = 164
    ARC_BURN_RECOVERY = 165
    STALL_JUMP = 166
    BREAKTHROUGH = 167
    PASS_ENDED = 170
    CHANNEL_MEASURED = 171
    WEAR_MEASURED = 180
    SURFACE_FOUND = 181
    JUMP_MEASURED = 182
