"""Waveforms through a virtual actuator (`simulate actuator`), and the errors of models.

Every waveform, the slow cycle and the calibration start from the same unit at rest. Models get only data that a
machine has: the applied voltage and the reading of the displacement sensor, with its gain error, drift and noise.

The comparison judges three models by the true displacement. The trial of Muralidhara et al. 2009 judges the paper's
electromechanical model by the sensor, as the paper does: Table 1 behind a block H, for which the paper gives no
parameters. H is fitted to one slow cycle over the whole range, without creep; the zero of that fit is used for all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from edmctl import failures
from edmctl.actuator import waveforms as waves
from edmctl.actuator.identification import fit_line, fit_maxwell, identify
from edmctl.actuator.model import ActuatorModel, ActuatorState, Estimator
from edmctl.actuator.paper_model import TABLE_1, ElectromechanicalModel, MaxwellModel, Transducer
from edmctl.actuator.record import Record
from edmctl.actuator.validation import ErrorFigures, judge
from edmctl.actuator.waveforms import (
    FIGURE_NAMES,
    Leg,
    Reading,
    calibration_waveform,
    figure_command,
    jump_train,
    readings,
    sampled,
    servo_dither,
    sine,
)
from edmctl.array_types import Array, Flags
from edmctl.dataclasses import asdict, dataclass
from edmctl.errors import Diagnostic
from edmctl.jobs import output_files
from edmctl.jobs.corrections import owner, reaches_down, reaches_up
from edmctl.profile.calibration import Calibration
from edmctl.record.columns import TIME, VOLTAGE, read_columns, write_columns
from edmctl.report.kinds import check_figure
from edmctl.simulator.plant import HIGH_V, LOW_V, RATE_HZ, SLEW_V_S, DrivenTicks, VirtualActuator

SLOW_HZ = 0.01
"""Of the one cycle that the simple models are fitted to, as in Muralidhara et al. 2009, §2.2."""
SLOW_EVERY = 10
"""A hundredth of a second changes nothing in a cycle of 100 s."""
CALIBRATION_EVERY = 5
"""200 samples a second, as a machine records; all samples of the fast legs, which determine lag and delay."""
NOTICED_V = 0.1
"""A voltage that differs by more from the request or the calibrated range is reported."""
DATA_SUFFIXES = (".csv", ".h5")
Start = Literal["virgin", "conditioned"]
USUAL_LOW_V, USUAL_HIGH_V = 0.0, 120.0
"""The range of Muralidhara et al. 2009, Figs 3–5."""
FREQUENCY_HZ, CYCLES = 1.0, 5
SLOW_CYCLES = 2
STEP_HOLD_S = 60.0
FIGURES = "figures"
"""All figures of the paper that show waveforms."""
LONGEST_S = 1800.0
"""Half an hour takes about 200 MB, and briefly 1 GB if it is written as CSV."""
_PERIODIC: dict[str, tuple[Callable[[float, float, float, int, float], waves.Waveform], float]] = {
    "sine": (waves.sine, math.pi),
    "triangle": (waves.triangle, 2.0),
    "square": (waves.square, 2.0),
}
"""Steepest slope over range and frequency; a square wave's edges must fit into its period."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """The options of the command line; None if not given."""

    shape: str
    frequency_hz: float | None
    low_v: float | None
    high_v: float | None
    cycles: int | None
    source: Path | None


class Waveform(NamedTuple):
    """A name and the voltage for every millisecond, shape (n,); `figure` is the paper's figure that shows it."""

    name: str
    command_v: Array
    figure: str = ""


