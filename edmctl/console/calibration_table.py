"""The table of `calibrate`: how well the actuator is known, beside what simpler models would say."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from edmctl.console.model_errors import MODEL_NAMES, ErrorsView
from edmctl.console.style import PLAIN, Style
from edmctl.console.tables import render_columns
from edmctl.wording import U95, count, decimal, duration, with_u95

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

SMALL_RANGE_UM = 100.0
"""Errors on a smaller range are told to the nanometre."""
_NAME_WIDTH = 15


class FiguresView(ErrorsView, Protocol):
    """Errors with the range that was measured, which their percentages are of."""

    @property
    def range_um(self) -> float: ...


class FileView(FiguresView, Protocol):
    """Errors on one validation file."""

    @property
    def name(self) -> str: ...


class BandsView(Protocol):
    """Standard uncertainties with the values that they belong to."""

    @property
    def displacement_sd_um(self) -> float: ...
    @property
    def displacement_sd_max_um(self) -> float: ...
    @property
    def gain_um_per_v(self) -> float: ...
    @property
    def gain_sd_um_per_v(self) -> float: ...
    @property
    def loop_width(self) -> float: ...
    @property
    def loop_width_sd(self) -> float: ...
    @property
    def gamma_per_decade(self) -> float: ...
    @property
    def gamma_sd_per_decade(self) -> float: ...


class ModelView(Protocol):
    """What is told of the model itself."""

    @property
    def stroke_um(self) -> float: ...
    @property
    def delay_s(self) -> float: ...
    @property
    def low_v(self) -> float: ...
    @property
    def high_v(self) -> float: ...


class IdentificationView(Protocol):
    """The model, how sure it is, and what stands against it."""

    @property
    def model(self) -> ModelView: ...
    @property
    def bands(self) -> BandsView: ...
    @property
    def problems(self) -> Sequence[str]: ...
    @property
    def notes(self) -> Sequence[str]: ...


class FindingsView(Protocol):
    """Everything that a calibration found; `validated` is None without validation files."""

    @property
    def identification(self) -> IdentificationView: ...
    @property
    def train(self) -> FiguresView: ...
    @property
    def held_out(self) -> FiguresView: ...
    @property
    def held_out_baselines(self) -> Mapping[str, FiguresView]: ...
    @property
    def validated(self) -> FiguresView | None: ...
    @property
    def validated_baselines(self) -> Mapping[str, FiguresView]: ...
    @property
    def files(self) -> Sequence[FileView]: ...
    @property
    def refit(self) -> Sequence[str]: ...


class LeverView(Protocol):
    """Lever factor with the half-width of its 95 % interval."""

    @property
    def factor(self) -> float: ...
    @property
    def u95(self) -> float: ...


class LegView(Protocol):
    """A straight line to a voltage."""

    @property
    def u_v(self) -> float: ...
    @property
    def duration_s(self) -> float: ...


class PlanView(Protocol):
    """What an actuator will be driven through."""

    @property
    def legs(self) -> Sequence[LegView]: ...
    @property
    def high_v(self) -> float: ...
    @property
    def duration_s(self) -> float: ...
    @property
    def samples(self) -> int: ...


def render_calibration(found: FindingsView, lever: LeverView | None = None, style: Style = PLAIN) -> str:
    """Render the errors of the models, what the actuator is like, and what is not accepted and why."""
    fitted = ("edmctl, fitted data", found.train)
    blocks = [_errors("held-out blocks", [*_models(found.held_out_baselines, found.held_out), fitted], style)]
    if found.validated is not None:
        blocks.append(_validation(found, found.validated, style))
    blocks.append("\n".join([*_properties(found.identification), *_lever_lines(lever)]))
    verdicts = [f"Not accepted: {problem}" for problem in found.identification.problems] or ["Accepted."]
    notes = [f"Note: {note}" for note in found.identification.notes]
    blocks.append("\n".join([*verdicts, *notes]))
    return "\n\n".join(blocks)


def render_lever(lever: LeverView) -> str:
    """Render the lever factor alone."""
    return "\n".join(_lever_lines(lever))


def render_plan(plan: PlanView, style: Style = PLAIN) -> str:
    """Render every leg with the time it begins at, and the whole."""
    rows, time_s = [], 0.0
    for leg in plan.legs:
        rows.append([f"{time_s:.1f}", f"{leg.u_v:.1f}", f"{leg.duration_s:.3f}"])
        time_s += leg.duration_s
    total = (
        f"{len(rows)} legs between 0 V and {plan.high_v:.1f} V in {duration(plan.duration_s)}, "
        f"{count(plan.samples)} samples, without pulses, at the parking place."
    )
    return "\n".join([render_columns(["at s", "to V", "in s"], rows, style, align=">"), total])


def _models(baselines: Mapping[str, FiguresView], ours: FiguresView) -> list[tuple[str, FiguresView]]:
    return [*((MODEL_NAMES[key], figures) for key, figures in baselines.items()), (MODEL_NAMES["ours"], ours)]


def _errors(title: str, rows: Sequence[tuple[str, FiguresView]], style: Style) -> str:
    header = [title, "max µm", "RMS µm", "max %", "RMS %"]
    return render_columns(header, [[name, *_numbers(figures)] for name, figures in rows], style)


def _numbers(figures: FiguresView) -> list[str]:
    digits = 3 if figures.range_um < SMALL_RANGE_UM else 2
    lengths = [f"{value:.{digits}f}" for value in (figures.max_um, figures.rms_um)]
    return [*lengths, decimal(figures.max_pct), decimal(figures.rms_pct)]


def _validation(found: FindingsView, ours: FiguresView, style: Style) -> str:
    """Errors on the files that no model was fitted to, and on each of them where there are several."""
    title = found.files[0].name if len(found.files) == 1 else f"{len(found.files)} files"
    rows = _models(found.validated_baselines, ours)
    if len(found.files) > 1:
        rows += [(f"edmctl, {file.name}", file) for file in found.files]
    again = "Gain and zero are" if "gain" in found.refit else "The zero is"
    return f"{_errors(title, rows, style)}\n{again} fitted to each file first."


def _properties(found: IdentificationView) -> list[str]:
    model, bands = found.model, found.bands
    stroke_sd_um = bands.gain_sd_um_per_v * (model.high_v - model.low_v)
    loop_width = with_u95(100.0 * bands.loop_width, U95 * 100.0 * bands.loop_width_sd)
    creep = with_u95(100.0 * bands.gamma_per_decade, U95 * 100.0 * bands.gamma_sd_per_decade)
    mean_um, most_um = U95 * bands.displacement_sd_um, U95 * bands.displacement_sd_max_um
    stroke = with_u95(model.stroke_um, U95 * stroke_sd_um)
    lines = {
        "stroke": f"{stroke} µm from {model.low_v:.1f} V to {model.high_v:.1f} V",
        "gain": f"{with_u95(bands.gain_um_per_v, U95 * bands.gain_sd_um_per_v, 4)} µm/V",
        "loop width": f"{loop_width} % of the stroke",
        "creep": f"{creep} % per decade of time",
        "delay": f"{1000.0 * model.delay_s:.2f} ms",
        "displacement": f"± {mean_um:.3f} µm on average, ± {most_um:.3f} µm at most (refits and held-out error)",
    }
    by_sensor = (
        "All of it on the scale of the sensor: how far that is off (`sensor.gain_u_rel`) is in none of the ±."
    )
    return [*(f"{name:{_NAME_WIDTH}}{text}" for name, text in lines.items()), by_sensor]


def _lever_lines(lever: LeverView | None) -> list[str]:
    if lever is None:
        return []
    return [f"{'lever factor':{_NAME_WIDTH}}{lever.factor:.3f} ± {lever.u95:.3f}"]
