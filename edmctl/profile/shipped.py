"""Profiles that come with the program."""

from __future__ import annotations

import difflib
from pathlib import Path

from edmctl.errors import UsageError


def shipped_folder() -> Path:
    """Folder of the shipped profiles: inside an installed package, beside it in a source tree."""
    package = Path(__file__).resolve().parent.parent
    installed = package / "profiles"
    return installed if installed.is_dir() else package.parent / "profiles"


def shipped_names() -> list[str]:
    """Names of the shipped profiles, sorted."""
    return sorted(path.stem for path in shipped_folder().glob("*.toml"))


def find_shipped(name_or_path: str) -> Path | None:
    """Path of the shipped profile of that name (`cu270`, `cu270.toml`, `profiles/cu270.toml`), if there is one."""
    given = Path(name_or_path)
    if not given.stem or given.parent not in (Path(), Path("profiles")) or given.suffix not in ("", ".toml"):
        return None
    shipped = shipped_folder() / f"{given.stem}.toml"
    return shipped if is_file(shipped) else None


def is_file(path: Path) -> bool:
    """Whether there is such a file; a name that no file can have, or a closed folder, has none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _is_there(path: Path) -> bool:
    try:
        return path.is_symlink() or path.exists()
    except (OSError, ValueError):
        return False


def find_profile(name_or_path: str) -> Path:
    """Path of a profile: a file as given, else a shipped one (`cu270`, `cu270.toml`, `profiles/cu270.toml`).

    Raises UsageError when there is neither.
    """
    given = Path(name_or_path)
    if is_file(given):
        return given
    if shipped := find_shipped(name_or_path):
        return shipped
    if _is_there(given):
        return given  # reading it says what it is instead
    names = shipped_names()
    close = difflib.get_close_matches(given.stem, names, n=1)
    meant = f"Did you mean {close[0]}? " if close else ""
    raise UsageError(
        f"There is no profile {name_or_path!r}: no such file, and no shipped profile of that name.",
        hint=f"{meant}Shipped profiles: {', '.join(names)}.",
        code="E2001",
    )
