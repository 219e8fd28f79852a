"""Heartbeats from a thread of their own, so that a disk that blocks for a moment does not end a run.

The thread watches the main loop: when that has not moved for a second, no heartbeat is sent any more, and the
controller's watchdog makes the machine safe. A host that hangs must not look alive.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from edmctl.errors import LinkLost

HUNG_S = 1.0
"""A main loop that has not moved for so long hangs."""


class HeartbeatThread:
    """Calls `beat` every `period_s` for as long as `idle_s` says that the main loop moved within `HUNG_S`.

    A dead line ends the thread; the main loop finds out by itself.
    """

    def __init__(self, beat: Callable[[], None], idle_s: Callable[[], float], period_s: float) -> None:
        self._beat = beat
        self._idle_s = idle_s
        self._period_s = period_s
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)

    def start(self) -> None:
        """Begin to beat."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and wait until it has ended."""
        self._over.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join()

    def _run(self) -> None:
        while not self._over.wait(self._period_s):
            if self._idle_s() < HUNG_S:
                try:
                    self._beat()
                except LinkLost:
                    return
