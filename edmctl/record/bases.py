"""What the results of a run rest on and how they were judged, also in files from before that was written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.labels import Basis
from edmctl.record.layout import RESULTS, TOUCHES

if TYPE_CHECKING:
    from edmctl.record.reader import RunFile

_NUMBERS = ("stops", "estimated", "through")
_WORDS = ("depth_basis", "wear_basis", "verdict")


@dataclass(frozen=True, slots=True)
class Labels:
    """What depth and wear of a site rest on, and its verdict: empty in older files, and where none was due."""

    depth_basis: str
    wear_basis: str
    verdict: str


def labels_of(run: RunFile) -> list[Labels]:
    """Return the labels of every site of a run, in the order of its results."""
    rows = run.fields(RESULTS.path, _NUMBERS, _WORDS)
    older = [row for row in rows if not row["depth_basis"]]
    touched = Basis.TOUCHED if not older or has_sensor(run) else Basis.MODEL
    return [_labels(row, touched) for row in rows]


def has_sensor(run: RunFile) -> bool:
    """Whether a displacement sensor took the readings; without one they are estimates from the actuator voltage."""
    touches = run.table(TOUCHES.path)
    return not len(touches) or bool(np.isfinite(touches["z_sensor"]).any())


def _labels(row: np.void, touched: Basis) -> Labels:
    depth, wear, verdict = (row[name].decode(errors="replace") for name in _WORDS)
    if depth and wear:
        return Labels(depth, wear, verdict)
    after_last_cut = touched if row["stops"] > 0 and not row["estimated"] > 0.0 else Basis.ESTIMATED
    return Labels(Basis.ESTIMATED if row["through"] else after_last_cut, after_last_cut, verdict)
