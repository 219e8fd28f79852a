"""Tables of actuator models: what a calibration found, its plan, and the errors of models on a virtual actuator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from edmctl.cli.render.terminal import PLAIN, Style, render_columns
from edmctl.quantity import half_width
from edmctl.wording import count, decimal, duration, with_u95

if TYPE_CHECKING:
    from edmctl.actuator.identification import Identification
    from edmctl.actuator.validation import ErrorFigures
    from edmctl.jobs.actuator_trial import ModelErrors, PaperTrial, WaveformResult
    from edmctl.jobs.calibrate import CalibrationReport, FileFigures, LeverFound
    from edmctl.procedures.calibration import CalibrationPlan

    Errors = ErrorFigures | FileFigures

_MAXWELL = "Maxwell, no creep"
MODEL_NAMES = {"line": "straight line", "maxwell": _MAXWELL, "paper": _MAXWELL, "ours": "edmctl"}
"""`maxwell` is fitted to all the data, `paper` to one slow cycle."""
SMALL_RANGE_UM = 100.0
"""Errors on a smaller range have three decimals."""
_NAME_WIDTH = 15


_ERRORS = ["max µm", "RMS µm", "max %", "RMS %"]


def render_calibration(
    found: CalibrationReport, lever: LeverFound | None = None, style: Style = PLAIN
) -> str:
    """Render the errors of the models, the properties of the actuator, and what is not accepted and why."""
    rows = [
        *_models(found.held_out_baselines, found.held_out),
        ("edmctl, noise taken off", found.identification.held_out_model),
        ("edmctl, fitted data", found.identification.train),
    ]
    blocks = [_errors("held-out blocks", rows, style)]
    if found.validated is not None:
        blocks.append(_validation(found, found.validated, style))
    blocks.append("\n".join([*_properties(found.identification), *([render_lever(lever)] if lever else [])]))
    verdict = found.identification
    accepted = [f"Accepted {one}" for one in verdict.restrictions] or ["Accepted."]
    verdicts = [f"Not accepted: {problem}" for problem in verdict.problems] or accepted
    blocks.append("\n".join([*verdicts, *(f"Note: {note}" for note in verdict.notes)]))
    return "\n\n".join(blocks)


def _models(baselines: Mapping[str, Errors], ours: Errors) -> list[tuple[str, Errors]]:
    return [*((MODEL_NAMES[key], figures) for key, figures in baselines.items()), (MODEL_NAMES["ours"], ours)]


def _errors(title: str, rows: Sequence[tuple[str, Errors]], style: Style) -> str:
    cells = [[name, *_numbers(one, 3 if one.range_um < SMALL_RANGE_UM else 2)] for name, one in rows]
    return render_columns([title, *_ERRORS], cells, style)


def _numbers(errors: Errors | ModelErrors, digits: int = 2) -> list[str]:
    lengths = (decimal(value, digits) for value in (errors.max_um, errors.rms_um))
    return [*lengths, decimal(errors.max_pct), decimal(errors.rms_pct)]


def _validation(found: CalibrationReport, ours: Errors, style: Style) -> str:
    """Errors on the files that were not fitted, and on each of them if there are several."""
    several = len(found.files) > 1
    title = f"{len(found.files)} files" if several else found.files[0].name
    rows = _models(found.validated_baselines, ours)
    if several:
        rows += [(f"edmctl, {file.name}", file) for file in found.files]
    rows += [
        (f"edmctl{f', {file.name}' if several else ''}, screened", file.screened)
        for file in found.files
        if file.screened
    ]
    again = "Gain and zero are" if "gain" in found.refit else "The zero is"
    notes = [f"Note: {file.note}" for file in found.files if file.note]
    return "\n".join([_errors(title, rows, style), f"{again} fitted to each file first.", *notes])


def render_actuator(waveforms: Sequence[WaveformResult], stroke_um: float, style: Style = PLAIN) -> str:
    """Render one row per waveform and model, and what the figures mean."""
    rows = [
        [waveform.name if index == 0 else "", MODEL_NAMES[key], *_numbers(errors)]
        for waveform in waveforms
        for index, (key, errors) in enumerate(waveform.models.items())
    ]
    return "\n".join(
        [
            render_columns(["waveform", "model", *_ERRORS], rows, style, align="<<>"),
            f"Errors against the simulated truth, in percent of the stroke of {decimal(stroke_um)} µm.",
            "Each model gets one zero per waveform (its mean error is taken off): the sensor's zero is not known.",
            "The sensor's gain error stays in.",
        ]
    )


_STARTS = {
    "virgin": "The model begins virgin, with no memory, as a simulation does; the actuator has\nbeen cycled before.",
    "conditioned": "Model and actuator have both been cycled over the whole range before.",
}


def render_paper_trial(trial: PaperTrial, style: Style = PLAIN) -> str:
    """Render the errors of each waveform, and what the paper reads off it beside ours."""
    readings = [
        [reading.figure, reading.what, reading.paper, f"{reading.ours_um:.1f}"]
        for waveform in trial.waveforms
        for reading in waveform.readings
    ]
    errors = [[waveform.name, *_numbers(waveform.errors)] for waveform in trial.waveforms]
    fit = trial.fitted.fit
    notes = [
        f"Model less sensor, in percent of the stroke of {decimal(trial.stroke_um)} µm. The model is Table 1",
        "with k_p = 6e7 N/m and k_a = 6 N/µm; the paper has no numbers of its block H,",
        f"which is fitted to one slow cycle here (max {fit.max_um:.1f} µm, RMS {fit.rms_um:.1f} µm). The zero",
        "of that fit holds for all.",
        _STARTS[trial.start],
    ]
    header = ["figure", "error", "paper µm", "ours µm"]
    blocks = [render_columns(header, readings, style, align="<<>")] if readings else []
    return "\n\n".join([*blocks, render_columns(["waveform", *_ERRORS], errors, style), "\n".join(notes)])


def render_lever(lever: LeverFound) -> str:
    """Render the lever factor alone."""
    return f"{'lever factor':{_NAME_WIDTH}}{lever.factor:.3f} ± {lever.u95:.3f}"


def render_plan(plan: CalibrationPlan, style: Style = PLAIN) -> str:
    """Render the slow legs with the times they begin at, what follows them, and the whole."""
    rows, time_s = [], 0.0
    for leg in plan.legs:
        rows.append([f"{time_s:.1f}", f"{leg.u_v:.1f}", f"{leg.duration_s:.3f}"])
        time_s += leg.duration_s
    others = [
        f"Then {count(len(moves))} {what} in {duration(sum(leg.duration_s for leg in moves))}."
        for moves, what in (
            (plan.fast, "moves of 5 to 50 Hz about three voltages"),
            (plan.use, "moves as a job makes them: swings, steps, a gap servo's feed and jumps"),
        )
        if moves
    ]
    legs = count(len(plan.legs) + len(plan.fast) + len(plan.use))
    total = (
        f"{legs} legs between 0 V and {plan.high_v:.1f} V in {duration(plan.duration_s)} or more, "
        f"{count(plan.samples)} samples or more, without pulses, at the parking place."
    )
    return "\n".join([render_columns(["at s", "to V", "in s"], rows, style, align=">"), *others, total])


def _properties(found: Identification) -> list[str]:
    model, bands = found.model, found.bands
    stroke_sd_um = bands.gain_sd_um_per_v * (model.high_v - model.low_v)
    loop_width = with_u95(100.0 * bands.loop_width, half_width(100.0 * bands.loop_width_sd))
    creep = with_u95(100.0 * bands.gamma_per_decade, half_width(100.0 * bands.gamma_sd_per_decade))
    mean_um, most_um = half_width(bands.displacement_sd_um), half_width(bands.displacement_sd_max_um)
    stroke = with_u95(model.stroke_um, half_width(stroke_sd_um))
    lines = {
        "stroke": f"{stroke} µm from {model.low_v:.1f} V to {model.high_v:.1f} V",
        "gain": f"{with_u95(bands.gain_um_per_v, half_width(bands.gain_sd_um_per_v), 4)} µm/V",
        "loop width": f"{loop_width} % of the stroke",
        "creep": f"{creep} % per decade of time",
        "delay": f"{1000.0 * model.delay_s:.2f} ms",
        **({"lag": f"{1000.0 * model.lag_s:.2f} ms"} if model.lag_s else {}),
        "noise": f"{found.noise.sd_um:.3f} µm (1 sd) in a sample, {found.noise.largest_um:.2f} µm at most in all",
        "displacement": f"± {mean_um:.3f} µm on average, ± {most_um:.3f} µm at most (refits and held-out error)",
    }
    by_sensor = (
        "All of it on the scale of the sensor: how far that is off (`sensor.gain_u_rel`) is in none of the ±."
    )
    return [*(f"{name:{_NAME_WIDTH}}{text}" for name, text in lines.items()), by_sensor]
