"""Makes the picture and the sample result of the README from a real run: `python docs/images/terminal.py`."""

from __future__ import annotations

import contextlib
import io
import os
import re
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.cli.job import Order, carry_out, check
from edmctl.cli.machine import closing_text
from edmctl.cli.runfile import RunName
from edmctl.console.style import PLAIN

if TYPE_CHECKING:
    from edmctl.procedures.results import Progress

HERE = Path(__file__).resolve().parent
README = HERE.parents[1] / "README.md"
SEED = 2
RUN_ID = "cu270-20260131T101500.250Z"
SHOWN_AT_UM = 117.0
"""The moment of the picture: well into the first cut."""
WIDTH = 100


class Snapshot:
    """Keeps the notes up to the moment of the picture, and the state then."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.state: Progress | None = None

    def progress(self, p: Progress) -> None:
        """Keep the first state past the moment."""
        if self.state is None and p.depth_um > SHOWN_AT_UM and p.time_left_s > 0:
            self.state = p

    def note(self, text: str) -> None:
        """Keep what was said before it."""
        if self.state is None:
            self.notes.append(text)


def main() -> None:
    """Run the main job once; write machine.svg and the block in the README."""
    plan = check(Order(profile="cu270", overrides=(), setup=None, port=None))
    snapshot = Snapshot()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        os.environ["EDMCTL_HOME"] = folder  # no calibration of this machine's own
        name = RunName(RUN_ID, Path("runs") / f"{RUN_ID}.h5", datetime.now(UTC))
        report = carry_out(plan, SEED, snapshot, name)
    result = closing_text(report, SEED, PLAIN)
    (HERE / "machine.svg").write_text(_picture(snapshot), encoding="utf-8")
    block = f"<!-- result -->\n```text\n{result}\n```\n<!-- end -->"
    readme = README.read_text(encoding="utf-8")
    README.write_text(
        re.sub(r"<!-- result -->.*?<!-- end -->", block, readme, flags=re.DOTALL), encoding="utf-8"
    )


def _picture(snapshot: Snapshot) -> str:
    from rich.console import Console
    from rich.text import Text

    from edmctl.console.live import draw_progress

    assert snapshot.state is not None
    console = Console(record=True, width=WIDTH, file=io.StringIO(), force_terminal=True, highlight=False)
    console.print(Text(f"$ edmctl machine --profile profiles/cu270.toml --seed {SEED}", style="bold"))
    for note in snapshot.notes:
        console.print(Text(note, style="dim"))
    console.print(draw_progress(snapshot.state))
    svg = console.export_svg(title="edmctl", unique_id="edmctl")
    # The picture shall not load fonts from elsewhere.
    return re.sub(r"@font-face \{.*?\}\s*", "", svg, flags=re.DOTALL)


if __name__ == "__main__":
    main()
