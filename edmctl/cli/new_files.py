"""Files that a command leaves: none takes the place of another, and what cannot be written is refused."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.errors import RunFileError

if TYPE_CHECKING:
    from pathlib import Path


def check_free(path: Path) -> None:
    """Raise RunFileError E9011 when there is something of that name."""
    if path.exists():
        raise _taken(path)


def write(path: Path, content: bytes) -> None:
    """Write a file of that name. Raises RunFileError: E9011 it exists, E9012 it cannot be written."""
    from edmctl.record.disk import write_new

    try:
        write_new(path, content)
    except FileExistsError:
        raise _taken(path) from None
    except OSError as refused:
        raise unwritable(str(path), str(refused.strerror), "Check folder and space.") from refused


def unwritable(what: str, why: str, hint: str) -> RunFileError:
    """Return the error E9012 for a file that cannot be written."""
    return RunFileError(f"Cannot write {what}: {why}.", hint=hint, code="E9012")


def _taken(path: Path) -> RunFileError:
    return RunFileError(
        f"{path} exists already and is not overwritten.", hint="Choose another name.", code="E9011"
    )
