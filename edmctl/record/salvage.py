"""Recovers a damaged run file in a process of its own, because HDF5 does not survive every damage.

A file that lost its end is completed with zeros first, in a copy: rows before the cut are then found where they
were.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

from edmctl.errors import RunFileError

from .disk import already_there
from .recovery import Recovered, recover, recovered_name
from .superblock import read_superblock

_LONGEST_BYTES = 1 << 40
"""A length beyond this is part of the damage."""
PADDED = ".padded"


def salvage(path: Path, target: Path | None = None) -> Recovered:
    """Recover as `recover` does, without trust in the file. Raises what that raises."""
    target = target or recovered_name(path)
    if target.exists():
        raise already_there(target)
    ended = subprocess.run(
        [sys.executable, "-m", "edmctl.record.salvage", str(path), str(target)],
        capture_output=True,
        text=True,
        check=False,
    )
    try:
        answer = json.loads(ended.stdout)
    except ValueError:
        raise _beyond(path, f"reading it ended with status {ended.returncode}") from None
    if "error" in answer:
        raise RunFileError(answer["error"], code=answer["code"], hint=answer["hint"])
    return Recovered(Path(answer["path"]), answer["rows"], answer["lost_rows"])


def _beyond(path: Path, why: str) -> RunFileError:
    return RunFileError(
        f"{path} is damaged beyond recovery: {why}.", code="E9007", hint="Take the file from a backup."
    )


def _recovered(path: Path, target: Path) -> Recovered:
    missing = _missing_bytes(path)
    if missing <= 0:
        return recover(path, target)
    padded = target.with_name(path.name + PADDED)
    try:
        shutil.copyfile(path, padded)
        with padded.open("r+b") as file:
            file.truncate(padded.stat().st_size + missing)
        return recover(padded, target)
    finally:
        padded.unlink(missing_ok=True)


def _missing_bytes(path: Path) -> int:
    """How much shorter the file is than its superblock says; 0 where that says nothing."""
    end_bytes = read_superblock(path).end_bytes
    if end_bytes is None or end_bytes > _LONGEST_BYTES:
        return 0
    return end_bytes - path.stat().st_size


def main() -> None:
    """Recover for the parent process; the answer is one JSON object."""
    path, target = map(Path, sys.argv[1:])
    try:
        answer = asdict(_recovered(path, target))
    except RunFileError as error:
        told = error if error.code != "E9007" else _beyond(path, error.message.partition(": ")[2].rstrip("."))
        answer = {"error": told.message, "code": told.code, "hint": told.hint}
    print(json.dumps(answer, default=str))  # noqa: T201 - the parent reads it


if __name__ == "__main__":
    main()
