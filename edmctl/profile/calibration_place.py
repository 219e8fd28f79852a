"""Where calibrations are kept, and which one is used; nothing heavy is loaded to find that out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

if TYPE_CHECKING:
    from collections.abc import Mapping

    from edmctl.profile.setup import Setup

HOME_VARIABLE = "EDMCTL_HOME"
CALIBRATION_VARIABLE = "EDMCTL_CALIBRATION"


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


def find_calibration(
    option: Path | None, environ: Mapping[str, str], setup: Setup, serial: str
) -> Path | None:
    """Which calibration file is used: that of the option, $EDMCTL_CALIBRATION, the setup, the machine's own.

    Only the last need not exist: without it there is none. The others were asked for, and loading them says
    what is wrong with them.
    """
    named = option or environ.get(CALIBRATION_VARIABLE) or setup.actuator.calibration
    if named:
        return Path(named)
    own = default_path(serial, environ)
    return own if own.is_file() else None
