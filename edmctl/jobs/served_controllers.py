"""Virtual controllers that this user serves: a note for each, so that `ports` can list what no system lists."""

from __future__ import annotations

import glob
import json
import os
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from edmctl.files import json_of, read_bytes
from edmctl.link.ports import PortInfo
from edmctl.profile.folders import data_folder
from edmctl.record.locks import is_alive


@contextmanager
def announced(port: str, serial: str, environ: Mapping[str, str]) -> Iterator[None]:
    """Note that a port is served, for a `with` block; where nothing can be written nobody is told."""
    note = _folder(environ) / f"{socket.gethostname()}-{os.getpid()}.json"
    with suppress(OSError):
        note.parent.mkdir(parents=True, exist_ok=True)
        where = port if "://" in port else str(Path(port).absolute())
        note.write_text(json.dumps({"port": where, "serial": serial}), encoding="utf-8")
    try:
        yield
    finally:
        with suppress(OSError):
            note.unlink()
            note.parent.rmdir()  # unless others serve too
            note.parent.parent.rmdir()  # unless anything else is kept there


def served_ports(environ: Mapping[str, str]) -> list[PortInfo]:
    """Return the ports that living processes of this user serve; notes that a killed one has left are removed."""
    found = []
    with suppress(OSError):
        # A home may be that of several computers: what another one serves is neither here nor gone.
        for note in sorted(_folder(environ).glob(f"{glob.escape(socket.gethostname())}-*.json")):
            noted, number = _read(note), note.stem.rpartition("-")[2]
            if noted is None or not (number.isascii() and number.isdigit() and is_alive(int(number))):
                with suppress(OSError):
                    note.unlink()
            else:
                found.append(PortInfo(noted[0], f"virtual controller {noted[1]}, served by process {number}"))
    return found


def _folder(environ: Mapping[str, str]) -> Path:
    return data_folder(environ) / "served"


def _read(note: Path) -> tuple[str, str] | None:
    try:
        noted = json_of(read_bytes(note))
        return str(noted["port"]), str(noted["serial"])
    except (OSError, ValueError, TypeError, KeyError):
        return None