def waveforms(wanted: Wanted) -> list[Waveform]:
    """Return the requested waveforms: one, or several for `all`."""
    shape = wanted.shape
    _refuse_misplaced(wanted)
    if shape == FIGURES or shape in FIGURE_NAMES:
        names = FIGURE_NAMES if shape == FIGURES else [shape]
        return [Waveform(FIGURE_NAMES[name], figure_command(name, RATE_HZ), name) for name in names]
    if wanted.source:
        return [Waveform(wanted.source.name, command_from(wanted.source, LONGEST_S))]
    low_v = USUAL_LOW_V if wanted.low_v is None else wanted.low_v
    high_v = USUAL_HIGH_V if wanted.high_v is None else wanted.high_v
    if not LOW_V <= low_v < high_v <= HIGH_V:
        raise failures.waveform_voltages_out_of_range(
            low_v=low_v, high_v=high_v, least_v=LOW_V, most_v=HIGH_V
        )
    if shape in _PERIODIC:
        frequency_hz = FREQUENCY_HZ if wanted.frequency_hz is None else wanted.frequency_hz
        return [_periodic(shape, low_v, high_v, frequency_hz, wanted.cycles or CYCLES)]
    step = [Leg(high_v, (high_v - low_v) / SLEW_V_S), Leg(high_v, STEP_HOLD_S)]
    chains: dict[str, Callable[[], waves.Waveform]] = {
        "step": lambda: sampled(step, RATE_HZ, low_v),
        "jumps": lambda: jump_train(low_v, high_v, RATE_HZ),
        "servo": lambda: servo_dither(low_v, high_v, RATE_HZ),
    }
    if shape in chains:
        return [Waveform(shape, chains[shape]().u_v)]
    return [
        _periodic("sine", low_v, high_v, SLOW_HZ, SLOW_CYCLES),
        _periodic("sine", low_v, high_v, FREQUENCY_HZ, CYCLES),
        *(Waveform(name, make().u_v) for name, make in chains.items()),
    ]


def _periodic(shape: str, low_v: float, high_v: float, frequency_hz: float, cycles: int) -> Waveform:
    if not frequency_hz > 0.0 or cycles / frequency_hz > LONGEST_S:
        raise failures.waveform_too_slow(
            cycles=cycles, frequency_hz=frequency_hz, longest_s=LONGEST_S, least_hz=cycles / LONGEST_S
        )
    make, steepness = _PERIODIC[shape]
    fastest_hz = SLEW_V_S / (steepness * (high_v - low_v))
    if frequency_hz > fastest_hz:
        raise failures.waveform_too_fast(
            waveform=shape,
            range_v=high_v - low_v,
            frequency_hz=frequency_hz,
            slew_v_s=SLEW_V_S,
            most_hz=math.floor(1e3 * fastest_hz) / 1e3,
        )
    return Waveform(f"{shape} {frequency_hz:g} Hz", make(low_v, high_v, frequency_hz, cycles, RATE_HZ).u_v)


def _refuse_misplaced(wanted: Wanted) -> None:
    """Refuse options that the waveform does not use."""
    periodic: dict[str, object] = {"--frequency": wanted.frequency_hz, "--cycles": wanted.cycles}
    ranged: dict[str, object] = {"--low": wanted.low_v, "--high": wanted.high_v}
    if wanted.shape == FIGURES or wanted.shape in FIGURE_NAMES:
        unused = {**periodic, **ranged, "--from": wanted.source}
        reason = "its voltage is that of the paper"
    elif wanted.shape == "csv":
        if wanted.source is None:
            raise failures.waveform_file_missing()
        unused, reason = {**periodic, **ranged}, "the file says all of the voltage"
    else:
        unused, reason = {"--from": wanted.source}, "only csv reads a file"
        if wanted.shape not in _PERIODIC and wanted.source is None:
            unused, reason = periodic, "only sine, square and triangle have cycles"
    for option, value in unused.items():
        if value is not None:
            raise failures.waveform_option_unused(option=option, waveform=wanted.shape, reason=reason)


