"""CPU time of the whole `machine` command: in the kernel, in imports, and in all the rest.

    python benchmarks/command_cpu.py [OTHER_CHECKOUT] [--repeat 7] [-- ARGUMENTS OF edmctl]

With another checkout both run by turns, so that they see the same computer, and the ratios of rests and totals are
printed.
Imports hold the start of the interpreter; of each part the least and the median of all repeats are told, over all
threads of the process. Bytecode and the library are made in a first run.

    python benchmarks/command_cpu.py --startup [--repeat 7]

CPU time of a job, of its start until the first tick of its machine, and of commands that compute nothing; how many
dataclasses a job makes, and how long that takes; and the most memory of the job.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from statistics import median
from typing import Any

COMMAND = ["machine", "--profile", "cu270", "--set", "target.depth_um=40", "--seed", "1"]
KERNEL = "edmctl.core.library"
PARTS = ("kernel", "imports", "rest", "total")
HERE = Path(__file__).resolve().parents[1]
JOB = ["machine", "--profile", "cu270", "--set", "target.depth_um=10", "--seed", "1", "--json"]
MOST_DATACLASS_S, MOST_MB = 0.12, 110.0


class Meter:
    """CPU seconds in imports and in the loop of machine and controller, whichever thread they are in."""

    def __init__(self) -> None:
        self.kernel_s = 0.0
        self.imports_s = time.process_time()
        self._within = threading.local()
        importlib: Any = sys.modules["_frozen_importlib"]
        self._find_and_load = importlib._find_and_load
        importlib._find_and_load = self._timed_import

    def _timed_import(self, name: str, *rest: Any) -> Any:
        if getattr(self._within, "is_import", False):
            return self._find_and_load(name, *rest)
        self._within.is_import = True
        start_s = time.thread_time()
        try:
            return self._find_and_load(name, *rest)
        finally:
            self._within.is_import = False
            self.imports_s += time.thread_time() - start_s
            self._meter_kernel()

    def _meter_kernel(self) -> None:
        """Let libraries that are loaded from now on time their loop."""
        module = sys.modules.get(KERNEL)
        base = getattr(module, "Library", None)
        if base is None or getattr(base, "is_metered", False):
            return
        meter = self

        class Metered(base):  # type: ignore[misc, valid-type]
            is_metered = True

            def __init__(self, build: Any) -> None:
                super().__init__(build)
                entry: Any = self.machine_advance  # type: ignore[has-type]

                def run(*places: Any) -> Any:
                    start_s = time.thread_time()
                    result = entry(*places)
                    meter.kernel_s += time.thread_time() - start_s
                    return result

                self.machine_advance = run

        module.Library = Metered  # type: ignore[union-attr]


def measure(arguments: list[str]) -> None:
    """Run a command in this process, and write its CPU seconds to the last line of stderr."""
    meter = Meter()
    with suppress(
        ModuleNotFoundError
    ):  # an older checkout has it elsewhere, or spares its start-up by itself
        import_module(
            "edmctl.start_up" if find_spec("edmctl.start_up") else "edmctl.cli.start_up"
        ).spare_start_up()
    from edmctl.app import main as edmctl

    code = edmctl(arguments)
    total_s = time.process_time()
    rest_s = total_s - meter.kernel_s - meter.imports_s
    parts = dict(zip(PARTS, (meter.kernel_s, meter.imports_s, rest_s, total_s), strict=True))
    sys.stderr.write(f"\n{json.dumps({'code': code, **parts})}\n")


def measure_startup(arguments: list[str]) -> None:
    """Run a job in this process, and write what its start takes to the last line of stderr."""
    made_s: list[float] = []
    first: list[tuple[float, int]] = []
    process: Any = dataclasses._process_class  # type: ignore[attr-defined]

    def timed(*given: Any, **options: Any) -> Any:
        start_s = time.thread_time()
        try:
            return process(*given, **options)
        finally:
            made_s.append(time.thread_time() - start_s)

    dataclasses._process_class = timed  # type: ignore[attr-defined]
    from edmctl.start_up import spare_start_up

    spare_start_up()
    from edmctl.app import main as edmctl
    from edmctl.core.library import Library

    def watched(library: Any, name: str, value: Any) -> None:
        def run(*places: Any) -> Any:
            if not first:
                first.append((time.process_time(), len(sys.modules)))
            return value(*places)

        object.__setattr__(library, name, run if name == "machine_advance" else value)

    Library.__setattr__ = watched  # type: ignore[method-assign]
    code = edmctl(arguments)
    found = {"code": code, "dataclasses_s": sum(made_s), "dataclasses": len(made_s)}
    if first:
        found.update(first_tick_s=first[0][0], modules=first[0][1])
    found.update(total_s=time.process_time(), peak_mb=getrusage(RUSAGE_SELF).ru_maxrss / 1024.0)
    sys.stderr.write(f"\n{json.dumps(found)}\n")


def startup(repeat: int) -> int:
    """Print the start of a job and of two commands that compute nothing; 1 if dataclasses take too long."""
    with tempfile.TemporaryDirectory() as folder:
        jobs = [once(HERE, JOB, folder, "--measure-startup") for _ in range(repeat + 1)][1:]
        others = {
            " ".join(command): min(
                _cpu_s([sys.executable, "-m", "edmctl", *command], folder) for _ in range(repeat)
            )
            for command in (["--version"], ["--help"], ["run", "list"])
        }
    least = {name: min(job[name] for job in jobs) for name in jobs[0]}
    print(
        f"a job: {least['total_s']:.2f} s, {least['first_tick_s']:.2f} s before the first tick, "
        f"{least['modules']:.0f} modules; {least['dataclasses']:.0f} dataclasses in "
        f"{least['dataclasses_s']:.3f} s, at most {MOST_DATACLASS_S} s"
    )
    print(f"most memory {least['peak_mb']:.0f} MB, at most {MOST_MB:.0f} MB")
    for command, seconds in others.items():
        print(f"edmctl {command:<10} {seconds:.2f} s")
    return int(least["dataclasses_s"] > MOST_DATACLASS_S or least["peak_mb"] > MOST_MB)


def _cpu_s(command: list[str], folder: str) -> float:
    before = os.times()
    subprocess.run(
        command, env={**os.environ, "PYTHONPATH": str(HERE)}, cwd=folder, capture_output=True, check=True
    )
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def once(checkout: Path, command: list[str], folder: str, how: str = "--measure") -> dict[str, float]:
    """Measure one command of a checkout in a process of its own."""
    environ = {**os.environ, "PYTHONPATH": str(checkout), "PYTHONPYCACHEPREFIX": f"{folder}/bytecode"}
    environ.pop("PYTHONDONTWRITEBYTECODE", None)
    arguments = [*command, "--out", f"{folder}/runs"]
    done = subprocess.run(
        [sys.executable, __file__, how, *arguments],
        env=environ,
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )
    found: dict[str, float] = json.loads(done.stderr.splitlines()[-1])
    assert found.pop("code") == 0, done.stderr
    return found


def main() -> None:
    """Measure and print."""
    if sys.argv[1:2] == ["--measure"]:
        measure(sys.argv[2:])
        return
    if sys.argv[1:2] == ["--measure-startup"]:
        measure_startup(sys.argv[2:])
        return
    own, _, command = " ".join(sys.argv[1:]).partition(" -- ")
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("other", nargs="?", type=Path, help="another checkout of the project")
    parser.add_argument("--repeat", type=int, default=7)
    parser.add_argument("--startup", action="store_true", help="measure the start of a job")
    options = parser.parse_args(own.split())
    if options.startup:
        sys.exit(startup(options.repeat))
    trees = [HERE] if options.other is None else [options.other.resolve(), HERE]
    found: dict[Path, list[dict[str, float]]] = {tree: [] for tree in trees}
    with tempfile.TemporaryDirectory() as folder:
        for attempt in range(options.repeat + 1):
            for number, tree in enumerate(trees):
                place = Path(folder, str(number))
                place.mkdir(exist_ok=True)
                parts = once(tree, command.split() or COMMAND, str(place))
                if attempt:
                    found[tree].append(parts)
    for tree in trees:
        print(f"{tree}")
        for part in PARTS:
            values = [one[part] for one in found[tree]]
            print(f"  {part:<8} {min(values):6.2f} s least   {median(values):6.2f} s median")
    if len(trees) > 1:
        for part in ("rest", "total"):
            before, after = ([one[part] for one in found[tree]] for tree in trees)
            print(
                f"{part}, here : there   {min(after) / min(before):.2f} least   "
                f"{median(after) / median(before):.2f} median"
            )


if __name__ == "__main__":
    main()
