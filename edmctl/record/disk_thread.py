"""Writes that have to be on the disk before a job continues, in a thread: meanwhile the caller serves the machine.

Sparks and moves wait until what precedes them is on the disk, and a disk may not answer for seconds.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

from edmctl import failures
from edmctl.errors import EdmError, LinkLost

GIVE_UP_S = 10.0
"""A disk that has not answered for so long hangs, and the job ends safely."""
PROMPT_S = 0.05
"""A write usually takes less, and nothing else is done so long."""
_STOPPING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class DiskThread:
    """Runs one write at a time.

    Parameters
    ----------
    attend : keeps a live machine company until its argument holds or some tenths of a second are over. None where
        the machine's time stands while the host does something else: there writes run in the caller's thread
    """

    def __init__(self, attend: Callable[[Callable[[], bool]], object] | None = None) -> None:
        self._attend = attend
        self._writing: _Write | None = None
        self._line_is_lost = self._hangs = False
        self._heard: EdmError | None = None

    def run(self, path: Path, write: Callable[[], None]) -> None:
        """Return when `write`, of the file at `path`, has run; what it raises comes out here.

        What the machine's line raises meanwhile comes out after it; a lost line, out of the machine's next call.
        Raises RunFileError E9009 where the disk hangs.
        """
        if self._attend is None:
            write()
            return
        while self._writing is not None:
            self._wait(path)
        mine = self._writing = _Write(write)
        self._wait(path)
        mine.check()
        if self._heard is not None:
            heard, self._heard = self._heard, None
            raise heard

    def start(self, write: Callable[[], None]) -> bool:
        """Begin a write that nothing waits for; False where the one before is still under way.

        What that one raised comes out here.
        """
        if self._attend is None:
            write()
            return True
        if self._writing is not None:
            if not self._writing.is_over():
                return False
            before, self._writing = self._writing, None
            before.check()
        self._writing = _Write(write)
        return True

    def close(self) -> None:
        """Wait for a write that is under way; not for ever where the disk hangs. Nobody asks for its outcome."""
        if self._writing is not None and not self._hangs:
            self._writing.join(GIVE_UP_S)

    def _wait(self, path: Path) -> None:
        writing, begun_s = self._writing, time.monotonic()
        if writing is None:
            return
        if not self._hangs:
            writing.join(PROMPT_S)
        while not writing.is_over():
            if self._hangs or time.monotonic() - begun_s > GIVE_UP_S:
                self._hangs = True
                raise failures.disk_does_not_answer(give_up_s=GIVE_UP_S, path=path)
            self._attend_to(writing)
        self._hangs = False
        # While the line was read, a further write may have begun.
        if self._writing is writing:
            self._writing = None

    def _attend_to(self, writing: _Write) -> None:
        """Read the line for a while, or wait where there is none any more."""
        assert self._attend is not None
        if self._line_is_lost or self._heard is not None:
            writing.join(PROMPT_S)
            return
        try:
            self._attend(writing.is_over)
        except LinkLost:
            self._line_is_lost = True
        except EdmError as heard:
            self._heard = heard


class _Write:
    """A write in a thread of its own, and what it raised."""

    def __init__(self, write: Callable[[], None]) -> None:
        self._write = write
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="disk", daemon=True)
        self._thread.start()
        self.join = self._thread.join

    def is_over(self) -> bool:
        return not self._thread.is_alive()

    def check(self) -> None:
        """Raise what it raised."""
        if self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        leave_signals_to_the_main_thread()
        try:
            self._write()
        except BaseException as error:
            self._failure = error


def leave_signals_to_the_main_thread() -> None:
    """Python handles them there, and only a signal that arrives there ends its waiting."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, _STOPPING)
