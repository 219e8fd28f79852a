"""Writes what is made from data files and models: `python -m tools.generate [--check]`, from the project's folder.

Made are edmctl/failures.py, messages.py and edmlink1.json in edmctl/link/, headers and tables in firmware/, the
marked parts of pages in docs/ and the block diagram of one.
With --check nothing is written; the exit code is 1 where a file is out of date.
"""

from __future__ import annotations

import sys
from pathlib import Path

from edmctl.link.faults import FAULTS, FaultRow
from tools.generate import (
    actuator_page,
    failures,
    faults_page,
    firmware,
    machine_diagram,
    machine_page,
    math_tables,
    profile_page,
    protocol_page,
    run_file_page,
    shared_records,
    study_page,
)
from tools.generate.messages import messages_source
from tools.generate.schema import Schema, load_schema
from tools.generate.text import filled, formatted

_ROOT = Path(__file__).parents[2]


def _schema_and_faults() -> tuple[Schema, list[FaultRow]]:
    return load_schema(), list(FAULTS.values())


def _sources() -> dict[Path, str]:
    """Return what the library is built with; pages need the library."""
    firmware_folder = _ROOT / "firmware"
    schema, faults = _schema_and_faults()
    return {
        _ROOT / "edmctl" / "failures.py": formatted(failures.failures_source()),
        _ROOT / "edmctl" / "link" / "messages.py": formatted(messages_source(schema, faults)),
        _ROOT / "edmctl" / "link" / "edmlink1.json": schema.canonical_json() + "\n",
        firmware_folder / "gen" / "edmlink.h": firmware.header(schema, faults),
        firmware_folder / "gen" / "edmlink.c": firmware.tables(schema),
        firmware_folder / "plant" / "plant_records.h": shared_records.plant_header(),
        firmware_folder / "math" / "tables.h": math_tables.header(),
        firmware_folder / "host" / "host_records.h": shared_records.host_header(),
    }


def _pages() -> dict[Path, str]:
    """Return what each page and picture must hold."""
    schema, faults = _schema_and_faults()
    parts = {
        "protocol.md": protocol_page.tables(schema, faults),
        "exit-codes.md": failures.page_tables(),
        "faults.md": {"faults": faults_page.sections(schema, faults)},
        "profile.md": profile_page.tables(),
        "run-file.md": {"layout": run_file_page.layout_tables()},
        "actuator.md": actuator_page.tables(),
        "study.md": study_page.tables(),
        "build-the-machine.md": machine_page.tables(),
    }
    docs = _ROOT / "docs"
    return {docs / "images" / "build-the-machine.svg": machine_diagram.picture()} | {
        docs / name: filled((docs / name).read_text(encoding="utf-8"), made_parts)
        for name, made_parts in parts.items()
    }


def main(arguments: list[str]) -> int:
    """Write or check; return the exit code."""
    check = arguments == ["--check"]
    if arguments and not check:
        sys.stderr.write("usage: python -m tools.generate [--check]\n")
        return 2
    stale = 0
    for wanted in (_sources, _pages):
        for path, text in wanted().items():
            if path.exists() and path.read_text(encoding="utf-8") == text:
                continue
            stale += 1
            sys.stdout.write(f"{path.name} {'is out of date' if check else 'written'}\n")
            if not check:
                path.write_text(text, encoding="utf-8")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
