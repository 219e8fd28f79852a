"""Where a served controller can be reached, and the pty under a name that usually is it."""

from __future__ import annotations

import contextlib
import os
import select
import tty
from pathlib import Path
from typing import Protocol

from edmctl.errors import LinkLost

_MOST_READ = 65536


class Endpoint(Protocol):
    """One end of a line, with at most one client at a time. Nothing here blocks."""

    @property
    def name(self) -> str:
        """What a client has to be told."""

    def descriptors(self) -> list[int]:
        """What to wait on for `receive`."""

    def receive(self) -> bytes:
        """Return what has come, b"" where nothing has."""

    def transmit(self, data: bytes) -> int:
        """Send what the line takes; the number of bytes that it took."""

    def heard(self) -> None:
        """The client has sent a valid frame."""

    def has_client(self) -> bool:
        """Whether somebody is connected, as far as can be told."""

    def close(self) -> None:
        """Take the endpoint away."""


class PtyEndpoint:
    """A pseudo-terminal; clients open `link`, a symbolic link to it, as they open a serial port.

    Raises LinkLost E4021 where `link` is something else already.
    """

    def __init__(self, link: Path | None = None) -> None:
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._ours)
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.device = os.ttyname(self._theirs)
        self._link = link
        try:
            if link is not None:
                _publish(link, self.device)
        except BaseException:
            os.close(self._ours)
            os.close(self._theirs)
            raise

    @property
    def name(self) -> str:
        """The link, or the device without one."""
        return str(self._link or self.device)

    def descriptors(self) -> list[int]:
        """Our end."""
        return [self._ours]

    def receive(self) -> bytes:
        """Return what clients have written."""
        try:
            return os.read(self._ours, _MOST_READ)
        except BlockingIOError:
            return b""
        except OSError:  # a client that had the device to itself is gone
            self._hold()
            return b""

    def transmit(self, data: bytes) -> int:
        """Write as much as the terminal's buffer takes."""
        try:
            return os.write(self._ours, data)
        except BlockingIOError:
            return 0

    def heard(self) -> None:
        """Do nothing: a terminal has whoever opens it."""

    def has_client(self) -> bool:
        """Whether somebody has the device open: a terminal that nobody holds reports that it was hung up."""
        os.close(self._theirs)
        try:
            poll = select.poll()
            poll.register(self._ours, select.POLLIN)
            return not any(events & select.POLLHUP for _, events in poll.poll(0))
        finally:
            self._hold()

    def _hold(self) -> None:
        """Keep the other end open, so that a client which closes it does not hang up."""
        try:
            self._theirs = os.open(self.device, os.O_RDWR | os.O_NOCTTY)
        except OSError:  # a client has the device to itself
            self._theirs = os.dup(self._ours)

    def close(self) -> None:
        """Remove the link and hang up."""
        if self._link is not None:
            with contextlib.suppress(OSError):
                if self._link.readlink() == Path(self.device):
                    self._link.unlink()
        for number in (self._ours, self._theirs):
            with contextlib.suppress(OSError):
                os.close(number)


def _publish(link: Path, device: str) -> None:
    """Make the link in the place of none, or of a dead server's, which leads nowhere or to this very device."""
    try:
        if link.is_symlink() and (not link.exists() or link.readlink() == Path(device)):
            link.unlink()
        link.symlink_to(device)
    except OSError as error:
        raise LinkLost(
            f"Cannot make the link {link}: {error.strerror}.",
            hint="Take another path for --link.",
            code="E4021",
        ) from error
