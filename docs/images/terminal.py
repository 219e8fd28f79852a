"""Makes the picture and the sample result of the README from a real run: `python docs/images/terminal.py`."""

from __future__ import annotations

import contextlib
import html
import os
import re
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.cli.commands.machine import closing_text
from edmctl.cli.render.live import draw_view
from edmctl.cli.render.result_table import render_job
from edmctl.cli.render.terminal import PLAIN, Style
from edmctl.jobs.job import carry_out
from edmctl.jobs.plan import JobRequest, check
from edmctl.jobs.run_header import RunName

if TYPE_CHECKING:
    from edmctl.results.progress import Progress

HERE = Path(__file__).resolve().parent
README = HERE.parents[1] / "README.md"
SEED = 2
RUN_ID = "cu270-20260131T101500.250Z"
SHOWN_AT_UM = 117.0
"""The moment of the picture: well into the first cut."""
WIDTH, HEIGHT = 100, 30
CELL_W, CELL_H, MARGIN, TOP = 8.4, 19.0, 14.0, 42.0
FONT_PX = 14
FONT = "ui-monospace, SFMono-Regular, Menlo, Consolas, 'DejaVu Sans Mono', monospace"
BACKGROUND, BORDER, TEXT = "#161b22", "#444c56", "#e6edf3"
"""A card that stands out from a light page and from a dark one."""
BUTTONS = ("#ff5f57", "#febc2e", "#28c840")
FAINT = "#9aa4af"
INKS = {"2": FAINT, "36": "#56b4e9", "90": "#8b949e", "94": "#2f81d8", "33": "#e69f00", "31": "#ff7b54"}
"""Colours of the live view's inks, for the pulse classes near those of the figures."""


class Snapshot:
    """Keeps the notes up to the moment of the picture, and the live view then."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.view: list[str] = []

    def progress(self, p: Progress) -> None:
        """Keep the first view past the moment."""
        if not self.view and p.depth_um > SHOWN_AT_UM and p.time_left_s > 0:
            lines = draw_view(p, WIDTH, HEIGHT, Style(colour=True, live=True))
            self.view = [text for text, _ in lines]

    def note(self, text: str) -> None:
        """Keep what was said before it."""
        if not self.view:
            self.notes.append(text)


def main() -> None:
    """Run the main job once; write machine.svg and the block in the README."""
    plan = check(JobRequest(profile="cu270", overrides=(), setup=None, port=None))
    snapshot = Snapshot()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        os.environ["EDMCTL_HOME"] = folder  # no calibration of this machine's own
        name = RunName(RUN_ID, Path("runs") / f"{RUN_ID}.h5", datetime.now(UTC))
        report = carry_out(plan, SEED, snapshot, name)
    table = render_job(report.job, report.truths, PLAIN, report.channel_truth)
    result = closing_text(table, PLAIN, report, SEED)
    (HERE / "machine.svg").write_text(_picture(snapshot), encoding="utf-8")
    block = f"<!-- result -->\n```text\n{result}\n```\n<!-- end -->"
    readme = README.read_text(encoding="utf-8")
    README.write_text(
        re.sub(r"<!-- result -->.*?<!-- end -->", block, readme, flags=re.DOTALL), encoding="utf-8"
    )


def _picture(snapshot: Snapshot) -> str:
    assert snapshot.view
    command = f"\x1b[1m$ edmctl machine --profile profiles/cu270.toml --seed {SEED}\x1b[0m"
    lines = [command, *(f"\x1b[2m{note}\x1b[0m" for note in snapshot.notes), *snapshot.view]
    width, height = WIDTH * CELL_W + 2 * MARGIN, len(lines) * CELL_H + MARGIN + TOP
    drawn = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img">',
        "<title>edmctl machine: the live view of a run</title>",
        f"<style>text {{ font: {FONT_PX}px {FONT}; white-space: pre; fill: {TEXT} }}</style>",
        f'<rect x="0.5" y="0.5" width="{width - 1:g}" height="{height - 1:g}" rx="8" '
        f'fill="{BACKGROUND}" stroke="{BORDER}"/>',
    ]
    for i, colour in enumerate(BUTTONS):
        drawn.append(f'<circle cx="{22 + 20 * i}" cy="20" r="6" fill="{colour}"/>')
    for row, line in enumerate(lines):
        drawn += _drawn_line(line, TOP + row * CELL_H)
    return "\n".join([*drawn, "</svg>", ""])


def _drawn_line(line: str, top: float) -> list[str]:
    """The painted text of one line: words as text, bars as shapes, so that no font can shift them."""
    drawn: list[str] = []
    ink, column = "0", 0
    for part in re.split(r"(\x1b\[[0-9;]*m)", line):
        if part.startswith("\x1b"):
            ink = part[2:-1]
            continue
        for match in re.finditer(r"█+|▒+|─+|│| +|(?:[^ █▒─│]| (?! ))+", part):
            run = match[0]
            if run.strip():
                drawn.append(_shape(run, MARGIN + (column + match.start()) * CELL_W, top, ink))
        column += len(part)
    return drawn


def _shape(run: str, left: float, top: float, ink: str) -> str:
    colour, width = INKS.get(ink, TEXT), len(run) * CELL_W
    middle = top + CELL_H / 2
    match run[0]:
        case "█" | "▒":
            opacity = ' opacity="0.45"' if run[0] == "▒" else ""
            return (
                f'<rect x="{left:g}" y="{top + 3:g}" width="{width:g}" height="{CELL_H - 6:g}" '
                f'fill="{colour}"{opacity}/>'
            )
        case "─":
            return f'<path d="M{left:g} {middle:g}h{width:g}" stroke="{colour}"/>'
        case "│":
            at, height = left + CELL_W / 2, CELL_H - 2
            return f'<path d="M{at:g} {top + 1:g}v{height:g}" stroke="{colour}" stroke-width="2"/>'
    weight = ";font-weight:bold" if ink == "1" else ""
    return (
        f'<text x="{left:g}" y="{top + 14:g}" textLength="{width:g}" style="fill:{colour}{weight}">'
        f"{html.escape(run)}</text>"
    )


if __name__ == "__main__":
    main()
