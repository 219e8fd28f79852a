"""Who holds a port, as far as Linux tells."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


def owner_of(port: Path) -> str:
    """Return "process 1234 (edmctl machine …)" for the holder of the lock on a port; "" where nobody can tell."""
    try:
        place = port.stat()
        locks = Path("/proc/locks").read_text(encoding="ascii")
    except OSError:
        return ""
    for line in locks.splitlines():
        fields = line.split()
        if len(fields) < 6 or fields[1] != "FLOCK":
            continue
        major, minor, inode = fields[5].split(":")
        device = os.makedev(int(major, 16), int(minor, 16))
        if (device, int(inode)) == (place.st_dev, place.st_ino):
            return _described(int(fields[4]))
    return ""


def _described(pid: int) -> str:
    words: list[str] = []
    with suppress(OSError):
        command = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace")
        words = command.rstrip("\0").split("\0")
    if not words:
        return f"process {pid}"
    # `python -m edmctl machine`: what follows the interpreter's own options says more.
    if "edmctl" in words[:4]:
        words = words[words.index("edmctl") :]
    text = " ".join([Path(words[0]).name, *words[1:]])
    return f"process {pid} ({text if len(text) <= 60 else text[:59] + '…'})"
