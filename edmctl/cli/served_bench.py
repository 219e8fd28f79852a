"""The bench that a server offers: a fresh one, or one that is kept in a file."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from edmctl.simulator import BenchConfig, VirtualBench


@contextmanager
def kept_bench(
    path: Path | None, config: BenchConfig, seed: int
) -> Iterator[tuple[VirtualBench, Callable[[], None]]]:
    """Give the bench that `path` keeps, or a new one where there is none yet, and a call that writes it down.

    It is written at the start and at the end as well.

    Raises RunFileError where the file is no bench, is in use or cannot be written.
    """
    from edmctl.simulator import open_bench

    if path is None:
        yield open_bench(config, seed), lambda: None
        return
    from edmctl.record.bench_file import bench_lock, read_bench, write_bench
    from edmctl.simulator.saving import bench_state, restored_bench

    with bench_lock(path):
        bench = restored_bench(read_bench(path)) if path.exists() else open_bench(config, seed)

        def keep() -> None:
            write_bench(path, bench_state(bench))

        keep()
        try:
            yield bench, keep
        finally:
            keep()