def command_from(path: Path, longest_s: float) -> Array:
    """Return the voltage for every millisecond, shape (n,), interpolated from columns t_s and u_V."""
    import numpy as np

    t_s, u_v = read_columns(path, TIME, VOLTAGE)

    def first(wrong: Flags) -> str:
        row = int(np.argmax(wrong))
        return f"{path}: row {row + 1} ({t_s[row]:g} s, {u_v[row]:g} V)"

    if (wrong := ~(np.isfinite(t_s) & np.isfinite(u_v))).any():
        raise failures.waveform_not_finite(row=first(wrong))
    if (wrong := np.diff(t_s, prepend=-math.inf) <= 0.0).any():
        raise failures.waveform_time_not_ascending(row=first(wrong))
    if (wrong := (u_v < LOW_V) | (u_v > HIGH_V)).any():
        raise failures.waveform_beyond_actuator(row=first(wrong), low_v=LOW_V, high_v=HIGH_V)
    length_s = float(t_s[-1] - t_s[0])
    if length_s > longest_s:
        raise failures.waveform_too_long(path=path, length_s=length_s, longest_s=longest_s)
    ticks_s = t_s[0] + np.arange(math.floor(length_s * RATE_HZ + 1e-6) + 1) / RATE_HZ
    return np.asarray(np.interp(ticks_s, t_s, u_v), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class ModelErrors:
    """How far a model was from the truth, or from the sensor; shares are of the stroke."""

    max_um: float
    rms_um: float
    max_pct: float
    rms_pct: float

    @classmethod
    def of(cls, errors: ErrorFigures, stroke_um: float) -> ModelErrors:
        """Return the errors as shares of that stroke."""
        share = 100.0 / stroke_um
        return cls(errors.max_um, errors.rms_um, share * errors.max_um, share * errors.rms_um)


@dataclass(frozen=True, slots=True)
class WaveformResult:
    """One waveform and its true range; `models` has the keys line, paper and ours."""

    name: str
    truth: dict[str, float]
    models: dict[str, ModelErrors]


@dataclass(frozen=True, slots=True)
class PaperWaveform:
    """One waveform and its true range; `errors` are the paper's model less the sensor, with the zero of the fit."""

    name: str
    truth: dict[str, float]
    errors: ModelErrors
    readings: list[Reading]


class Trace(NamedTuple):
    """Every sample of one waveform; ndarrays of shape (n,). Models have got their zero."""

    t_s: Array
    applied_v: Array
    truth_um: Array
    sensor_um: Array
    models_um: dict[str, Array]


@dataclass(frozen=True, slots=True)
class Trial:
    """All waveforms. `stroke_um` is the sensor's range on the slow cycle over the whole voltage range."""

    waveforms: list[WaveformResult]
    traces: list[Trace]
    stroke_um: float
    doubts: list[Diagnostic]

    def as_mapping(self) -> dict[str, object]:
        """Return the `result` of the JSON object, but for the files."""
        return {"waveforms": [asdict(waveform) for waveform in self.waveforms], "stroke_um": self.stroke_um}


def run_trial(asked: Sequence[Waveform], known: ActuatorModel | None, seed: int) -> Trial:
    """Drive the waveforms on the actuator of this seed.

    known : the model to evaluate; None identifies one from a calibration record of the same actuator.
    """
    slow = slow_cycle(seed)
    ours, doubts = (known, []) if known else _calibrated(seed)
    models = {"line": fit_line([slow]).model, "paper": fit_maxwell([slow]).model, "ours": ours}
    stroke_um = float(slow.y_um.max() - slow.y_um.min())
    traces, results = [], []
    for waveform in asked:
        driven = VirtualActuator(seed).drive(waveform.command_v)
        doubts += _slowed(waveform, driven) + _beyond(waveform, driven, ours)
        models_um, errors = {}, {}
        for key, model in models.items():
            predicted_um = model.predict(driven.t_s, driven.applied_v)
            models_um[key] = predicted_um + judge(predicted_um, driven.truth_um).zero_um
            figures = judge(models_um[key], driven.truth_um, refit=()).errors
            errors[key] = ModelErrors.of(figures, stroke_um)
        traces.append(Trace(*driven, models_um))
        results.append(WaveformResult(waveform.name, {"range_um": figures.range_um}, errors))
    return Trial(results, traces, stroke_um, doubts)


def known_model(path: Path, seed: int) -> tuple[ActuatorModel, list[Diagnostic]]:
    """Load a calibration file, with warnings when it is another actuator's or was not accepted."""
    calibration = Calibration.load(path)
    serial, quality = VirtualActuator(seed).serial, calibration.quality
    doubts = _unaccepted(quality.problems)
    if calibration.serial != serial:
        another = failures.calibration_of_another_seed(path=path, owner=owner(calibration), serial=serial)
        doubts.insert(0, another)
    if quality.restrictions:
        restrictions = " Accepted ".join(quality.restrictions)
        doubts.append(failures.calibration_restricted(path=path, restrictions=restrictions))
    return calibration.model(), doubts


def _calibrated(seed: int) -> tuple[ActuatorModel, list[Diagnostic]]:
    """Identify the actuator from the record that `calibrate` drives."""
    waveform, is_kept = calibration_waveform(HIGH_V, RATE_HZ, CALIBRATION_EVERY)
    found = identify([_measured(seed, waveform.u_v, is_kept)], resamples=0)
    return found.model, _unaccepted(found.problems)


def _unaccepted(problems: Sequence[str]) -> list[Diagnostic]:
    return [failures.trial_calibration_not_accepted(problem=problem) for problem in problems]


def _measured(seed: int, command_v: Array, kept: Flags | slice) -> Record:
    """Drive the unit from rest and return what a host would record, at the samples `kept`."""
    driven = VirtualActuator(seed).drive(command_v)
    return Record(driven.t_s[kept], driven.applied_v[kept], driven.sensor_um[kept])


def slow_cycle(seed: int) -> Record:
    """The one slow cycle over the whole range that the simple models are fitted to, seen through the sensor."""
    return _measured(seed, sine(LOW_V, HIGH_V, SLOW_HZ, 1, RATE_HZ).u_v, slice(None, None, SLOW_EVERY))


def _slowed(waveform: Waveform, driven: DrivenTicks) -> list[Diagnostic]:
    """Warn (W8103) if the controller's slew limit changed the requested waveform."""
    worst_v = float(abs(driven.applied_v - waveform.command_v).max())
    if worst_v <= NOTICED_V:
        return []
    return [failures.waveform_too_steep(waveform=waveform.name, slew_v_s=SLEW_V_S, worst_v=worst_v)]


def _beyond(waveform: Waveform, driven: DrivenTicks, ours: ActuatorModel) -> list[Diagnostic]:
    """Warn if the waveform leaves the voltages that the model was identified over."""
    low_v, top_v = float(driven.applied_v.min()), float(driven.applied_v.max())
    beyond = []
    if not reaches_up(ours, top_v, NOTICED_V):
        beyond.append(("up", top_v, ours.high_v))
    if not reaches_down(ours, low_v, top_v):
        beyond.append(("down", low_v, ours.low_v))
    return [
        failures.waveform_beyond_calibration(
            waveform=waveform.name, way=way, end_v=end_v, calibrated_v=calibrated_v
        )
        for way, end_v, calibrated_v in beyond
    ]


class FittedModel(NamedTuple):
    """The paper's model with H fitted, the zero that its displacements need, range and errors of that fit."""

    model: ElectromechanicalModel
    zero_um: float
    fit: ErrorFigures


@dataclass(frozen=True, slots=True)
class PaperTrial:
    """All waveforms. `traces` hold the model under the key paper; `start` is the state that it begins each in."""

    start: Start
    fitted: FittedModel
    waveforms: list[PaperWaveform]
    traces: list[Trace]
    doubts: list[Diagnostic]

    @property
    def stroke_um(self) -> float:
        """Range of the sensor on the slow cycle that H was fitted to."""
        return self.fitted.fit.range_um

    def as_mapping(self) -> dict[str, object]:
        """Return the `result` of the JSON object, but for the files."""
        block, fit = self.fitted.model.block, self.fitted.fit
        return {
            "model": "paper",
            "start": self.start,
            "waveforms": [asdict(waveform) for waveform in self.waveforms],
            "stroke_um": self.stroke_um,
            "transducer": asdict(self.fitted.model.transducer),
            "hysteresis": {
                "limits": block.limits_v.tolist(),
                "capacitances_f": block.capacitances_f.tolist(),
                "remainder_per_f": block.remainder_per_f,
            },
            "fit": {"max_um": fit.max_um, "rms_um": fit.rms_um, "zero_um": self.fitted.zero_um},
        }


def run_paper_trial(asked: Sequence[Waveform], start: Start, seed: int) -> PaperTrial:
    """Drive the waveforms on the actuator of this seed and through the model of the paper.

    The actuator starts each at rest, long after full swings; the model starts in the state `start`. Raises
    PreconditionError E8037 for an actuator that Table 1 cannot drive.
    """
    fitted = fit_model(seed)
    traces, results, doubts = [], [], []
    for waveform in asked:
        driven = VirtualActuator(seed).drive(waveform.command_v)
        doubts += _slowed(waveform, driven)
        model_um = displacement(fitted, driven.applied_v, start)
        error_um = model_um - driven.sensor_um
        figures = ErrorFigures.over(error_um, float(driven.sensor_um.max() - driven.sensor_um.min()))
        truth = {"range_um": float(driven.truth_um.max() - driven.truth_um.min())}
        errors, read = ModelErrors.of(figures, fitted.fit.range_um), list[Reading]()
        if waveform.figure:
            read = readings(waveform.figure, waveform.command_v, error_um, model_um, RATE_HZ)
        results.append(PaperWaveform(waveform.name, truth, errors, read))
        traces.append(Trace(*driven, {"paper": model_um}))
    return PaperTrial(start, fitted, results, traces, doubts)


def fit_model(seed: int, transducer: Transducer = TABLE_1) -> FittedModel:
    """Fit H to one slow cycle of the actuator of this seed, measured by its sensor."""
    found = fit_maxwell([slow_cycle(seed)])
    plays = found.model
    try:
        maxwell = MaxwellModel.from_plays(plays.thresholds_v, plays.slopes_um_per_v[:, 0])
        model = ElectromechanicalModel.from_maxwell(maxwell, transducer)
    except ValueError as error:
        raise failures.paper_table_out_of_range(error=error) from error
    # Where the fitted plays are when every one of them rests at 0: there the model has no displacement.
    zero_um = float(Estimator(plays, ActuatorState.virgin(plays, 0.0)).tick(0.0, 0.0))
    return FittedModel(model, zero_um, found.train)


def displacement(fitted: FittedModel, applied_v: Array, start: Start) -> Array:
    """Displacement of the tool by the model on the sensor's scale, µm, shape (n,), for a voltage at every tick."""
    model = fitted.model
    state = model.virgin() if start == "virgin" else model.conditioned(LOW_V, HIGH_V)
    return model.simulate(applied_v, 1.0 / RATE_HZ, state=state).y_um + fitted.zero_um


def check_outputs(plot: Path | None, data: Path | None) -> None:
    """Refuse files that could not be written, before minutes of work find out."""
    if data and data.suffix.lower() not in DATA_SUFFIXES:
        raise failures.data_suffix_unknown(data=data.name, data_suffixes=", ".join(DATA_SUFFIXES))
    if plot:
        check_figure(plot.name)
    for path in filter(None, (plot, data)):
        output_files.check_free(path)
        if not path.parent.is_dir():
            raise output_files.unwritable(str(path), f"there is no folder {path.parent}", "Make it first.")


def write_data(traces: Sequence[Trace], path: Path) -> None:
    """Write every sample; with several waveforms, one after the other under their number in the table."""
    import numpy as np

    columns: dict[str, list[Array]] = {}
    if len(traces) > 1:
        columns["waveform"] = [np.full(one.t_s.size, float(number)) for number, one in enumerate(traces, 1)]
    columns |= {
        "t_s": [trace.t_s for trace in traces],
        "u_V": [trace.applied_v for trace in traces],
        "truth_um": [trace.truth_um for trace in traces],
        "sensor_um": [trace.sensor_um for trace in traces],
    }
    for key in ("paper", "ours", "line"):
        if key in traces[0].models_um:
            columns[f"{key}_um"] = [trace.models_um[key] for trace in traces]
    write_columns(path, {name: np.concatenate(parts) for name, parts in columns.items()})


def write_figure(trial: Trial | PaperTrial, path: Path, caption: str) -> None:
    """Draw the figure with the caption. Raises RunFileError E9011, E9012."""
    from edmctl.report.figures import comparisons as figure  # matplotlib

    panels = []
    if isinstance(trial, Trial):
        for result, trace in zip(trial.waveforms, trial.traces, strict=True):
            models = {
                "Maxwell, no creep": trace.models_um["paper"],
                figure.OWN: trace.models_um["ours"],
            }
            panels.append(figure.Trial(result.name, trace.t_s, trace.applied_v, trace.truth_um, models))
        output_files.write(path, figure.draw_models(panels, path.name, caption))
        return
    for waveform, trace in zip(trial.waveforms, trial.traces, strict=True):
        model_um = trace.models_um["paper"]
        error_um = model_um - trace.sensor_um
        marks = [
            figure.Mark(
                reading.at_s,
                float(error_um[round(reading.at_s * RATE_HZ)]),
                (reading.paper_side * reading.paper_low_um, reading.paper_side * reading.paper_high_um),
            )
            for reading in waveform.readings
            if reading.is_error
        ]
        models = {"model of the paper": model_um}
        panels.append(figure.Trial(waveform.name, trace.t_s, trace.applied_v, trace.sensor_um, models, marks))
    output_files.write(path, figure.draw_paper(panels, path.name, caption))
