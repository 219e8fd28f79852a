"""The actuator: converter, buffer, amplifier, monitor, displacement sensor."""

from __future__ import annotations

from tools.generate.circuits.common import (
    KOHM,
    NF,
    SAFE_S,
    SAFE_V,
    UF,
    VDDA_SPREAD,
    VDDA_V,
    Check,
    Circuit,
    Needs,
    parallel,
    within,
)
from tools.generate.circuits.generator import CAPACITOR_SPREAD, discharge_s

REFERENCE_V, BUFFER_TOP_OHM, BUFFER_BOTTOM_OHM, AMPLIFIER_GAIN, AMPLIFIER_TOP_V = (
    4.096,
    20 * KOHM,
    12 * KOHM,
    15.0,
    10.0,
)
BUFFER_CORNER = (1 * KOHM, 100 * NF)
PIEZO_F, PIEZO_MOST_V = 8 * UF, 150.0
PIEZO_BLEEDER_OHM, AMPLIFIER_A = 470 * KOHM, 20e-3


def piezo_discharge_s() -> float:
    """Longest time until an actuator without its amplifier may be touched."""
    return discharge_s(PIEZO_MOST_V, PIEZO_F * (1 + CAPACITOR_SPREAD), PIEZO_BLEEDER_OHM * 1.05)


def drive_v(count: float) -> float:
    """Voltage on the actuator by a count of the converter."""
    return count / 65536 * REFERENCE_V * (1 + BUFFER_TOP_OHM / BUFFER_BOTTOM_OHM) * AMPLIFIER_GAIN


def actuator_drive(n: Needs) -> Circuit:
    """Converter, reference, buffer and amplifier."""
    buffer_gain = 1 + BUFFER_TOP_OHM / BUFFER_BOTTOM_OHM
    step_v, wanted_v = drive_v(1), n.limits["DAC_V"]
    full_v = drive_v(65535)
    lag_ms = 1e3 * BUFFER_CORNER[0] * BUFFER_CORNER[1]
    slew_ma = 1e3 * PIEZO_F * n.params["slew_limit_v_s"]
    energy_mj = 1e3 * 0.5 * PIEZO_F * PIEZO_MOST_V**2
    um_v = n.params["gain_um_per_v"]
    return Circuit(
        "actuator",
        (
            (
                "converter",
                "16 bits, SPI mode 0 at 10.5 MHz, to 0 at its own power-on, LDAC low (AD5541A class); "
                "isolator of 25 Mb/s before it, 10 kΩ pull-up at DAC_SELECT on both sides",
            ),
            ("reference", f"{REFERENCE_V:g} V, 0.05 %, 5 ppm/K"),
            (
                "supply of both",
                "the board's 5 V (CN8-9), with at most 1 µF behind it: it goes and comes with the chip's",
            ),
            (
                "buffer",
                f"1 + {BUFFER_TOP_OHM / KOHM:g} kΩ / {BUFFER_BOTTOM_OHM / KOHM:g} kΩ = {buffer_gain:.4f}, "
                f"0.1 %; {BUFFER_CORNER[0] / KOHM:g} kΩ and {BUFFER_CORNER[1] / NF:g} nF before it; "
                f"output held to −0.3 to {AMPLIFIER_TOP_V:g} V by a clamp",
            ),
            (
                "amplifier",
                f"input 0 to {AMPLIFIER_TOP_V:g} V, gain {AMPLIFIER_GAIN:g}, output limited to 0 to "
                f"{PIEZO_MOST_V:g} V by itself, 20 mA at least. One of gain 20 takes a buffer of gain 2",
            ),
            (
                "at the actuator",
                f"{PIEZO_BLEEDER_OHM / KOHM:g} kΩ, 5 %, 0.5 W, 250 V across it, on its own side of the plug",
            ),
        ),
        (
            Check(
                "one count",
                f"{1e3 * wanted_v:g} mV",
                f"{1e3 * step_v:.4f} mV",
                within(step_v, wanted_v, 1e-4),
            ),
            Check(
                "all of it: reference × buffer × amplifier",
                "40 × reference",
                f"{buffer_gain * AMPLIFIER_GAIN:.2f} ×",
                within(buffer_gain * AMPLIFIER_GAIN, 40.0, 1e-4),
            ),
            Check(
                f"a word of all ones would be {full_v:.1f} V: buffer's clamp × amplifier",
                f"≤ {PIEZO_MOST_V:g} V",
                f"{AMPLIFIER_TOP_V * AMPLIFIER_GAIN:g} V",
                AMPLIFIER_TOP_V * AMPLIFIER_GAIN <= PIEZO_MOST_V,
            ),
            Check("lag of the buffer's corner", "< 1 ms", f"{lag_ms:.1f} ms", lag_ms < 1.0),
            Check(
                f"current of {PIEZO_F / UF:g} µF at {n.params['slew_limit_v_s']:g} V/s",
                "< 20 mA",
                f"{slew_ma:.0f} mA",
                slew_ma < 20.0,
            ),
            Check(
                f"step of the converter by 100 V: {1e3 * AMPLIFIER_A:g} mA into {PIEZO_F / UF:g} µF",
                "–",
                f"{AMPLIFIER_A / PIEZO_F:g} V/s, {1e3 * 100.0 * PIEZO_F / AMPLIFIER_A:g} ms",
                True,
            ),
            Check(
                f"from {PIEZO_MOST_V:g} V to {SAFE_V:g} V by the resistor alone",
                f"< {SAFE_S:g} s",
                f"{piezo_discharge_s():.1f} s",
                piezo_discharge_s() < SAFE_S,
            ),
            Check(f"one count at {um_v:g} µm/V", "–", f"{1e3 * um_v * step_v:.1f} nm", True),
            Check(f"energy in {PIEZO_F / UF:g} µF at {PIEZO_MOST_V:g} V", "–", f"{energy_mj:.0f} mJ", True),
        ),
    )


