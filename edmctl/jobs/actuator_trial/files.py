"""The files that `simulate actuator` leaves: every sample, and a figure. None replaces another."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.errors import UsageError
from edmctl.jobs import output_files

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from edmctl.jobs.actuator_trial.trial import Trial

    Array = NDArray[np.float64]

DATA_SUFFIXES = (".csv", ".h5")


def check_outputs(plot: Path | None, data: Path | None) -> None:
    """Refuse files that could not be written, before minutes of work find out.

    Raises UsageError (E2011 figure's name, E2012 data's), PreconditionError (E8090 no matplotlib), RunFileError
    (E9011 exists, E9012 no folder).
    """
    if data and data.suffix.lower() not in DATA_SUFFIXES:
        raise UsageError(
            f"Data cannot be written into {data.name!r}: its name ends in none of {', '.join(DATA_SUFFIXES)}.",
            hint="Take .csv for spreadsheets and .h5 for long records.",
            code="E2012",
        )
    if plot:
        from edmctl.report.style import check_figure

        check_figure(plot.name)
    for path in (plot, data):
        if path is None:
            continue
        output_files.check_free(path)
        if not path.parent.is_dir():
            raise output_files.unwritable(str(path), f"there is no folder {path.parent}", "Make it first.")


def write_data(trial: Trial, path: Path) -> None:
    """Write every sample; with several waveforms, one after the other under their number in the table."""
    import numpy as np

    from edmctl.record.columns import write_columns

    traces = trial.traces
    columns: dict[str, Array] = {}
    if len(traces) > 1:
        columns["waveform"] = np.concatenate(
            [np.full(trace.t_s.size, float(number)) for number, trace in enumerate(traces, 1)]
        )
    for name, values in {
        "t_s": [trace.t_s for trace in traces],
        "u_V": [trace.applied_v for trace in traces],
        "truth_um": [trace.truth_um for trace in traces],
        "sensor_um": [trace.sensor_um for trace in traces],
        "paper_um": [trace.models_um["paper"] for trace in traces],
        "ours_um": [trace.models_um["ours"] for trace in traces],
        "line_um": [trace.models_um["line"] for trace in traces],
    }.items():
        columns[name] = np.concatenate(values)
    write_columns(path, columns)


def write_figure(trial: Trial, path: Path) -> None:
    """Draw the figure and write it."""
    from edmctl.report.figures import actuator as figure

    panels = [
        figure.Trial(
            waveform.name,
            trace.t_s,
            trace.applied_v,
            trace.truth_um,
            trace.models_um["paper"],
            trace.models_um["ours"],
        )
        for waveform, trace in zip(trial.waveforms, trial.traces, strict=True)
    ]
    output_files.write(path, figure.draw(panels, path.name))
