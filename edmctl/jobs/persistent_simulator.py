"""A virtual bench that lives in a file: for one command after the other (`sim:FILE`), or behind a served line."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from functools import partial
from pathlib import Path

from edmctl import failures
from edmctl.jobs.tool import NAMELESS, is_unnamed
from edmctl.planning.rules.load import LoadedProfile
from edmctl.record.bench_file import bench_lock, read_bench, write_bench
from edmctl.simulator import BenchConfig, VirtualBench, open_bench
from edmctl.simulator.bench import DirectLine
from edmctl.simulator.config import FIRMWARE, STM32
from edmctl.simulator.saving import bench_state, restored_bench

KEEP_S = 5.0
"""Bench time between two writes: a killed command loses at most this. As often as a job writes its journal."""


@contextmanager
def kept_bench(
    path: Path | None, config: BenchConfig, seed: int
) -> Iterator[tuple[VirtualBench, Callable[[], None]]]:
    """Give the bench of the file `path`, or a new one, and a function that writes it.

    It is also written at the start and at the end of the block, however that ends.
    """
    if path is None:
        yield open_bench(config, seed), lambda: None
        return
    with _opened(path, config, seed) as bench:
        _write(path, bench)
        try:
            yield bench, partial(_write, path, bench)
        finally:
            _write(path, bench)


@contextmanager
def kept_line(
    path: Path, config: BenchConfig, seed: int, wait_s: float
) -> Iterator[tuple[VirtualBench, KeptLine]]:
    """Give a kept bench and the line to it. The file stays as it is, or is not made, unless the line `begin`s.

    From then on the bench is written every few seconds of its own time while it machines, and at the end.
    """
    with _opened(path, config, seed, wait_s) as bench:
        line = KeptLine(bench, path)
        try:
            yield bench, line
        finally:
            line.end()


@contextmanager
def _opened(path: Path, config: BenchConfig, seed: int, wait_s: float = 0.0) -> Iterator[VirtualBench]:
    if config.controller == STM32:
        raise failures.emulated_bench_not_kept(stm32=STM32, path=path, firmware=FIRMWARE)
    with bench_lock(path, wait_s):
        yield restored_bench(read_bench(path)) if path.exists() else open_bench(config, seed)


def _write(path: Path, bench: VirtualBench) -> None:
    write_bench(path, bench_state(bench), is_own=True)


def fit(bench: VirtualBench, loaded: LoadedProfile, config: BenchConfig, say: Callable[[str], None]) -> None:
    """Put the profile's tool into a persistent bench; print what changes and which profile values have no effect.

    Workpiece, height and sensors belong to the bench. An unnamed tool with the profile's diameter gets the
    profile's name.
    """
    tool, before = loaded.profile.tool, bench.tool_label
    is_named_now = is_unnamed(before, bench.plant.config.tool_diameter_um, tool)
    if is_named_now:
        bench.plant.tools_worn_um.setdefault(tool.label, bench.tool_wear_um)
    bench.fit_tool(tool.label, tool.diameter_um, config.tool_wear, loaded.sim.tip_rounding_um)
    if before != tool.label and not is_named_now:
        say(f"tool changed: {tool.label} instead of {'an unnamed one' if before == NAMELESS else before}")
    here = bench.plant.config
    own = [
        f"{field.name} = {value:g}"
        for kept, asked in (
            (here.discharge, config.discharge),
            (here.discharge.erosion, config.discharge.erosion),
            (here.discharge.gap, config.discharge.gap),
        )
        for field in fields(kept)
        if isinstance(value := getattr(kept, field.name), float) and value != getattr(asked, field.name)
    ]
    names = ["work_removal", "controller", "offset_um"]
    if loaded.profile.work.kind == "through":
        names.append("thickness_um")
    own += [
        f"{name} = {value:g}" if isinstance(value := getattr(here, name), float) else f"{name} = {value}"
        for name in names
        if getattr(here, name) != getattr(config, name)
    ]
    if own:
        say(f"the bench keeps its own values, whatever the profile says: {', '.join(own)}")


class KeptLine(DirectLine):
    """The line to a persistent bench; writes a bench with a worn tool every `KEEP_S` while the host reads.

    Other motion need not be kept: every command conditions the actuator. Nothing is written before `begin`.
    """

    def __init__(self, bench: VirtualBench, path: Path) -> None:
        super().__init__(bench.controller)
        self._bench, self._path = bench, path
        self.name = f"sim:{path}"
        self._kept_s = self._looked_s = self.now_s()
        self._kept_um = bench.tool_wear_um
        self._begun = False

    def begin(self) -> None:
        """Start writing the bench. Raises RunFileError E9024 if that fails."""
        self._begun = True
        self.keep_all()

    def end(self) -> None:
        """Write the final state of the bench."""
        self.keep_all()

    def kept_s(self) -> float:
        """Time of the bench in its file."""
        return self._kept_s

    def read(self, timeout_s: float) -> bytes:
        """Let up to `timeout_s` of virtual time pass; bytes of the controller."""
        data = super().read(timeout_s)
        if self.now_s() - self._looked_s >= KEEP_S:
            self._looked_s = self.now_s()
            self.keep_worn()
        return data

    def keep_worn(self) -> None:
        """Write the bench down if its tool has worn since. Raises RunFileError E9024."""
        if self._bench.tool_wear_um != self._kept_um:
            self.keep_all()

    def keep_all(self) -> None:
        """Write the bench down. Raises RunFileError E9024."""
        if self._begun:
            _write(self._path, self._bench)
            self._kept_s = self._looked_s = self.now_s()
            self._kept_um = self._bench.tool_wear_um
