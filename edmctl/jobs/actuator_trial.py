"""Waveforms through a virtual actuator, and the errors of three models.

Every waveform, the slow cycle and the calibration start from the same unit at rest. Models get only data that a
machine has: the applied voltage and the reading of the displacement sensor, with its gain error, drift and noise.
Their predictions are compared with the true displacement.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from edmctl import failures
from edmctl.actuator.identification import fit_line, fit_maxwell, identify
from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.record import Record
from edmctl.actuator.validation import judge
from edmctl.actuator.waveforms import calibration_waveform, sine
from edmctl.array_types import Array
from edmctl.dataclasses import asdict, dataclass
from edmctl.errors import Diagnostic
from edmctl.jobs import output_files
from edmctl.jobs.actuator_waveforms import Waveform
from edmctl.jobs.calibration import selection
from edmctl.profile.calibration import load_calibration
from edmctl.record.columns import write_columns
from edmctl.report.kinds import check_figure
from edmctl.simulator.actuator import HIGH_V, LOW_V, RATE_HZ, SLEW_V_S, DrivenTicks, VirtualActuator

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


SLOW_HZ = 0.01
"""Of the one cycle that the simple models are fitted to, as in Muralidhara et al. 2009, §2.2."""
SLOW_EVERY = 10
"""A hundredth of a second changes nothing in a cycle of 100 s."""
CALIBRATION_EVERY = 5
"""200 samples a second, as a machine records; all samples of the fast legs, which determine lag and delay."""
NOTICED_V = 0.1
"""A voltage that differs by more from the request or the calibrated range is reported."""


@dataclass(frozen=True, slots=True)
class ModelErrors:
    """How far a model was from the truth."""

    max_um: float
    rms_um: float
    max_pct: float
    rms_pct: float


@dataclass(frozen=True, slots=True)
class Truth:
    """True values of a waveform, from the simulator."""

    range_um: float


@dataclass(frozen=True, slots=True)
class WaveformResult:
    """One waveform; `models` has the keys line, paper and ours."""

    name: str
    truth: Truth
    models: dict[str, ModelErrors]


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

    known : the model to judge; None identifies one from a calibration record of the same actuator.
    """
    slow = slow_cycle(seed)
    ours, doubts = (known, []) if known else _calibrated(seed)
    models: dict[str, ActuatorModel] = {
        "line": fit_line([slow]).model,
        "paper": fit_maxwell([slow]).model,
        "ours": ours,
    }
    stroke_um = float(slow.y_um.max() - slow.y_um.min())
    traces, results = [], []
    for waveform in asked:
        driven = VirtualActuator(seed).drive(waveform.command_v)
        doubts += slowed(waveform, driven) + _beyond(waveform, driven, ours)
        trace = _traced(driven, models)
        traces.append(trace)
        results.append(_judged(waveform.name, trace, stroke_um))
    return Trial(results, traces, stroke_um, doubts)


def known_model(path: Path, seed: int) -> tuple[ActuatorModel, list[Diagnostic]]:
    """Load a calibration file, with warnings when it is another actuator's or was not accepted."""
    calibration = load_calibration(path)
    hint = "Say the --seed it was made with, or leave --calibration out."
    own = VirtualActuator(seed).serial
    doubts = selection.of_another(path, calibration, own, "this actuator is that of", hint)
    doubts += _unaccepted(calibration.quality.problems)
    if calibration.quality.restrictions:
        doubts.append(selection.restricted(str(path), calibration.quality.restrictions))
    return calibration.model(), doubts


def _calibrated(seed: int) -> tuple[ActuatorModel, list[Diagnostic]]:
    """Identify the actuator from the record that `calibrate` drives."""
    waveform, is_kept = calibration_waveform(HIGH_V, RATE_HZ, CALIBRATION_EVERY)
    record = _measured(seed, waveform.u_v, is_kept)
    found = identify([record], resamples=0)
    return found.model, _unaccepted(found.problems)


def _unaccepted(problems: Sequence[str]) -> list[Diagnostic]:
    hint = "The figures show what it costs."
    return [selection.not_accepted("The calibration", problem, hint) for problem in problems]