MONITOR_OHM = (990 * KOHM, 660 * KOHM, 20.2 * KOHM)
"""From the actuator, from 3.3 V, to ground."""
MONITOR_F = 10 * NF


def monitor_ends(ohms: tuple[float, float, float]) -> tuple[float, float]:
    """Voltages of the actuator at which the pin is at 0 and at 3.3 V."""
    signal, offset, _ = (parallel(*ohms) / ohm for ohm in ohms)
    return -VDDA_V * offset / signal, VDDA_V * (1 - offset) / signal


def monitor(n: Needs) -> Circuit:
    """Actuator voltage to 0 to 3.3 V."""
    low_v, high_v = n.scale["EDM_MONITOR_LEAST_V"], n.scale["EDM_MONITOR_MOST_V"]
    ends = [
        monitor_ends((MONITOR_OHM[0] * a, MONITOR_OHM[1] * b, MONITOR_OHM[2] * c))
        for a in (0.999, 1.001)
        for b in (0.999, 1.001)
        for c in (0.999, 1.001)
    ]
    # What is told of 150 V and of 0 V, over all corners.
    told = [
        low_v + (volt - low) / (high - low) * (high_v - low_v)
        for low, high in ends
        for volt in (0.0, PIEZO_MOST_V)
    ]
    worst_v = max(abs(value - (0.0, PIEZO_MOST_V)[i % 2]) for i, value in enumerate(told))
    middle = monitor_ends(MONITOR_OHM)
    track_v = 150.0 * n.params["track_error"]
    supply_v = PIEZO_MOST_V * VDDA_SPREAD
    off_v = middle[0] + (middle[1] - middle[0]) * MONITOR_OHM[2] / (MONITOR_OHM[1] + MONITOR_OHM[2])
    lag_ms = 1e3 * parallel(*MONITOR_OHM) * MONITOR_F
    margin_v = n.params["monitor_max_v"] - PIEZO_MOST_V
    return Circuit(
        "monitor",
        (
            ("from the actuator's plug", "3 × 330 kΩ in series, 0.1 %, 200 V each"),
            ("from 3.3 V (the converter's own)", "2 × 330 kΩ in series, 0.1 %"),
            ("to ground", "20.0 kΩ + 200 Ω, 0.1 %"),
            ("behind it", f"{MONITOR_F / NF:g} nF, clamp and buffer as at the gap divider"),
        ),
        (
            Check(
                "ends of the range",
                f"{low_v:g} and {high_v:g} V",
                f"{middle[0]:.2f} and {middle[1]:.2f} V",
                abs(middle[0] - low_v) < 0.2 and abs(middle[1] - high_v) < 0.2,
            ),
            Check(
                "error at 0 and 150 V by resistors of 0.1 %",
                f"< {track_v:g} V (fault 2002)",
                f"{worst_v:.2f} V",
                worst_v < track_v,
            ),
            Check(
                f"error at 150 V by 3.3 V that is {100 * VDDA_SPREAD:g} % off",
                f"to be calibrated: above {margin_v:g} V fault 2003 comes at 150 V",
                f"{supply_v:.1f} V",
                supply_v > margin_v,
            ),
            Check(
                "with its wire off it reads",
                f"seen by fault 2002 beyond {track_v:g} V, not at rest",
                f"{off_v:.1f} V",
                abs(off_v) < track_v,
            ),
            Check("lag", "< 1 ms", f"{lag_ms:.2f} ms", lag_ms < 1.0),
        ),
    )


SENSOR_RANGE_UM, STROKE_UM = (-50.0, 450.0), 445.0


def displacement(n: Needs) -> Circuit:
    """Sensor to 0 to 3.3 V."""
    low, high = n.scale["EDM_SENSOR_LEAST_UM"], n.scale["EDM_SENSOR_MOST_UM"]
    um_v = n.params["gain_um_per_v"]
    stops_v = (high - 5.0) / um_v
    wide = SENSOR_RANGE_UM[1] - SENSOR_RANGE_UM[0]
    return Circuit(
        "displacement",
        (
            (
                "sensor",
                "inductive or eddy current, 0.5 mm, 1 kHz or more, noise below 0.15 µm rms, on the "
                "actuator's moving side",
            ),
            (
                "conditioning",
                "what fits its signal to the pin: amplifier with offset, the sensor's zero at a tenth of 3.3 V, "
                "more displacement towards the work more voltage; clamp and corner as the monitor",
            ),
        ),
        (
            Check(
                "the image's range reaches",
                f"{n.params['piezo_max_v']:g} V of the actuator",
                f"{high:g} µm, {stops_v:.0f} V",
                stops_v > n.params["piezo_max_v"],
            ),
            Check(
                f"range wanted for {STROKE_UM:g} µm of stroke",
                f"> {STROKE_UM:g} µm",
                f"{SENSOR_RANGE_UM[0]:g} to {SENSOR_RANGE_UM[1]:g} µm",
                SENSOR_RANGE_UM[1] > STROKE_UM,
            ),
            Check(
                "one count, as it is and in the wanted range",
                "< 0.15 µm, the noise",
                f"{(high - low) / n.top:.3f} and {wide / n.top:.3f} µm",
                wide / n.top < 0.15,
            ),
            Check(
                "place of zero in the wanted range",
                "not at a rail",
                f"{-SENSOR_RANGE_UM[0] / wide * VDDA_V:.2f} V",
                True,
            ),
        ),
    )
