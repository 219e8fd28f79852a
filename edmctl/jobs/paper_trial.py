"""The electromechanical model of Muralidhara et al. 2009 compared with the virtual actuator, as in the paper.

The virtual actuator with its displacement sensor is the experiment. The model is Table 1 of the paper behind a
block H, for which the paper gives no parameters: H is fitted to one slow cycle of the same actuator over its whole
range and has no creep. The zero of that fit is used for all waveforms.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from edmctl import failures
from edmctl.actuator.identification import fit_maxwell
from edmctl.actuator.maxwell import TABLE_1, ElectromechanicalModel, MaxwellModel, Transducer
from edmctl.actuator.model import ActuatorState, Estimator
from edmctl.actuator.validation import ErrorFigures
from edmctl.actuator.waveforms import Reading, readings
from edmctl.array_types import Array
from edmctl.dataclasses import asdict, dataclass
from edmctl.errors import Diagnostic
from edmctl.jobs import output_files
from edmctl.jobs.actuator_trial import ModelErrors, Trace, Truth, slow_cycle, slowed
from edmctl.jobs.actuator_waveforms import Waveform
from edmctl.simulator.actuator import HIGH_V, LOW_V, RATE_HZ, VirtualActuator

Start = Literal["virgin", "conditioned"]


class FittedModel(NamedTuple):
    """The model with H fitted, the zero that its displacements need, and the range and errors of that fit."""

    model: ElectromechanicalModel
    zero_um: float
    fit: ErrorFigures


@dataclass(frozen=True, slots=True)
class PaperWaveform:
    """One waveform; `errors` are model less sensor, with the zero of the fit."""

    name: str
    truth: Truth
    errors: ModelErrors
    readings: list[Reading]


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
        doubts += slowed(waveform, driven)
        model_um = displacement(fitted, driven.applied_v, start)
        error_um = model_um - driven.sensor_um
        errors = ErrorFigures.of(error_um, driven.sensor_um)
        share = 100.0 / fitted.fit.range_um
        results.append(
            PaperWaveform(
                waveform.name,
                Truth(float(driven.truth_um.max() - driven.truth_um.min())),
                ModelErrors(errors.max_um, errors.rms_um, share * errors.max_um, share * errors.rms_um),
                readings(waveform.figure, waveform.command_v, error_um, model_um, RATE_HZ)
                if waveform.figure
                else [],
            )
        )
        traces.append(Trace(*driven, {"paper": model_um}))
    return PaperTrial(start, fitted, results, traces, doubts)


def fit_model(seed: int, transducer: Transducer = TABLE_1) -> FittedModel:
    """Fit H to one slow cycle of the actuator of this seed, measured by its sensor.

    Raises PreconditionError E8037 if the actuator moves farther per volt than the transducer can drive it.
    """
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


def write_figure(trial: PaperTrial, path: Path, words: str) -> None:
    """Draw the figure with the caption `words`. Raises RunFileError E9011, E9012."""
    from edmctl.report.figures import actuator as figure  # matplotlib

    panels = []
    for waveform, trace in zip(trial.waveforms, trial.traces, strict=True):
        error_um = trace.models_um["paper"] - trace.sensor_um
        marks = [
            figure.Mark(
                reading.at_s,
                float(error_um[round(reading.at_s * RATE_HZ)]),
                (
                    reading.paper_side * reading.paper_low_um,
                    reading.paper_side * reading.paper_high_um,
                ),
            )
            for reading in waveform.readings
            if reading.is_error
        ]
        panels.append(
            figure.PaperTrial(
                waveform.name, trace.t_s, trace.applied_v, trace.sensor_um, trace.models_um["paper"], marks
            )
        )
    output_files.write(path, figure.draw_paper(panels, path.name, words))
