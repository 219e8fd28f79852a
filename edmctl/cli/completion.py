"""What a shell offers for a half-written word: profiles, keys, ports, figures and runs.

Names go through the shell: only those that no shell can take for anything else are offered.
"""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

_PLAIN = re.compile(r"[\w./][\w./:@%+=-]*", re.ASCII)
"""A name that means itself in every shell, and no option to a command."""


def profiles(incomplete: str) -> list[str]:
    """Shipped profiles; files are the shell's own business."""
    from edmctl.profile.shipped import shipped_names

    return _offered(shipped_names(), incomplete)


def keys(incomplete: str) -> list[str]:
    """Keys of a profile with their tables, `target.depth_um=`; a value comes after them."""
    from edmctl.profile.fields import keys_at
    from edmctl.profile.model import Profile

    def below(path: tuple[str, ...]) -> list[str]:
        inner = keys_at(Profile, path)
        return [name for key in inner for name in below((*path, key))] if inner else [f"{'.'.join(path)}="]

    return _offered(below(()), incomplete)


def ports(incomplete: str) -> list[str]:
    """Virtual machines, serial ports of this computer, and `auto`."""
    from edmctl.link.ports import listed_ports

    return _offered(("auto", "sim:", "socket://", *(port.device for port in listed_ports())), incomplete)


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
    from edmctl.cli.run_opening import RUNS

    found: list[tuple[float, str]] = []
    with suppress(OSError):
        for path in RUNS.glob(f"*{ending}"):
            with suppress(OSError):  # gone meanwhile, or a link that leads nowhere
                found.append((path.stat().st_mtime, path.name.removesuffix(ending)))
    return [name for _, name in sorted(found, reverse=True)]


def _offered(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete) and _PLAIN.fullmatch(name)]
