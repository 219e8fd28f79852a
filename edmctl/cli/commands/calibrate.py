"""`edmctl calibrate` and `simulate actuator`: identify an actuator, and try models on a virtual one."""

import os
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from edmctl import failures
from edmctl.cli.options import (
    NOTES,
    PROGRESS,
    ControllerOption,
    DryRunOption,
    PortOption,
    SeedOption,
    SetupOption,
    WaitOption,
    argument,
    command,
    option,
)
from edmctl.cli.outcome import Outcome, watching
from edmctl.cli.signals import ignore_signals, shell
from edmctl.files import path_variable
from edmctl.jobs.sweep import seed_to_use, simulated_by
from edmctl.profile.folders import CALIBRATION_VARIABLE

if TYPE_CHECKING:
    from edmctl.jobs.actuator_trial import PaperTrial, Trial, Waveform
    from edmctl.jobs.calibrate import CalibrationReport, CheckedCalibration, MeasuredRecord

FromOption = Annotated[
    list[Path] | None,
    option(
        "--from FILE",
        "Fit measured data instead of driving a machine: CSV or HDF5 with t_s, u_V, y_um, or a run file. "
        "Repeatable.",
    ),
]
ValidateOption = Annotated[
    list[Path] | None, option("--validate FILE", "Evaluate the model on this file too. Repeatable.")
]
RefitOption = Annotated[
    str,
    option(
        "--refit zero|gain,zero",
        ("What is fitted to each --validate file before it is evaluated; gain for a record of another day."),
    ),
]
PreviousOption = Annotated[
    list[float] | None,
    option(
        "--previous-voltage V",
        "Voltage before the first sample: once for all files, or once for each, --from before --validate."
        " Default: the actuator was cycled over the record's range before.",
    ),
]
DelayOption = Annotated[float | None, option("--delay S", "Delay of the displacement. Default: found.")]
OutputOption = Annotated[
    Path | None,
    option("--output FILE", "Calibration file to write. Default: the machine's own; none with --from."),
]
LeverOption = Annotated[
    Path | None,
    option(
        "--lever FILE",
        "Fit the lever factor to stack and tool displacement (CSV with x_um, z_um); alone, only this is "
        "fitted.",
    ),
]


@command("calibrate", PROGRESS)
def calibrate(
    outcome: Outcome,
    sources: FromOption = None,
    validate: ValidateOption = None,
    refit: RefitOption = "zero",
    previous_voltage: PreviousOption = None,
    delay: DelayOption = None,
    output: OutputOption = None,
    lever: LeverOption = None,
    setup: SetupOption = None,
    port: PortOption = None,
    wait: WaitOption = 0.0,
    seed: SeedOption = None,
    controller: ControllerOption = None,
    dry_run: DryRunOption = False,
) -> None:
    """Identify the actuator and write a calibration.

    The machine drives its actuator for seven minutes beside the workpiece, without pulses, and records the
    displacement sensor. Errors are computed on held-out data.
    """
    from edmctl.jobs.calibrate import CalibrationRequest, check
    from edmctl.jobs.connect import controller_warning, seed_warning

    used_seed = seed_to_use(seed)
    checked = check(
        CalibrationRequest(
            sources=tuple(sources or ()),
            validation=tuple(validate or ()),
            refit=refit,
            previous_v=tuple(previous_voltage or ()),
            delay_s=delay,
            output=output,
            lever=lever,
            setup=setup,
            port=port,
            wait_s=wait,
            controller=controller or "",
        ),
        shell(),
    )
    outcome.simulated = checked.simulated
    useless = [*seed_warning(checked.where, seed), *controller_warning(checked.where, controller)]
    outcome.warn([*checked.doubts, *useless])
    if dry_run:
        _tell_plan(outcome, checked)
    elif checked.plan is None and not checked.sources:
        from edmctl.cli.render.calibration_tables import render_lever

        outcome.result = {"lever": checked.lever}
        if checked.lever is not None:
            outcome.show(render_lever(checked.lever))
    else:
        _run(outcome, checked, used_seed)


def _tell_plan(outcome: Outcome, checked: "CheckedCalibration") -> None:
    from edmctl.cli.render.calibration_tables import render_lever, render_plan

    plan = checked.plan
    outcome.result = {
        "plan": None
        if plan is None
        else {
            "duration_s": plan.duration_s,
            "low_v": 0.0,
            "high_v": plan.high_v,
            "period_s": plan.period_s,
            "samples": plan.samples,
            "legs": plan.legs,
        },
        "from": [_described(given) for given in checked.sources],
        "validate_files": [_described(given) for given in checked.validation],
        "lever": checked.lever,
    }
    if plan:
        outcome.show(lambda style: render_plan(plan, style))
    lines = []
    for word, files in (("Fit", checked.sources), ("Validate", checked.validation)):
        lines += [f"{word} {given.path}: {len(given.record.t_s)} samples." for given in files]
    if checked.lever:
        lines.append(render_lever(checked.lever))
    outcome.text = "\n".join(lines)


