"""What a shell offers for a half-written word: profiles, keys, ports, figures and runs.

Names go through the shell: only those that no shell can take for anything else are offered.

A shell adds a blank behind the one word that is left. Where a value comes next, words with one are offered too, so
that what they share is put in, and nothing behind it.
"""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

_PLAIN = re.compile(r"[\w./][\w./:@%+=-]*", re.ASCII)
"""A name that means itself in every shell, and no option to a command."""


def profiles(incomplete: str) -> list[str]:
    """Shipped profiles; files are the shell's own business."""
    from edmctl.profile.folders import shipped_profiles

    return _offered(shipped_profiles(), incomplete)


def studies(incomplete: str) -> list[str]:
    """Shipped studies; files are the shell's own business."""
    from edmctl.profile.folders import shipped_studies

    return _offered(shipped_studies(), incomplete)


def keys(incomplete: str) -> list[str]:
    """Keys that can be set, with their tables, `target.depth_um=`; of one that is left alone, its values too."""
    from edmctl.profile.model import Profile
    from edmctl.profile.tables import choices_at

    return _keys(incomplete, lambda path: choices_at(Profile, path) or ["VALUE"])


def swept(incomplete: str) -> list[str]:
    """Keys to sweep; of one that is left alone, how a sweep is written."""
    return _keys(incomplete, lambda _: ["START:STOP:COUNT"])


def _keys(incomplete: str, values: Callable[[tuple[str, ...]], list[str]]) -> list[str]:
    from edmctl.profile.model import Profile
    from edmctl.profile.tables import keys_at, lists_tables

    def below(path: tuple[str, ...]) -> list[tuple[str, ...]]:
        inner = [] if lists_tables(Profile, path) else keys_at(Profile, path)
        return [found for key in inner for found in below((*path, key))] if inner else [path]

    found = {f"{'.'.join(path)}=": path for path in below(())}
    left = [key for key in found if key.startswith(incomplete) or incomplete.startswith(key)]
    if len(left) == 1:
        left += [f"{left[0]}{value}" for value in values(found[left[0]])]
    return _offered(left, incomplete)


def ports(incomplete: str) -> list[str]:
    """Virtual machines, serial ports of this computer, and `auto`."""
    from edmctl.link.ports import listed_ports

    devices = (port.device for port in listed_ports())
    return _offered(("auto", "sim:", "socket://", "socket://HOST:PORT", *devices), incomplete)


def figures(incomplete: str) -> list[str]:
    """Kinds of figures."""
    from edmctl.report.kinds import NAMES

    return _offered(NAMES, incomplete)


def runs(incomplete: str) -> list[str]:
    """Ids of the runs in the folder where they are looked for, the newest first; paths are the shell's business."""
    return _offered(_ids(".h5"), incomplete)


def unfinished(incomplete: str) -> list[str]:
    """Likewise of those that a journal or a file without an end tells to be unfinished."""
    return _offered(dict.fromkeys((*_ids(".journal"), *_ids(".h5.partial"))), incomplete)


def _ids(ending: str) -> list[str]:
    from edmctl.jobs.runs.opening import RUNS

    found: list[tuple[float, str]] = []
    with suppress(OSError):
        for path in RUNS.glob(f"*{ending}"):
            with suppress(OSError):  # gone meanwhile, or a link that leads nowhere
                found.append((path.stat().st_mtime, path.name.removesuffix(ending)))
    return [name for _, name in sorted(found, reverse=True)]


def _offered(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete) and _PLAIN.fullmatch(name)]