def _measured(seed: int, command_v: Array, kept: NDArray[np.bool_] | slice) -> Record:
    """Drive the unit from rest and return what a host would record, at the samples `kept`."""
    driven = VirtualActuator(seed).drive(command_v)
    return Record(driven.t_s[kept], driven.applied_v[kept], driven.sensor_um[kept])


def slow_cycle(seed: int) -> Record:
    """The one slow cycle over the whole range that the simple models are fitted to, seen through the sensor."""
    return _measured(seed, sine(LOW_V, HIGH_V, SLOW_HZ, 1, RATE_HZ).u_v, slice(None, None, SLOW_EVERY))


def slowed(waveform: Waveform, driven: DrivenTicks) -> list[Diagnostic]:
    """Warn (W8103) if the controller's slew limit changed the requested waveform."""
    worst_v = float(abs(driven.applied_v - waveform.command_v).max())
    if worst_v <= NOTICED_V:
        return []
    return [failures.waveform_too_steep(waveform=waveform.name, slew_v_s=SLEW_V_S, worst_v=worst_v)]


def _beyond(waveform: Waveform, driven: DrivenTicks, ours: ActuatorModel) -> list[Diagnostic]:
    """Whether the waveform leaves the voltages that the model was identified over."""
    low_v, top_v = float(driven.applied_v.min()), float(driven.applied_v.max())
    ends = []
    if not selection.reaches_up(ours, top_v, NOTICED_V):
        ends.append(f"up to {top_v:.1f} V and the calibration to {ours.high_v:.1f} V")
    if not selection.reaches_down(ours, low_v, top_v):
        ends.append(f"down to {low_v:.1f} V and the calibration to {ours.low_v:.1f} V")
    hint = "Calibrate over the whole stroke."
    return [selection.narrow(f"{waveform.name} goes {end}.", hint) for end in ends]


def _traced(driven: DrivenTicks, models: dict[str, ActuatorModel]) -> Trace:
    """Predict with every model, each with the zero that fits best."""
    models_um = {}
    for key, model in models.items():
        predicted_um = model.predict(driven.t_s, driven.applied_v)
        models_um[key] = predicted_um + judge(predicted_um, driven.truth_um).zero_um
    return Trace(*driven, models_um)


def _judged(name: str, trace: Trace, stroke_um: float) -> WaveformResult:
    models, range_um = {}, 0.0
    for key, predicted_um in trace.models_um.items():
        errors = judge(predicted_um, trace.truth_um, refit=()).errors
        share = 100.0 / stroke_um
        models[key] = ModelErrors(errors.max_um, errors.rms_um, share * errors.max_um, share * errors.rms_um)
        range_um = errors.range_um
    return WaveformResult(name, Truth(range_um), models)


DATA_SUFFIXES = (".csv", ".h5")


def check_outputs(plot: Path | None, data: Path | None) -> None:
    """Refuse files that could not be written, before minutes of work find out.

    Raises UsageError (E2011 figure's name, E2012 data's), PreconditionError (E8090 no matplotlib), RunFileError
    (E9011 exists, E9012 no folder).
    """
    if data and data.suffix.lower() not in DATA_SUFFIXES:
        raise failures.data_suffix_unknown(data=data.name, data_suffixes=", ".join(DATA_SUFFIXES))
    if plot:
        check_figure(plot.name)
    for path in (plot, data):
        if path is None:
            continue
        output_files.check_free(path)
        if not path.parent.is_dir():
            raise output_files.unwritable(str(path), f"there is no folder {path.parent}", "Make it first.")


def write_data(traces: Sequence[Trace], path: Path) -> None:
    """Write every sample; with several waveforms, one after the other under their number in the table."""
    import numpy as np

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
        **{
            f"{key}_um": [trace.models_um[key] for trace in traces]
            for key in ("paper", "ours", "line")
            if key in traces[0].models_um
        },
    }.items():
        columns[name] = np.concatenate(values)
    write_columns(path, columns)


def write_figure(trial: Trial, path: Path, words: str) -> None:
    """Draw the figure with the caption `words`."""
    from edmctl.report.figures import actuator as figure  # matplotlib

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
    output_files.write(path, figure.draw(panels, path.name, words))
