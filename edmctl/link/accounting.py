"""What a session keeps count of: frames, and controller time."""

from __future__ import annotations

from dataclasses import dataclass, field

_WRAP_32 = 1 << 32


@dataclass(slots=True)
class Statistics:
    """Counts since the session opened. `lost_frames` counts telemetry frames by message name, exactly."""

    frames_sent: int = 0
    frames_received: int = 0
    bad_frames: int = 0
    other_session: int = 0
    stray_replies: int = 0
    unknown_types: int = 0
    malformed: int = 0
    repeated_events: int = 0
    heartbeats_sent: int = 0
    heartbeats_answered: int = 0
    lost_frames: dict[str, int] = field(default_factory=dict)


class ControllerClock:
    """Unwraps the controller's 32-bit microseconds, which start over every 71.6 minutes."""

    def __init__(self) -> None:
        self._reference_us = 0

    def note(self, t_dev_us: int) -> None:
        """Take the controller's full time, as every heartbeat brings it."""
        self._reference_us = t_dev_us

    def seconds(self, t_us: int) -> float:
        """Return controller time in seconds of a time within 35 minutes of the last heartbeat."""
        ahead = (t_us - self._reference_us) % _WRAP_32
        if ahead >= _WRAP_32 // 2:
            ahead -= _WRAP_32
        return (self._reference_us + ahead) / 1_000_000
