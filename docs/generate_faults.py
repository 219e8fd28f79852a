"""Writes docs/faults.md from the table of faults: `python docs/generate_faults.py [--check]`.

With --check nothing is written; the exit code is 1 where the page is out of date.
"""

from __future__ import annotations

import sys
from pathlib import Path
from string import Formatter

from edmctl.link.faults import FAULTS, FaultRow
from edmctl.link.messages import PARAMS

PAGE = Path(__file__).with_name("faults.md")
GROUPS = (
    (1000, "The line"),
    (2000, "Motion"),
    (3000, "Discharges and generator"),
    (4000, "Interlocks"),
    (5000, "The controller itself"),
    (7000, "What edmctl finds by itself"),
)

HEAD = """\
# When something goes wrong

Made from `edmctl/link/faults.toml` by `python docs/generate_faults.py`.

Whatever happens, the pulses go off first; then the tool retracts to 0 V, and then everything stands still. Nobody
has to be at the computer for that: the controller does it alone. What is left for you:

1. Read the message. It names the fault, and its last line says what to do.
2. Put that right at the machine.
3. Clear the fault: `edmctl reset --ack CODE`, with the `--port` of your machine. The code must be that of the
   fault, so that nobody clears one that nobody has looked at. `edmctl reset` alone tells which one it is.
4. Start the job again. It begins with a touch, so it knows how long the tool is.

An interlock that is still open keeps its fault from being cleared. `edmctl doctor` looks at everything that a job
needs and says beside each thing how to put it right. The two seconds before a latched fault are in the run file,
every millisecond, under `/entry/black_box`.

Times are those from the cause to pulses off, with every parameter at its default.
"""


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for first, title in GROUPS:
        rows = [row for row in FAULTS.values() if first <= row.code < first + 1000]
        parts.append(f"## {title}\n")
        parts += [_section(row) for row in rows]
    return "\n".join(parts)


def _section(row: FaultRow) -> str:
    after = f"`edmctl reset --ack {row.code}`." if row.latched else "Nothing is latched; start the job again."
    return (
        f"### {row.code} {row.name}\n\n"
        f"{_told(row)}\n\n"
        f"- What to do: {row.hint}\n"
        f"- Afterwards: {after}\n"
        f"- Noticed by the {_who(row)}: {row.detect}.\n"
        f"- Pulses off within {row.pulses_off_s:g} s; then: {row.reaction}.\n"
        f"- Error `{row.error}`, exit code {row.exit_code}.\n"
    )


def _told(row: FaultRow) -> str:
    """The message with the defaults of the parameters that it names."""
    names = [name for _, name, _, _ in Formatter().parse(row.message) if name]
    return row.message.format_map({name: PARAMS[name].default for name in names})


def _who(row: FaultRow) -> str:
    return {"host": "computer", "both": "controller and the computer"}.get(row.who, row.who)


def main(arguments: list[str]) -> int:
    """Write or check; return the exit code."""
    wanted = page()
    stale = not PAGE.exists() or PAGE.read_text(encoding="utf-8") != wanted
    if not stale:
        return 0
    if arguments == ["--check"]:
        sys.stdout.write(f"{PAGE.name} is out of date; run python docs/{Path(__file__).name}\n")
        return 1
    PAGE.write_text(wanted, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
