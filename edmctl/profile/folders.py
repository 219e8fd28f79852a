"""Where profiles and calibrations are found; nothing heavy is loaded for that."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, TypeAlias
from urllib.parse import quote

from edmctl.errors import UsageError
from edmctl.files import path_variable, user_path
from edmctl.wording import did_you_mean

HOME_VARIABLE = "EDMCTL_HOME"
CALIBRATION_VARIABLE = "EDMCTL_CALIBRATION"
DRIFT_VARIABLE = "EDMCTL_DRIFT"
SETUP_VARIABLE = "EDMCTL_SETUP"
Kept: TypeAlias = Literal["calibration", "drift"]


def shipped_folder() -> Path:
    """Folder of the shipped profiles: inside an installed package, beside it in a source tree."""
    package = Path(__file__).resolve().parent.parent
    installed = package / "profiles"
    return installed if installed.is_dir() else package.parent / "profiles"


def shipped_profiles() -> dict[str, Path]:
    """Return the files of the shipped profiles by name, sorted."""
    return {path.stem: path for path in sorted(shipped_folder().glob("*.toml"))}


def shipped_studies() -> dict[str, Path]:
    """Return the files of the shipped studies by name, sorted."""
    return {path.stem: path for path in sorted((shipped_folder().parent / "studies").glob("*.toml"))}


def is_path(text: str) -> bool:
    """Whether a value that may be a name or a file is a path: it has a path separator or ends in `.toml`."""
    separators = [separator for separator in (os.sep, os.altsep) if separator]
    return text.lower().endswith(".toml") or any(separator in text for separator in separators)


def as_value(path: Path) -> str:
    """Return a path as the value of an option that also takes names: one of a single part begins with `./`."""
    return str(path) if is_path(str(path)) else os.path.join(os.curdir, path)  # noqa: PTH118 - Path drops `./`


def find_profile(name_or_path: str, folder: Path = Path()) -> Path:
    """Return the file of a profile: a path relative to `folder`, or a shipped name. Raises UsageError E2001."""
    return _find(name_or_path, folder, "profile", shipped_profiles(), "E2001")


def find_study(name_or_path: str) -> Path:
    """Return the file of a study: a path, or the name of a shipped study. Raises UsageError E2100 if neither."""
    return _find(name_or_path, Path(), "study", shipped_studies(), "E2100")


def _find(given: str, folder: Path, what: str, shipped: Mapping[str, Path], code: str) -> Path:
    if given in shipped:
        return shipped[given]
    path, hint = user_path(given, folder), ""
    try:
        is_there = path.is_symlink() or path.exists()
    except (OSError, ValueError):
        is_there = False
    if is_path(given):
        if is_there:
            return path  # reading it reports what it is if it is no file
        message = f"There is no {what} file {path}."
        if path.stem in shipped:
            hint = f"Write {path.stem} for the shipped {what}. "
    else:
        message = f"There is no shipped {what} {given!r}."
        if given and is_there:
            hint = f"Write {as_value(path)} for the file of that name. "
    hint = hint or did_you_mean(path.stem, shipped)
    names = f"Shipped: {', '.join(shipped)}. A value with a path separator or .toml is a file."
    raise UsageError(message, hint=hint + names, code=code)


def file_in_words(path: Path) -> str:
    """Return which file that is: a shipped one by its name, any other by its path."""
    shipped = path in (*shipped_profiles().values(), *shipped_studies().values())
    return f"{path.stem} (shipped with edmctl)" if shipped else str(path)


def is_file(path: Path) -> bool:
    """Whether there is such a file; a name that no file can have, or a closed folder, has none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def data_folder(environ: Mapping[str, str]) -> Path:
    """Folder of what edmctl keeps: $EDMCTL_HOME, else where the system wants such data of a user."""
    import platformdirs

    return path_variable(HOME_VARIABLE, environ) or platformdirs.user_data_path("edmctl", appauthor=False)


def own_setup_path(serial: str, environ: Mapping[str, str]) -> Path:
    """File of the settings of the machine with that serial number, in $EDMCTL_HOME or the user's configuration."""
    import platformdirs

    home = path_variable(HOME_VARIABLE, environ)
    return (
        home or platformdirs.user_config_path("edmctl", appauthor=False)
    ) / f"setup-{_file_name(serial)}.toml"


def _file_name(serial: str) -> str:
    """Return a serial number as part of a file name; characters that no file name holds become %XX."""
    return quote(serial, safe=" ")


def kept_path(kind: Kept, serial: str, environ: Mapping[str, str], *, lasting: bool = True) -> Path:
    """Calibration or drift file of a machine; that of a virtual one without state is used only where named."""
    folder = data_folder(environ) / kind
    return (folder if lasting else folder / "fresh") / f"{_file_name(serial)}.toml"


def creep_path(serial: str, environ: Mapping[str, str]) -> Path:
    """File of the residual creep after the last use of the machine with that serial number."""
    return kept_path("drift", serial, environ).with_name(f"{_file_name(serial)}.creep.json")


def find_kept(
    kind: Kept, environ: Mapping[str, str], stated: str | None, serial: str | None, option: Path | None = None
) -> Path | None:
    """Return the file of option, environment or setup (`stated`), else that of the machine, if there is one."""
    variable = CALIBRATION_VARIABLE if kind == "calibration" else DRIFT_VARIABLE
    if named := option or path_variable(variable, environ) or stated:
        return Path(named)
    own = None if serial is None else kept_path(kind, serial, environ)
    return own if own is not None and own.is_file() else None
