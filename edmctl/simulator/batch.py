"""Many virtual machines at once, without a host: on several threads, because the library frees the interpreter."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from edmctl.simulator.bench import VirtualBench


def run_many(benches: Sequence[VirtualBench], ticks: int, threads: int) -> None:
    """Let `ticks` ms pass on each of several machines, `threads` of them at a time.

    Each does what it would do alone; what its controller sends waits in `controller.link.take_output()`, and its
    watchdog hears a host by `controller.host_heard()`. A machine is reset by a copy of it that was made before
    (`copy.deepcopy`). Raises what went wrong on the first of them.
    """
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(lambda bench: bench.controller.advance(ticks), benches):
            pass
