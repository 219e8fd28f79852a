"""Hostile files and every reader of them: `python -m benchmarks.hostile_files [SECTION ...]`.

`options` runs a command for each option that reads a file, in a process of its own, with the files of
`tests/cli/test_files_read.py`, a gigabyte that is really on the disk, a file without permission, and one that comes
and goes all the time. The exit code is 1 if a reader took more than 2 s or 300 MB, or ended with status 1 or without
a message. `studies` tries the files in the folder of a study.
"""

from __future__ import annotations

import ctypes
import itertools
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.serving import environment
from tests.cli.test_files_read import KINDS, READERS, is_refused, made, name_in_files
from tests.study.test_study_folder_read import FILES, STUDY_READERS, finished, is_tried, put, write_names

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

BAR_S, BAR_MB = 2.0, 300.0
PR_CAPBSET_DROP, OVERRIDES = 24, (1, 2)
"""Of prctl(2): what lets root read every file."""
GIGABYTE, UNREADABLE, FLICKERING = "gigabyte", "unreadable", "flickering"
ALL_KINDS = (*KINDS, GIGABYTE, UNREADABLE, FLICKERING)


@contextmanager
def flickering(path: Path) -> Iterator[None]:
    """A file that is there and gone in turns while the block runs."""
    over = threading.Event()

    def flicker() -> None:
        while not over.wait(0.001):
            path.write_text("schema = 1\n", encoding="utf-8")
            path.unlink()

    thread = threading.Thread(target=flicker)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def written_gigabyte(path: Path) -> None:
    """Write a file that the disk really holds."""
    block = os.urandom(1 << 20)
    with path.open("wb") as file:
        for _ in range(1 << 10):
            file.write(block)


def named(kind: str, gigabyte: Path) -> str:
    """Make what is no file to be read, in the working folder; its name."""
    if kind == GIGABYTE:
        Path(kind).hardlink_to(gigabyte)
        return kind
    if kind == UNREADABLE:
        Path(kind).write_text("schema = 1\n", encoding="utf-8")
        Path(kind).chmod(0)
        return kind
    return kind if kind == FLICKERING else made(kind)


def without_rights() -> None:
    """Take from root the right to read what is not meant for it, in the process to come (Linux)."""
    if os.geteuid() == 0:
        libc = ctypes.CDLL(None)
        for right in OVERRIDES:
            libc.prctl(PR_CAPBSET_DROP, right, 0, 0, 0)


def ran(arguments: Sequence[str], home: Path) -> tuple[float, float, int, str]:
    """Time in s, memory in MB, exit code and stderr of a command."""
    begin_s = time.monotonic()
    with tempfile.TemporaryFile("w+") as err:
        process = subprocess.Popen(
            [sys.executable, "-m", "edmctl", *arguments],
            env=environment(home),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=err,
            preexec_fn=without_rights,
        )
        _, status, used = os.wait4(process.pid, 0)
        took_s, process.returncode = time.monotonic() - begin_s, os.waitstatus_to_exitcode(status)
        err.seek(0)
        return took_s, used.ru_maxrss / 1024.0, process.returncode, err.read()


def main() -> int:
    """Try the sections, print what misses and a line for each, and return the exit code."""
    missed = 0
    for name in sys.argv[1:] or SECTIONS:
        with tempfile.TemporaryDirectory() as folder:
            missed += SECTIONS[name](Path(folder))
            os.chdir("/")
    return int(missed > 0)


def _with_gigabyte(tried: Callable[[Path], int], folder: Path) -> int:
    gigabyte = folder / GIGABYTE
    written_gigabyte(gigabyte)
    return tried(gigabyte)


def _tried(gigabyte: Path) -> int:
    missed = 0
    for kind in ALL_KINDS:
        worst_s = worst_mb = 0.0
        for reader, words in READERS.items():
            if not is_refused(reader, kind):
                continue
            with tempfile.TemporaryDirectory() as folder:
                os.chdir(folder)
                Path(folder).chmod(0o777)
                name = named(kind, gigabyte)
                name_in_files(name)
                arguments = [word.replace("FILE", name) for word in words]
                with flickering(Path(name)) if kind == FLICKERING else nullcontext():
                    took_s, memory_mb, code, err = ran(arguments, Path(folder))
                os.chdir("/")
            if kind == FLICKERING and code == 0:
                continue  # it was there when it was looked for
            worst_s, worst_mb = max(worst_s, took_s), max(worst_mb, memory_mb)
            told = code > 1 and "error[E" in err and "Internal" not in err
            if took_s > BAR_S or memory_mb > BAR_MB or not told:
                missed += 1
                print(
                    f"{kind} as {reader}: {took_s:.1f} s, {memory_mb:.0f} MB, exit {code}: {err.strip()[:200]}"
                )
        print(
            f"{kind:12} worst {worst_s:4.1f} s (bar {BAR_S:g} s), {worst_mb:4.0f} MB (bar {BAR_MB:g} MB)",
            flush=True,
        )
    print(f"options: {missed} missed")
    return missed


def _tried_studies(gigabyte: Path) -> int:
    """Every command that reads a study, with each file of its folder replaced; return the exit code."""
    missed = tried = 0
    worst_s = worst_mb = 0.0
    with tempfile.TemporaryDirectory() as kept:
        study = finished(Path(kept))
        for kind, file, reader in itertools.product(ALL_KINDS, FILES, STUDY_READERS):
            if not is_tried(reader, file, kind) or (kind == GIGABYTE and file.endswith(".lock")):
                continue
            with tempfile.TemporaryDirectory() as folder:
                os.chdir(folder)
                Path(folder).chmod(0o777)
                shutil.copytree(study, "DIR")
                write_names("ra.csv")
                put(Path("DIR"), file, named(kind, gigabyte))
                with flickering(Path(kind)) if kind == FLICKERING else nullcontext():
                    took_s, memory_mb, code, err = ran(STUDY_READERS[reader], Path(folder))
                os.chdir("/")
            tried += 1
            is_refusal = code > 1 and "error[E" in err and "Internal" not in err
            if kind == FLICKERING and code == 0:
                continue  # it was there when it was read
            worst_s, worst_mb = max(worst_s, took_s), max(worst_mb, memory_mb)
            if took_s > BAR_S or memory_mb > BAR_MB or not is_refusal:
                missed += 1
                print(
                    f"{kind} as {file}, {reader}: {took_s:.1f} s, {memory_mb:.0f} MB, exit {code}: {err[:200]}"
                )
    print(f"{tried} tried, {missed} missed, worst {worst_s:.1f} s (bar {BAR_S:g} s), {worst_mb:.0f} MB")
    return int(missed > 0)


SECTIONS: dict[str, Callable[[Path], int]] = {
    "studies": partial(_with_gigabyte, _tried_studies),
    "options": partial(_with_gigabyte, _tried),
}
"""What tries the readers of some files, with a folder for it; the number of misses is returned."""

if __name__ == "__main__":
    sys.exit(main())
