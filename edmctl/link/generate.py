"""Writes what is made from the protocol's data files: `python -m edmctl.link.generate [--check]`.

Made are messages.py from edmlink1.toml, faults.py from faults.toml, and the marked tables of docs/protocol.md
from both. With --check nothing is written; the exit code is 1 where a file is out of date.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

from edmctl.link.emit.docs import fill_tables
from edmctl.link.emit.faults import faults_source
from edmctl.link.emit.messages import messages_source
from edmctl.link.schema import load_schema

_LINK = Path(__file__).parent
_DOCS = _LINK.parents[1] / "docs" / "protocol.md"


def wanted_files() -> dict[Path, str]:
    """Return what each generated file must hold; the page is left out where only the package is installed."""
    schema = load_schema()
    faults = tomllib.loads((_LINK / "faults.toml").read_text(encoding="utf-8"))["fault"]
    wanted = {
        _LINK / "messages.py": messages_source(schema),
        _LINK / "faults.py": faults_source(faults),
    }
    if _DOCS.exists():
        wanted[_DOCS] = fill_tables(_DOCS.read_text(encoding="utf-8"), schema, faults)
    return wanted


def main(arguments: list[str]) -> int:
    """Write or check; return the exit code."""
    check = arguments == ["--check"]
    if arguments and not check:
        sys.stderr.write("usage: python -m edmctl.link.generate [--check]\n")
        return 2
    stale = [
        (path, text)
        for path, text in wanted_files().items()
        if not path.exists() or path.read_text(encoding="utf-8") != text
    ]
    for path, text in stale:
        sys.stdout.write(f"{path.name} {'is out of date' if check else 'written'}\n")
        if not check:
            path.write_text(text, encoding="utf-8")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
