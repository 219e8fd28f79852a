"""Where profiles and calibrations are found; nothing heavy is loaded for that."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from edmctl.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping

HOME_VARIABLE = "EDMCTL_HOME"
CALIBRATION_VARIABLE = "EDMCTL_CALIBRATION"
DRIFT_VARIABLE = "EDMCTL_DRIFT"


def shipped_folder() -> Path:
    """Folder of the shipped profiles: inside an installed package, beside it in a source tree."""
    package = Path(__file__).resolve().parent.parent
    installed = package / "profiles"
    return installed if installed.is_dir() else package.parent / "profiles"


def shipped_names() -> list[str]:
    """Names of the shipped profiles, sorted."""
    return sorted(path.stem for path in shipped_folder().glob("*.toml"))


def shipped_studies() -> list[Path]:
    """Files of the shipped studies, sorted."""
    return sorted((shipped_folder().parent / "studies").glob("*.toml"))


def find_study(name_or_path: str) -> Path:
    """Path of a study: a file as given, else a shipped one by its name, with or without `.toml`."""
    given = Path(name_or_path)
    if is_file(given):
        return given
    return next((path for path in shipped_studies() if name_or_path in (path.stem, path.name)), given)


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


def data_folder(environ: Mapping[str, str]) -> Path:
    """Folder of what edmctl keeps: $EDMCTL_HOME, else where the system wants such data of a user."""
    home = environ.get(HOME_VARIABLE)
    if home:
        return Path(home)
    import platformdirs

    return platformdirs.user_data_path("edmctl", appauthor=False)


def default_path(serial: str, environ: Mapping[str, str]) -> Path:
    """File of the machine with that serial number; what a file's name cannot hold is written as %XX."""
    return data_folder(environ) / "calibration" / f"{quote(serial, safe=' ')}.toml"


def fresh_path(serial: str, environ: Mapping[str, str]) -> Path:
    """File of a virtual machine that is gone with its command: no machine finds it by itself."""
    return _fresh(default_path(serial, environ))


def default_drift_path(serial: str, environ: Mapping[str, str]) -> Path:
    """File of what `measure-drift` has told of the machine with that serial number, beside its calibration."""
    return data_folder(environ) / "drift" / f"{quote(serial, safe=' ')}.toml"


def creep_path(serial: str, environ: Mapping[str, str]) -> Path:
    """Note of what the last use of the machine with that serial number has left, beside its drift file."""
    return data_folder(environ) / "drift" / f"{quote(serial, safe=' ')}.creep.json"


def fresh_drift_path(serial: str, environ: Mapping[str, str]) -> Path:
    """Drift file of a virtual machine that is gone with its command: no machine finds it by itself."""
    return _fresh(default_drift_path(serial, environ))


def _fresh(own: Path) -> Path:
    return own.parent / "fresh" / own.name


def find_drift(environ: Mapping[str, str], stated: str | None, serial: str | None) -> Path | None:
    """Which drift file is used: that of $EDMCTL_DRIFT, of the setup (`stated`), the machine's own if there is one.

    `serial` is None for a machine that has none of its own.
    """
    if named := environ.get(DRIFT_VARIABLE) or stated:
        return Path(named)
    if serial is None:
        return None
    own = default_drift_path(serial, environ)
    return own if own.is_file() else None


def find_calibration(
    option: Path | None, environ: Mapping[str, str], stated: str | None, serial: str | None
) -> Path | None:
    """Which calibration file is used: that of the option, of $EDMCTL_CALIBRATION, of the setup, the machine's own.

    `stated` is that of the setup, `serial` None for a machine that has none of its own. Only the last need not
    exist: without it there is none. The others were asked for, and loading them says what is wrong with them.
    """
    named = option or environ.get(CALIBRATION_VARIABLE) or stated
    if named:
        return Path(named)
    if serial is None:
        return None
    own = default_path(serial, environ)
    return own if own.is_file() else None
