"""`edmctl simulate actuator`: voltage waveforms through a virtual actuator and the models of it."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from edmctl.cli.options import NOTES, SeedOption, command
from edmctl.cli.outcome import Outcome, stream_style, watching
from edmctl.jobs.sweep import seed_to_use

if TYPE_CHECKING:
    from edmctl.jobs.actuator_trial import Trial
    from edmctl.jobs.actuator_waveforms import Waveform


class Shape(StrEnum):
    """What can be asked for."""

    SINE = "sine"
    SQUARE = "square"
    TRIANGLE = "triangle"
    STEP = "step"
    JUMPS = "jumps"
    SERVO = "servo"
    CSV = "csv"
    ALL = "all"


ShapeArgument = Annotated[
    Shape,
    typer.Argument(
        metavar="WAVEFORM",
        help="sine, square, triangle, step (and 60 s of creep), jumps (of the electrode, while feeding), servo "
        "(200 s of feed with dither), csv (of --from), or all: slow sine, sine, step, jumps and servo.",
        show_default=False,
    ),
]
FrequencyOption = Annotated[
    float | None, typer.Option("--frequency", metavar="HZ", help="Of sine, square and triangle. Default: 1.")
]
CyclesOption = Annotated[
    int | None, typer.Option("--cycles", metavar="N", min=1, help="Of sine, square and triangle. Default: 5.")
]
LowOption = Annotated[float | None, typer.Option("--low", metavar="V", help="Lowest voltage. Default: 0.")]
HighOption = Annotated[
    float | None, typer.Option("--high", metavar="V", help="Highest voltage. Default: 120.")
]
FromOption = Annotated[
    Path | None, typer.Option("--from", metavar="FILE.csv", help="Voltage to apply: columns t_s and u_V.")
]
CalibrationOption = Annotated[
    Path | None,
    typer.Option(
        "--calibration",
        metavar="FILE",
        help="Calibration to judge. Default: one made on the same actuator.",
    ),
]
PlotOption = Annotated[
    Path | None, typer.Option("--plot", metavar="FILE", help="Draw a figure: .png, .svg or .pdf.")
]
DataOption = Annotated[
    Path | None, typer.Option("--data", metavar="FILE", help="Write every sample: .csv or .h5.")
]


@command("simulate actuator", NOTES)
def actuator(
    outcome: Outcome,
    shape: ShapeArgument,
    frequency: FrequencyOption = None,
    low: LowOption = None,
    high: HighOption = None,
    cycles: CyclesOption = None,
    source: FromOption = None,
    calibration: CalibrationOption = None,
    seed: SeedOption = None,
    plot: PlotOption = None,
    data: DataOption = None,
) -> None:
    """Drive a virtual actuator, and say how well models follow it.

    The models are a straight line, the paper's practice (Maxwell elements without creep, fitted to one slow
    cycle), and edmctl's, calibrated as a machine would be: through the displacement sensor.
    """
    from edmctl.jobs.actuator_trial import check_outputs
    from edmctl.jobs.actuator_waveforms import Wanted, waveforms

    outcome.simulated = True
    used_seed = seed_to_use(seed)
    wanted = Wanted(shape.value, frequency, low, high, cycles, source)
    asked = waveforms(wanted)
    check_outputs(plot, data)
    outcome.seed = used_seed
    trial = _try(outcome, asked, calibration, used_seed)
    _report(outcome, trial, plot, data)


def _try(outcome: Outcome, asked: "list[Waveform]", calibration: Path | None, seed: int) -> "Trial":
    """Get the models and drive every waveform."""
    from edmctl.actuator.compiling import compiling_told
    from edmctl.jobs.actuator_trial import known_model, run_trial

    known = None
    if calibration:
        known, doubts = known_model(calibration, seed)
        outcome.warn(doubts)
    with watching(outcome.output) as reporter:
        if not known:
            reporter.note(f"calibrating the virtual actuator of seed {seed}")
        with compiling_told(reporter.note):
            trial = run_trial(asked, known, seed)
    outcome.warn(trial.doubts)
    return trial


def _report(outcome: Outcome, trial: "Trial", plot: Path | None, data: Path | None) -> None:
    """Say the figures; then write the files, so that a full disk leaves the figures known."""
    from edmctl.console.calibration_tables import render_actuator
    from edmctl.jobs.actuator_trial import write_data, write_figure

    result: dict[str, object] = {**trial.as_mapping(), "plot_file": None, "data_file": None}
    outcome.result = result
    outcome.text = render_actuator(trial.waveforms, trial.stroke_um, stream_style(sys.stdout))
    outcome.text += f"\nSimulated, seed {outcome.seed}."
    if data:
        write_data(trial, data)
        result["data_file"] = str(data)
        outcome.text += f" Data {data}"
    if plot:
        write_figure(trial, plot)
        result["plot_file"] = str(plot)
        outcome.text += f" Figure {plot}"
