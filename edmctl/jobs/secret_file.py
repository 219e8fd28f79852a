"""The secret that both ends of a socket know, from a file of its own."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.errors import UsageError
from edmctl.files import read_bytes
from edmctl.link.gate import LEAST_SECRET

if TYPE_CHECKING:
    from collections.abc import Mapping

SECRET_VARIABLE = "EDMCTL_SECRET_FILE"


def asks_for_secret(*ports: str) -> bool:
    """Whether one of the ports may ask for a secret."""
    return any(port.lower().startswith("socket://") for port in ports)


def secret_of(named: str | None, environ: Mapping[str, str]) -> bytes:
    """Return the secret in the file that $EDMCTL_SECRET_FILE names, else in that `named`; empty without either."""
    path = environ.get(SECRET_VARIABLE) or named
    return read_secret(Path(os.path.expanduser(path))) if path else b""  # noqa: PTH111 - knows every user, or none


def read_secret(path: Path) -> bytes:
    """Return what a secret file holds, without blanks about it.

    Raises UsageError E2047: it cannot be read, others may read it, or it is too short.
    """
    try:
        secret, mode = read_bytes(path).strip(), path.stat().st_mode
    except OSError as error:
        raise _unfit(f"Cannot read the secret file {path}: {error.strerror}.") from error
    if os.name == "posix" and mode & 0o077:
        raise _unfit(f"Others may read the secret file {path}.", f"`chmod 600 {path}`")
    if len(secret) < LEAST_SECRET:
        raise _unfit(f"The secret in {path} is shorter than {LEAST_SECRET} bytes.")
    return secret


def _unfit(message: str, remedy: str = "") -> UsageError:
    made = "`(umask 077; openssl rand -hex 32 > FILE)` makes one; the computers at both ends need the same."
    return UsageError(message, hint=remedy or made, code="E2047")
