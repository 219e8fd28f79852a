"""Print how exact and how fast the actuator model is.

    OPENBLAS_NUM_THREADS=1 python benchmarks/actuator.py [--seeds 10] [--measured FOLDER]

Accuracy: virtual actuators, which are outside the model's class, are calibrated through their sensor with the
record of `edmctl calibrate` and judged against their truth on five waveforms; FOLDER may hold the measured records
that tests/actuator/test_measured_data.py names. Speed: figures of one run, the best of several repeats.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import options
from edmctl.actuator import waveforms as waves
from edmctl.actuator.identification import fit_line, fit_maxwell, identify
from edmctl.actuator.inverse import Inverse
from edmctl.actuator.model import Estimator
from edmctl.actuator.record import Record
from edmctl.actuator.validation import ErrorFigures, judge, validate
from edmctl.simulator.plant import VirtualActuator

if TYPE_CHECKING:
    from collections.abc import Callable

    from edmctl.actuator.model import ActuatorModel

Array = NDArray[np.float64]

RATE_HZ = 1000.0
EVERY = slice(None, None, 5)
WAVEFORMS: dict[str, waves.Waveform] = {
    "10 mHz": waves.sine(0.0, 120.0, 0.01, 2, RATE_HZ),
    "1 Hz": waves.sine(0.0, 120.0, 1.0, 20, RATE_HZ),
    "step 60 s": waves.square(0.0, 120.0, 1.0 / 120.0, 1, RATE_HZ),
    "jump train": waves.jump_train(0.0, 120.0, RATE_HZ),
    "servo 200 s": waves.servo_dither(0.0, 120.0, RATE_HZ),
}


def driven(seed: int, wave: waves.Waveform) -> Record:
    """A record of the virtual actuator through its sensor, at 200 Hz."""
    seen = VirtualActuator(seed).drive(wave.u_v)
    return Record(wave.t_s[EVERY], seen.applied_v[EVERY], seen.sensor_um[EVERY])


def calibration(seed: int) -> Record:
    """What `edmctl calibrate` drives, at 200 Hz and its fast legs at 1 kHz."""
    wave, kept = waves.calibration_waveform(150.0, RATE_HZ, EVERY.step)
    seen = VirtualActuator(seed).drive(wave.u_v)
    return Record(wave.t_s[kept], seen.applied_v[kept], seen.sensor_um[kept])


def accuracy(seeds: int) -> None:
    """Worst of all seeds, % of the stroke, for the paper's practice, its model class at its best, and ours."""
    worst: dict[tuple[str, str], list[float]] = {}
    for seed in range(1, seeds + 1):
        record = calibration(seed)
        ours = identify([record])
        slow = driven(seed, waves.sine(0.0, 120.0, 0.01, 1, RATE_HZ))
        rows: dict[str, ActuatorModel] = {
            "straight line": fit_line([record]).model,
            "paper's practice": fit_maxwell([slow]).model,
            "Maxwell, all data": fit_maxwell([record]).model,
            "edmctl": ours.model,
        }
        for name, wave in WAVEFORMS.items():
            seen = VirtualActuator(seed).drive(wave.u_v)
            for row, model in rows.items():
                errors = judge(model.predict(wave.t_s, seen.applied_v), seen.truth_um).errors
                largest = worst.setdefault((row, name), [0.0, 0.0])
                largest[0] = max(largest[0], 100.0 * errors.max_um / ours.model.stroke_um)
                largest[1] = max(largest[1], 100.0 * errors.rms_um / ours.model.stroke_um)
    print(f"errors against truth, max / RMS, % of stroke, worst of {seeds} actuators")
    print(f"{'':18}" + "".join(f"{name:>15}" for name in WAVEFORMS))
    for row in rows:
        figures = (worst[row, name] for name in WAVEFORMS)
        print(f"{row:18}" + "".join(f"{largest:8.2f} /{rms:5.2f}" for largest, rms in figures))


def measured(folder: Path) -> None:
    """Train on 2…33 s of one measured record, judge on its rest and on another; one zero each."""

    def read(name: str, first_s: float, last_s: float = np.inf) -> Record:
        t_s, u_v, y_um = np.loadtxt(folder / name, delimiter=",", skiprows=1, usecols=(0, 1, 2)).T
        inside = (t_s >= first_s) & (t_s < last_s)
        return Record(t_s[inside], u_v[inside], y_um[inside], name=name)

    trained = identify([read("mixed_amplitude_1hz.csv", 2.0, 33.0)])
    plain = fit_maxwell([read("mixed_amplitude_1hz.csv", 2.0, 33.0)], delay_s=trained.model.delay_s)
    for name, first_s in (("mixed_amplitude_1hz.csv", 33.0), ("full_range_1hz.csv", 0.0)):
        record = read(name, first_s)
        ours = validate(trained.model, record).errors
        theirs = validate(plain.model, record).errors
        print(f"{name} from {first_s:g} s: {figures(ours)}   (Maxwell {figures(theirs)})")


def figures(errors: ErrorFigures) -> str:
    """Largest and RMS error in % of the range."""
    return f"max {errors.max_pct:.2f} %, RMS {errors.rms_pct:.3f} %"


def best_s(action: Callable[[], object], repeat: int = 5) -> float:
    """Shortest wall time of an action."""
    times = []
    for _ in range(repeat + 1):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times[1:])


def speed_and_inverse() -> None:
    """Times of every use, and how exact the inverse is."""
    record = calibration(1)
    found = identify([record])
    model = found.model
    for some in (Record(record.t_s[:60_000], record.u_v[:60_000], record.y_um[:60_000]), record):
        seconds = best_s(lambda some=some: identify([some]), 3)  # type: ignore[misc]
        print(f"identification of {len(some.t_s)} samples: {seconds:.2f} s")
    t_s: Array = 0.001 * np.arange(1.0, 200_001.0)
    walk_v = 75.0 + np.cumsum(np.random.default_rng(1).normal(0.0, 1.0, len(t_s))) % 70.0
    for name, u_v in (("full 1 Hz sine", 75.0 - 75.0 * np.cos(2.0 * np.pi * t_s)), ("random walk", walk_v)):
        seconds = best_s(lambda u_v=u_v: model.predict(t_s, u_v))  # type: ignore[misc]
        print(f"batch prediction, {name}: {1e9 * seconds / len(u_v):.0f} ns/sample")
    few = u_v[:2000].tolist()
    estimator = Estimator(model)

    def tick() -> None:
        for u in few:
            estimator.tick(u, 0.001)

    print(f"estimator tick: {1e6 * best_s(tick) / len(few):.1f} µs")
    inverse = Inverse(model)
    start = inverse.state.copy()
    y_um = model.predict(t_s, u_v, start)
    found_v, _ = inverse.solve(t_s, y_um)
    residual = np.abs(model.predict(t_s, found_v, start) - y_um).max() / model.stroke_um
    seconds = best_s(lambda: Inverse(model, start).solve(t_s, y_um))
    print(f"inverse: {1e6 * seconds / len(u_v):.2f} µs/sample, residual {residual:.1e} of the stroke")
    print(f"least slope: {model.slopes_um_per_v[0].min():.2f} µm/V of {model.gain_um_per_v:.2f} µm/V")


def main() -> None:
    """Run all."""
    given = options(__doc__, seeds=10, measured="")
    accuracy(given.seeds)
    if given.measured:
        measured(Path(given.measured))
    speed_and_inverse()


if __name__ == "__main__":
    main()
