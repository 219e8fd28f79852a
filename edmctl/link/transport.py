"""What a session needs of a line: bytes out, bytes in, and the clock that waiting goes by."""

from __future__ import annotations

from typing import Protocol


class Transport(Protocol):
    """A byte stream to one controller.

    `name` is what people see in messages. `live` is true where `now_s` is the computer's own clock, which goes on
    whatever the host does; otherwise time passes only while the host reads.
    """

    @property
    def name(self) -> str:
        """What people see."""
        ...

    @property
    def live(self) -> bool:
        """Whether time passes by itself."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes; LinkLost where the line is gone."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """Return as soon as anything is there, b"" once `now_s` has moved on by `timeout_s`.

        Raises LinkLost where the line is gone.
        """
        ...

    def now_s(self) -> float:
        """Return the clock that the host waits by: monotonic, in seconds, virtual where time is simulated."""
        ...

    def close(self) -> None:
        """Give the line back."""
        ...
