"""Run files of every fate, made up in a moment."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

from edmctl.record.rows import EventLevel, EventRow
from edmctl.record.writer import RunWriter
from tests.record.samples import a_meta, fill


def finished(
    folder: Path, run_id: str, start: str = "2026-01-01T12:00:00+00:00", status: str = "done"
) -> Path:
    """A run that came to an end."""
    writer = begun(folder, run_id, start)
    return writer.finish(status, 0 if status == "done" else 6)


def begun(folder: Path, run_id: str, start: str = "2026-01-01T12:00:00+00:00") -> RunWriter:
    """A run that goes on, with everything in its file that it may hold."""
    writer = RunWriter.create(folder / f"{run_id}.h5", replace(a_meta(), run_id=run_id, start_time=start))
    fill(writer, rows=1000)
    writer.append(
        EventRow(1.0, 120, EventLevel.INFO, 'Cut 1: "feed", then touch', {"cut": 1, "feed_um": 20.5})
    )
    writer.flush()
    return writer


def killed(folder: Path, run_id: str) -> Path:
    """What is left of a run whose writer was killed."""
    aside = folder / "aside"
    writer = begun(aside, run_id)
    left = folder / f"{run_id}.h5.partial"
    shutil.copyfile(aside / left.name, left)
    writer.finish("done", 0)
    shutil.rmtree(aside)
    return left
