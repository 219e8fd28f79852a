"""Installations in fresh environments, and the first jobs of one: `python -m benchmarks.installing [WAYS]`.

WAYS are some of compiler, zig, editable, wheel; all of them by default. Each clones this checkout into a temporary
folder and installs the clone into a new environment with pip, whose cache spares downloads that were made before:

compiler   as the first command of README.md does, with the C compiler of the system. Then the processor time of the
           first job, with an empty home, against later ones (`--runs 3`), and what the packages take on the disk,
           as `du -m` counts
zig        with no C compiler on the path: pip brings one for the build
editable   `pip install -e .`, and a job; then a changed C source: it is built again, which is said
wheel      the source distribution, a wheel of it, and an installation of that

Times include the environment and all dependencies. Exit code 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

HERE = Path(__file__).resolve().parents[1]
MOST_S = {"compiler": 60.0, "zig": 120.0}
MOST_FIRST, MOST_MB = 1.15, 400.0
JOB = ("machine", "--profile", "profiles/cu270.toml")
SHALLOW = (*JOB, "--set", "target.depth_um=8", "--seed", "1")
COMPILER = re.compile(r"(.*-)?(cc|c89|c99|gcc|clang|tcc|icx|zig)(-[\d.]+)?$")
BUILDING = "building the controller and the virtual machine"


class Place:
    """A clone of this checkout and an environment beside it, with a home and caches of its own."""

    def __init__(self, folder: Path, path: str | None = None) -> None:
        self.folder, self.clone, self.bin = folder, folder / "clone", folder / "venv" / "bin"
        spared = ("CC", "EDMCTL", "PYTHON")
        self.environ = {name: value for name, value in os.environ.items() if not name.startswith(spared)}
        self.environ.update(HOME=str(folder), XDG_CACHE_HOME=str(folder / "cache"))
        self.environ.setdefault("PIP_CACHE_DIR", str(Path.home() / ".cache" / "pip"))
        if path is not None:
            self.environ["PATH"] = path
        subprocess.run(["git", "clone", "-q", str(HERE), str(self.clone)], check=True)

    def run(self, *command: str) -> str:
        """Run a command in the clone; what it wrote to stderr. Raises RuntimeError where it fails."""
        done = subprocess.run(
            command, cwd=self.clone, env=self.environ, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
        return done.stderr

    def install(self, *what: str) -> float:
        """Make the environment and install into it; how long it took, s."""
        begin_s = time.monotonic()
        self.run(sys.executable, "-m", "venv", "--upgrade-deps", str(self.folder / "venv"))
        self.run(str(self.bin / "pip"), "install", "-q", *what)
        return time.monotonic() - begin_s

    def edmctl(self, *arguments: str) -> str:
        """Run the installed command; what it wrote to stderr."""
        return self.run(str(self.bin / "edmctl"), *arguments)

    def job_s(self) -> float:
        """Processor time of the job of README.md, s."""
        before = os.times()
        self.edmctl(*JOB, "--seed", "1", "--quiet")
        after = os.times()
        return after.children_user + after.children_system - before.children_user - before.children_system


def without_compiler(folder: Path) -> str:
    """Return a search path with every command of this one but C compilers."""
    folder.mkdir()
    for place in os.environ["PATH"].split(os.pathsep):
        for command in Path(place).iterdir() if Path(place).is_dir() else ():
            link = folder / command.name
            if not COMPILER.fullmatch(command.name) and not link.exists():
                link.symlink_to(command)
    return str(folder)


def told(holds: bool, text: str) -> bool:
    """Print a line with its verdict, which is returned."""
    print(f" {' ' if holds else '!'} {text}", flush=True)
    return holds


def with_compiler(folder: Path, runs: int) -> bool:
    """Install as README.md says, and measure the first job and the environment."""
    place = Place(folder)
    took_s = place.install(".")
    holds = told(
        took_s <= MOST_S["compiler"], f"with a C compiler: {took_s:.0f} s ({MOST_S['compiler']:.0f} s)"
    )
    first_s = place.job_s()
    later_s = median(place.job_s() for _ in range(runs))
    ratio = first_s / later_s
    holds &= told(
        ratio <= MOST_FIRST,
        f"first job {first_s:.2f} s, later ones {later_s:.2f} s: {ratio:.2f} times ({MOST_FIRST})",
    )
    packages = next(place.folder.glob("venv/lib/python*/site-packages"))
    size_mb = sum(file.lstat().st_blocks * 512 for file in packages.rglob("*")) / 2**20
    return told(size_mb <= MOST_MB, f"site-packages {size_mb:.0f} MB ({MOST_MB:.0f} MB)") and holds


def with_zig(folder: Path, runs: int) -> bool:
    """Install where there is no C compiler."""
    place = Place(folder, without_compiler(folder / "commands"))
    took_s = place.install(".")
    is_built_anew = BUILDING in place.edmctl(*SHALLOW)
    holds = took_s <= MOST_S["zig"] and not is_built_anew
    return told(holds, f"without a C compiler: {took_s:.0f} s ({MOST_S['zig']:.0f} s), and a job")


def editable(folder: Path, runs: int) -> bool:
    """Install the clone itself, and change one of its C sources."""
    place = Place(folder)
    took_s = place.install("-e", ".")
    is_built_anew = BUILDING in place.edmctl(*SHALLOW)
    holds = told(not is_built_anew, f"editable: {took_s:.0f} s, and a job")
    source = place.clone / "firmware" / "plant" / "plant.c"
    source.write_text(source.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    begin_s = time.monotonic()
    says_so = BUILDING in place.edmctl(*SHALLOW)
    took_s = time.monotonic() - begin_s
    says_nothing = BUILDING not in place.edmctl(*SHALLOW)
    text = f"a changed C source: built once and said so, with a job {took_s:.0f} s"
    return told(says_so and says_nothing, text) and holds


def by_wheel(folder: Path, runs: int) -> bool:
    """Make a source distribution, of it a wheel, and install that."""
    place = Place(folder)
    begin_s = time.monotonic()
    place.run(sys.executable, "-m", "venv", "--upgrade-deps", str(folder / "build"))
    pip = str(folder / "build" / "bin" / "pip")
    place.run(pip, "install", "-q", "hatchling")
    place.run(str(folder / "build" / "bin" / "hatchling"), "build", "-t", "sdist", "-d", str(folder / "dist"))
    (source,) = (folder / "dist").glob("*.tar.gz")
    place.run(pip, "wheel", "-q", "--no-deps", "-w", str(folder / "dist"), str(source))
    (wheel,) = (folder / "dist").glob("*.whl")
    place.install(str(wheel))
    took_s = time.monotonic() - begin_s
    is_built_anew = BUILDING in place.edmctl(*SHALLOW)
    return told(not is_built_anew, f"{source.name}, {wheel.name}: {took_s:.0f} s, and a job")


WAYS: dict[str, Callable[[Path, int], bool]] = {
    "compiler": with_compiler,
    "zig": with_zig,
    "editable": editable,
    "wheel": by_wheel,
}


def main() -> int:
    """Measure, print, and return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("ways", nargs="*", metavar="WAYS")
    parser.add_argument("--runs", type=int, default=3)
    given = parser.parse_args()
    if unknown := set(given.ways) - set(WAYS):
        parser.error(f"{', '.join(sorted(unknown))} is none of {', '.join(WAYS)}")
    holds = []
    for way in given.ways or WAYS:
        with tempfile.TemporaryDirectory() as folder:
            try:
                holds.append(WAYS[way](Path(folder), given.runs))
            except RuntimeError as failed:
                holds.append(told(False, f"{way}: {failed}"))
    return int(not all(holds))


if __name__ == "__main__":
    sys.exit(main())
