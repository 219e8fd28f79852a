"""A virtual controller served on a pty, for tests of what comes through a line."""

from __future__ import annotations

import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

from edmctl.simulator.endpoints import PtyEndpoint
from edmctl.simulator.serve import Server

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from edmctl.simulator import VirtualBench


@contextmanager
def serving(
    bench: VirtualBench, speed: float | None = None, acts: Callable[[], None] = lambda: None
) -> Iterator[str]:
    """Serve `bench` in a thread while the block runs, by default with a driven clock; yields the path of the pty."""
    endpoint, over = PtyEndpoint(), threading.Event()
    server = Server(bench, endpoint, speed, acts=acts)
    thread = threading.Thread(target=server.run, args=(over.is_set,), name="server")
    thread.start()
    try:
        yield endpoint.name
    finally:
        over.set()
        thread.join()
        endpoint.close()
