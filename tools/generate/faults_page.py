"""The faults in docs/faults.md, for the person at the machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from edmctl.link.faults import FaultRow
    from tools.generate.schema import Schema

_GROUPS = (
    (1000, "The line"),
    (2000, "Motion"),
    (3000, "Discharges and generator"),
    (4000, "Interlocks"),
    (5000, "The controller itself"),
    (7000, "What edmctl finds by itself"),
)
_WHO = {
    "host": "computer",
    "both": "controller and the computer",
    "controller": "controller",
}


def sections(schema: Schema, faults: Sequence[FaultRow]) -> str:
    """Return a section for each group of faults; messages have the defaults of the parameters that they name."""
    # A whole number is written without a decimal point.
    defaults = {p.name: int(p.default) if p.default % 1 == 0 else p.default for p in schema.params}
    parts = []
    for first, title in _GROUPS:
        parts.append(f"## {title}\n")
        parts += [_section(row, defaults) for row in faults if first <= row.code < first + 1000]
    return "\n".join(parts)


def _section(row: FaultRow, defaults: Mapping[str, float]) -> str:
    code, message = row.code, row.message
    after = f"`edmctl reset --ack {code}`." if row.latched else "Nothing is latched; start the job again."
    return (
        f"### {code} {row.name}\n\n"
        f"{message.format_map(defaults)}\n\n"
        f"- What to do: {row.hint}\n"
        f"- Afterwards: {after}\n"
        f"- Noticed by the {_WHO[row.who]}: {row.detect}.\n"
        f"- Pulses off within {row.pulses_off_s:g} s; then: {row.reaction}.\n"
        f"- Error `{row.error}`, exit code {row.exit_code}.\n"
    )
