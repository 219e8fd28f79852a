"""What the benchmarks of the link share: a served virtual controller and commands run against it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[1]
READY_S = 60.0


def environment(home: Path) -> dict[str, str]:
    """The environment of commands that run in `home`."""
    return {**os.environ, "EDMCTL_HOME": str(home), "PYTHONPATH": str(ROOT)}


def start(home: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start a command with pipes for its streams."""
    return subprocess.Popen(
        [sys.executable, "-m", "edmctl", *arguments],
        cwd=home,
        env=environment(home),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def result(process: subprocess.Popen[str]) -> tuple[int, dict[str, Any], str]:
    """Wait for a command; its return code, JSON object and stderr."""
    out, err = process.communicate()
    return process.returncode, json.loads(out) if out.strip() else {}, err


@contextmanager
def server(home: Path, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """Serve a virtual controller while the block runs; it need not be ready yet when the block begins."""
    process = subprocess.Popen(
        [sys.executable, "-m", "edmctl", "simulate", "serve", "--quiet", *options],
        cwd=home,
        env=environment(home),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.terminate()
        process.wait(timeout=30)


@contextmanager
def served(home: Path, *options: str, name: str = "edm") -> Iterator[Path]:
    """Serve a virtual controller on `home/name` while the block runs."""
    link = home / name
    with server(home, "--link", str(link), *options) as process:
        end_s = time.monotonic() + READY_S
        while not link.exists():
            if process.poll() is not None or time.monotonic() > end_s:
                raise RuntimeError("the server did not start")
            time.sleep(0.05)
        yield link
