"""`edmctl simulate actuator`: voltage waveforms through a virtual actuator and the models of it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from edmctl import failures
from edmctl.cli.options import NOTES, SeedOption, command
from edmctl.cli.outcome import Outcome, watching
from edmctl.jobs.sweep import seed_to_use

if TYPE_CHECKING:
    from edmctl.jobs.actuator_trial import PaperTrial, Trial
    from edmctl.jobs.actuator_waveforms import Waveform


Shape = Literal[
    "sine",
    "square",
    "triangle",
    "step",
    "jumps",
    "servo",
    "csv",
    "all",
    "fig3a",
    "fig3b",
    "fig4",
    "fig5",
    "loop",
    "figures",
]
ShapeArgument = Annotated[
    Shape | None,
    typer.Argument(
        metavar="WAVEFORM",
        help="sine, square, triangle, step (and 60 s of creep), jumps (of the electrode, while feeding), servo "
        "(200 s of feed with dither), csv (of --from), or all: slow sine, sine, step, jumps and servo. Those of "
        "the paper: fig3a, fig3b, fig4, fig5, loop, or figures: all of them, the default of --model paper.",
        show_default=False,
    ),
]
ModelOption = Annotated[
    Literal["compared", "paper"],
    typer.Option(
        "--model",
        metavar="compared|paper",
        help="compared: straight line, Maxwell and edmctl against the truth. paper: the electromechanical model of "
        "Muralidhara et al. 2009 against the sensor, beside the paper's own figures.",
    ),
]
StartOption = Annotated[
    Literal["virgin", "conditioned"] | None,
    typer.Option(
        "--start",
        metavar="virgin|conditioned",
        help="What --model paper remembers as it begins. Default: virgin, nothing, as the paper's simulation did.",
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
    shape: ShapeArgument = None,
    model: ModelOption = "compared",
    start: StartOption = None,
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
    """Drive a virtual actuator and report the errors of models.

    The models are a straight line, the paper's practice (Maxwell elements without creep, fitted to one slow
    cycle), and edmctl's, calibrated as a machine would be: through the displacement sensor. With --model paper it
    is the electromechanical model of the paper, with its Table 1.
    """
    from edmctl.cli.render.calibration_tables import render_actuator, render_paper_trial
    from edmctl.jobs import actuator_trial
    from edmctl.jobs.actuator_waveforms import Wanted, waveforms

    outcome.simulated = True
    used_seed = seed_to_use(seed)
    of_paper = model == "paper"
    _refuse_contradictions(shape, start, calibration, of_paper=of_paper)
    asked = waveforms(Wanted(shape or "figures", frequency, low, high, cycles, source))
    actuator_trial.check_outputs(plot, data)
    outcome.seed = used_seed
    made_by = f"simulated, seed {used_seed}"
    if of_paper:
        paper = actuator_trial.run_paper_trial(asked, start or "virgin", used_seed)
        outcome.warn(paper.doubts)
        outcome.show(lambda style: render_paper_trial(paper, style))
        words = f"{made_by}; model begins {paper.start}"
        _write(outcome, paper, data, plot, words)
    else:
        trial = _compared(outcome, asked, calibration, used_seed)
        outcome.show(lambda style: render_actuator(trial.waveforms, trial.stroke_um, style))
        _write(outcome, trial, data, plot, made_by)


def _refuse_contradictions(
    shape: str | None, start: str | None, calibration: Path | None, *, of_paper: bool
) -> None:
    """Raise UsageError for a missing waveform (E2000), and options that do not go with the models (E2010)."""
    if shape is None and not of_paper:
        raise failures.waveform_missing()
    if start is not None and not of_paper:
        raise failures.start_without_paper_model()
    if calibration is not None and of_paper:
        raise failures.calibration_with_paper_model()


def _compared(outcome: Outcome, asked: "list[Waveform]", calibration: Path | None, seed: int) -> "Trial":
    from edmctl.jobs.actuator_trial import known_model, run_trial

    known = None
    if calibration:
        known, doubts = known_model(calibration, seed)
        outcome.warn(doubts)
    with watching(outcome.output) as reporter:
        if not known:
            reporter.note(f"calibrating the virtual actuator of seed {seed}")
        trial = run_trial(asked, known, seed)
    outcome.warn(trial.doubts)
    return trial


def _write(
    outcome: Outcome, trial: "Trial | PaperTrial", data: Path | None, plot: Path | None, words: str
) -> None:
    """Set the result, then write the files, so that a full disk does not hide the errors of the models."""
    from edmctl.jobs.actuator_trial import write_data, write_figure

    result: dict[str, object] = {**trial.as_mapping(), "plot_file": None, "data_file": None}
    outcome.result = result
    outcome.text = f"Simulated, seed {outcome.seed}."
    if data:
        write_data(trial.traces, data)
        result["data_file"] = str(data)
        outcome.text += f" Data {data}"
    if plot:
        write_figure(trial, plot, words)
        result["plot_file"] = str(plot)
        outcome.text += f" Figure {plot}"
