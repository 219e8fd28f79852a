"""An overview of the run files in a folder, from a few values of each."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edmctl.errors import RunFileError
from edmctl.labels import weakest, worst
from edmctl.record.create import NO_EXIT_CODE
from edmctl.record.disk import PARTIAL
from edmctl.record.events import error_code_of
from edmctl.record.layout import RESULTS
from edmctl.record.locks import is_live
from edmctl.record.reader import RunFile, reading_unverified
from edmctl.record.results import estimated_depth, left_site
from edmctl.results.run_file import RunHead, Unreadable
from edmctl.wording import plain_number

ENDINGS = (".h5", f".h5{PARTIAL}")
RUNNING, INTERRUPTED = "running", "interrupted"
_RESULTS = ("depth", "depth_u95", "wear", "wear_u95", "machining_time", "through")
_WORDS = ("depth_basis", "wear_basis", "verdict")


def heads_of(folder: Path) -> Iterator[RunHead | Unreadable]:
    """Read the heads of the run files in `folder`, by name. The file of a killed run that was recovered is left out.

    Raises RunFileError E9005 when the folder cannot be read.
    """
    found: list[RunHead | Unreadable] = [_looked_at(path) for path in run_files(folder)]
    complete = {(head.path.name, head.run_id) for head in found if isinstance(head, RunHead)}
    for head in found:
        recovered = head.path.name.removesuffix(PARTIAL)
        if not (
            isinstance(head, RunHead)
            and head.path.suffix == PARTIAL
            and head.status != RUNNING
            and (recovered, head.run_id) in complete
        ):
            yield head


def run_files(folder: Path) -> list[Path]:
    """Return what is called like a run file in `folder`, by name. Raises RunFileError E9005."""
    try:
        return sorted(path for path in folder.iterdir() if path.name.endswith(ENDINGS))
    except OSError as error:
        raise RunFileError(
            f"The folder {folder} cannot be read: {error.strerror}.",
            code="E9005",
            hint="Give the folder that the runs were written to (--out).",
        ) from error


def read_head(path: Path) -> RunHead:
    """Read the head of a run file. Its check sum is not compared. Raises RunFileError E9005–E9007."""
    with reading_unverified(path) as run:
        return _head(run)


def _looked_at(path: Path) -> RunHead | Unreadable:
    try:
        return read_head(path)
    except RunFileError as error:
        size_bytes, changed_s = _stat(path)
        return Unreadable(path, size_bytes, changed_s, error)


def _stat(path: Path) -> tuple[int, float]:
    try:
        stat = path.lstat()
    except OSError:
        return 0, 0.0
    return stat.st_size, stat.st_mtime


def _head(run: RunFile) -> RunHead:
    exit_code = int(run.number("/entry/exit_code"))
    results = run.fields(RESULTS.path, _RESULTS, ("site", *_WORDS))
    touched = {} if len(results) else run.summary() or {}
    machining_time_s = float(np.sum(results["machining_time"])) if len(results) else math.nan
    if exit_code and len(results) > 1 and (left := left_site(run)):
        # A mean tells of holes that are finished, where there are some.
        finished = [row["site"] != left.encode()[:32] for row in results]
        results = results[finished]
    blind = results[results["through"] == 0] if len(results) else results
    words = {name: [one.decode(errors="replace") for one in results[name]] for name in _WORDS}
    estimated = estimated_depth(run)
    return RunHead(
        path=run.path,
        size_bytes=run.path.stat().st_size,
        run_id=run.text("/entry/run_id"),
        parent_run=run.text("/entry/parent_run"),
        name=str(run.profile_value("meta.name") or run.path.stem),
        title=run.text("/entry/title"),
        start_time=run.text("/entry/start_time"),
        end_time=run.text("/entry/end_time"),
        status=status_of(run),
        exit_code=None if exit_code == NO_EXIT_CODE else exit_code,
        error_code=error_code_of(run) if exit_code else "",
        simulated=run.is_simulated,
        seed=run.seed,
        work=run.text("/entry/sample/material"),
        tool=run.text("/entry/tool/material"),
        sites=len(results),
        through=int(np.sum(results["through"])),
        depth_um=_mean(blind["depth"]) if len(results) else plain_number(touched.get("depth_um")),
        depth_u95_um=_mean(blind["depth_u95"]) if len(results) else plain_number(touched.get("depth_u95_um")),
        est_depth_um=estimated.depth_um,
        est_depth_u95_um=estimated.depth_u95_um,
        wear_um=_mean(results["wear"]) if len(results) else plain_number(touched.get("wear_um")),
        wear_u95_um=_mean(results["wear_u95"]) if len(results) else plain_number(touched.get("wear_u95_um")),
        machining_time_s=machining_time_s,
        depth_basis=weakest(words["depth_basis"]) or str(touched.get("depth_basis") or ""),
        wear_basis=weakest(words["wear_basis"]) or str(touched.get("wear_basis") or ""),
        verdict=worst(words["verdict"]),
    )


def status_of(run: RunFile) -> str:
    """Return how the run ended, `running` while its writer lives, or `interrupted` when that was killed."""
    if run.is_finished:
        return run.text("/entry/status")
    return RUNNING if is_live(run.path) else INTERRUPTED


def _mean(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(np.mean(known)) if len(known) else math.nan