def _described(given: "MeasuredRecord") -> dict[str, object]:
    record = given.record
    return {
        "name": record.name,
        "samples": len(record.t_s),
        "duration_s": float(record.t_s[-1] - record.t_s[0]),
        "low_v": float(record.u_v.min()),
        "high_v": float(record.u_v.max()),
        "previous_v": record.previous_v,
    }


def _run(outcome: Outcome, checked: "CheckedCalibration", seed: int) -> None:
    from edmctl.cli.render.calibration_tables import render_calibration
    from edmctl.jobs.calibrate import calibrate_files, calibrate_machine

    with watching(outcome.output) as reporter:
        if checked.plan is None:
            done = calibrate_files(checked, reporter)
        else:
            outcome.seed = checked.where.seed_of(seed)
            done = calibrate_machine(checked, seed, reporter, outcome.warn)
            outcome.simulated = done.simulated
        ignore_signals()
    outcome.result = done.as_mapping()
    outcome.show(lambda style: render_calibration(done, checked.lever, style))
    outcome.text = f"\n{_whereabouts(done, checked, outcome.seed)}"
    outcome.warn(done.warnings)


def _whereabouts(done: "CalibrationReport", checked: "CheckedCalibration", seed: int | None) -> str:
    """Return where the file is and how `machine` uses it."""
    if done.path is None:
        return "Nothing was saved."
    made_by = simulated_by(seed) if done.simulated else ""
    again = "" if seed is None else f" --seed {seed}"
    if checked.where.bench_file is not None:
        again = f" --port {checked.where.selector}"
    saved = f"{made_by}{'Replaced' if done.replaced else 'Saved in'} {done.path}"
    if not done.is_own:
        return f"{saved}: `edmctl machine --profile PROFILE{again} --calibration {done.path}` uses it."
    other = path_variable(CALIBRATION_VARIABLE, os.environ) or checked.setup.actuator.calibration
    if other:
        return f"{saved}; `edmctl machine` uses {other}, which the environment or the setup names."
    return f"{saved}: `edmctl machine --profile PROFILE{again}` uses it on {done.serial} from now on."


Shape = StrEnum("Shape", "SINE SQUARE TRIANGLE STEP JUMPS SERVO CSV ALL FIG3A FIG3B FIG4 FIG5 LOOP FIGURES")


ShapeArgument = Annotated[
    Shape | None,
    argument(
        "WAVEFORM",
        "sine, square, triangle, step (and 60 s of creep), jumps (of the electrode, while feeding), servo"
        " (200 s of feed with dither), csv (of --from), or all: slow sine, sine, step, jumps and servo. "
        "Those of the paper: fig3a, fig3b, fig4, fig5, loop, or figures: all of them, the default of "
        "--model paper.",
    ),
]
ModelOption = Annotated[
    Literal["compared", "paper"],
    option(
        "--model compared|paper",
        "compared: straight line, Maxwell and edmctl against the truth. paper: the electromechanical "
        "model of Muralidhara et al. 2009 against the sensor, beside the paper's own figures.",
    ),
]
StartOption = Annotated[
    Literal["virgin", "conditioned"] | None,
    option(
        "--start virgin|conditioned",
        "What --model paper remembers as it begins. Default: virgin, nothing, as the paper's simulation did.",
    ),
]
FrequencyOption = Annotated[
    float | None, option("--frequency HZ", "Of sine, square and triangle. Default: 1.")
]
CyclesOption = Annotated[int | None, option("--cycles N", "Of sine, square and triangle. Default: 5.", min=1)]
LowOption = Annotated[float | None, option("--low V", "Lowest voltage. Default: 0.")]
HighOption = Annotated[float | None, option("--high V", "Highest voltage. Default: 120.")]
VoltageOption = Annotated[Path | None, option("--from FILE.csv", "Voltage to apply: columns t_s and u_V.")]
KnownOption = Annotated[
    Path | None, option("--calibration FILE", "Calibration to judge. Default: one made on the same actuator.")
]
PlotOption = Annotated[Path | None, option("--plot FILE", "Draw a figure: .png, .svg or .pdf.")]
DataOption = Annotated[Path | None, option("--data FILE", "Write every sample: .csv or .h5.")]


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
    source: VoltageOption = None,
    calibration: KnownOption = None,
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
    from edmctl.jobs.actuator_trial import Wanted, waveforms

    outcome.simulated = True
    used_seed = seed_to_use(seed)
    of_paper = model == "paper"
    if shape is None and not of_paper:
        raise failures.waveform_missing()
    if start is not None and not of_paper:
        raise failures.start_without_paper_model()
    if calibration is not None and of_paper:
        raise failures.calibration_with_paper_model()
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
