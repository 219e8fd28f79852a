"""A board's readings from raw records: synthetic samples and edges in, what the core reads out."""

from __future__ import annotations

import ctypes as ct
import math
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edmctl.core.build import compiler, source_folder

MOST_PULSES = 64
PER_US = 84
OPEN_V, FULL_V, FULL_A, TOP = 40.0, 330.0, 12.0, 4095
SIEMENS = 0.12 / 18.0
VOLT_STEP, AMP_STEP = FULL_V / TOP, FULL_A / TOP
EDGES, SLOW = 256, 128


U32, BOOL, FLOAT, PLACE = ct.c_uint32, ct.c_bool, ct.c_float, ct.c_void_p


class Edges(ct.Structure):
    _fields_ = [("ring", PLACE), ("at", U32)]


class Samples(ct.Structure):
    _fields_ = [("ring", PLACE), ("size", U32), ("at", U32), ("held", U32), ("good", BOOL)]


class Scans(ct.Structure):
    _fields_ = [("ring", PLACE), ("size", U32), ("at", U32), ("good", BOOL)]


class Records(ct.Structure):
    _fields_ = [
        *(("now", U32), ("now_ns", ct.c_int64)),
        *((name, Edges) for name in ("gates", "ignitions", "ends")),
        *(("samples", Samples), ("scans", Scans)),
    ]


class Gate(ct.Structure):
    _counts = ("changes", "on_since", "off_since", "on_counts", "period_counts", "discharge_counts")
    _fields_ = [("on", BOOL), *((name, U32) for name in _counts), ("open_v", FLOAT)]


class Follower(ct.Structure):
    _fields_ = [("at", U32), ("mark", U32)]


class Measure(ct.Structure):
    _fields_ = [
        *((name, Follower) for name in ("gates", "ignitions", "ends")),
        *(("changes", U32), ("blind_until", U32), ("blind", BOOL), ("first", BOOL)),
    ]


class Readings(ct.Structure):
    _means = ("sensor_um", "monitor_v", "gap_v", "charge_uc", "generator_siemens", "off_time_a")
    _pulses = ("delay_us", "discharge_us", "plateau_v", "energy_uj")
    _fields_ = [
        *((name, FLOAT) for name in _means),
        *((name, ct.c_uint8) for name in ("contact", "stray_pulses", "pulses")),
        ("first_pulse_ns", ct.c_int64),
        *((name, FLOAT * MOST_PULSES) for name in _pulses),
    ]


@pytest.fixture(scope="module")
def code(tmp_path_factory: pytest.TempPathFactory) -> ct.CDLL:
    """The board's arithmetic as a library of this computer."""
    path: Path = tmp_path_factory.mktemp("measure") / "measure.so"
    source = source_folder() / "board" / "measure.c"
    flags = ["-std=c11", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-Wall", "-Wextra", "-Wconversion"]
    command = [*compiler(), *flags, "-Wshadow", "-Werror", str(source), "-o", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    library = ct.CDLL(str(path))
    library.measure_slow.restype = ct.c_float
    return library


@dataclass
class Pulse:
    """One pulse of the model; `rise` and `fall` say whether the comparator's edges are seen."""

    delay_us: float
    plateau_v: float
    discharge_us: float = math.inf
    rise: bool = True
    fall: bool = True


OPEN = Pulse(math.inf, OPEN_V)
NORMAL = Pulse(41.3, 22.0)
ARC = Pulse(0.4, 15.0)
SHORT = Pulse(0.0, 2.0)


@dataclass
class Machine:
    """Generator, gap, timers, ADC and DMA of a board; times in µs since its timers started."""

    code: ct.CDLL
    on_us: float = 130.435
    off_us: float = 304.348
    pulse: Callable[[int], Pulse] = lambda _: NORMAL
    ring: int = 35875
    origin: int = 0
    """Count of the 32-bit timer at the start: near its end it starts over."""
    leak_a: float = 0.0
    gain_a: float = 1.0
    first_us: float = 0.5
    gate_on: bool = True
    ms: int = 0
    good: bool = True
    waves: Callable[[Any, Any], tuple[Any, Any]] | None = None
    """Changes voltages and currents before they are converted."""
    chatters: int = 0
    """The comparator falls and rises so often within each discharge."""
    times: dict[str, list[int]] = field(default_factory=lambda: {"gates": [], "ignitions": [], "ends": []})

    def __post_init__(self) -> None:
        self.samples = np.zeros(self.ring, np.uint32)
        self.slow = np.zeros(SLOW, np.uint16)
        self.edges = {name: np.zeros(EDGES, np.uint32) for name in self.times}
        self.written = dict.fromkeys(self.times, 0)
        self.measure = Measure()
        self.gate = Gate(
            on=self.gate_on,
            changes=1,
            on_since=self.counts(self.first_us),
            on_counts=round(self.on_us * PER_US),
            period_counts=round(self.period_us * PER_US),
            open_v=OPEN_V,
        )
        self.next_pulse = 0
        self.until_sample = 0

    @property
    def period_us(self) -> float:
        return self.on_us + self.off_us

    def counts(self, us: float) -> int:
        return (self.origin + round(us * PER_US)) & 0xFFFFFFFF

    def _strike(self, until_us: float) -> None:
        """Note the edges of the pulses that begin before a time."""
        while self.gate_on and (start := self.first_us + self.next_pulse * self.period_us) < until_us:
            pulse = self.pulse(self.next_pulse)
            self.next_pulse += 1
            self.times["gates"].append(self.counts(start))
            if pulse.delay_us < self.on_us:
                end = min(pulse.delay_us + pulse.discharge_us, self.on_us + 0.2)
                if pulse.rise:
                    self.times["ignitions"].append(self.counts(start + pulse.delay_us))
                for i in range(self.chatters):
                    at = start + pulse.delay_us + (i + 1) / (self.chatters + 1) * (end - pulse.delay_us)
                    self.times["ends"].append(self.counts(at))
                    self.times["ignitions"].append(self.counts(at + 0.1))
                if pulse.fall:
                    self.times["ends"].append(self.counts(start + end))

    def _signals(self, k: Any) -> tuple[Any, Any]:
        """Voltage and current at whole microseconds."""
        v, a = np.zeros(len(k)), np.full(len(k), self.leak_a)
        if not self.gate_on:
            return v, a
        index = np.floor((k - self.first_us) / self.period_us).astype(int)
        for number in np.unique(index[index >= 0]):
            at = index == number
            pulse = self.pulse(int(number))
            t = k[at] - self.first_us - number * self.period_us
            lit = pulse.delay_us
            end = min(lit + pulse.discharge_us, self.on_us)
            current = (OPEN_V - pulse.plateau_v) * SIEMENS * self.gain_a
            v[at] = np.where(t < min(lit, self.on_us), OPEN_V * (1 - np.exp(-t / 0.5)), pulse.plateau_v)
            v[at] = np.where(t >= end, v[at] * np.exp(-np.maximum(t - end, 0) / 2.0), v[at])
            if lit < self.on_us:
                grown = current * (1 - np.exp(-np.maximum(t - lit, 0) / 0.3))
                a[at] += np.where(
                    t < lit, 0, np.where(t < end, grown, current * np.exp(-np.maximum(t - end, 0) / 0.3))
                )
        return v, a

    def _sample(self, until_us: int) -> None:
        k = np.arange(self.until_sample, until_us)
        self.until_sample = until_us
        v, a = self._signals(k.astype(float))
        if self.waves is not None:
            v, a = self.waves(v, a)
        volts = np.clip(np.round(v / VOLT_STEP), 0, TOP).astype(np.uint32)
        amps = np.clip(np.round(a / AMP_STEP), 0, TOP).astype(np.uint32)
        self.samples[k % self.ring] = volts | amps << 16

    def _edges(self, name: str) -> Edges:
        """Ring of what has been captured; the place is that of the tick, which a late look does not move."""
        now, ring, at = self.counts(self.ms * 1000.0), self.edges[name], 0
        times = self.times[name]
        while self.written[name] < len(times):
            ring[self.written[name] % EDGES] = times[self.written[name]]
            self.written[name] += 1
        at = sum(1 for time in times if (time - now) & 0x80000000)
        return Edges(ring.ctypes.data, at % EDGES)

    def tick(self, late_us: int = 200) -> Readings:
        """Readings of the next millisecond; DMA has written on until the program looks."""
        self.ms += 1
        end = self.ms * 1000
        self._strike(end + late_us)
        self._sample(end + late_us)
        held = min(end, self.ring - 1050)
        records = Records(
            now=self.counts(end),
            now_ns=end * 1000,
            gates=self._edges("gates"),
            ignitions=self._edges("ignitions"),
            ends=self._edges("ends"),
            samples=Samples(self.samples.ctypes.data, self.ring, end % self.ring, held, self.good),
            scans=Scans(self.slow.ctypes.data, SLOW, 0, self.good),
        )
        readings = Readings()
        call = (ct.byref(self.measure), ct.byref(records), ct.byref(self.gate), ct.byref(readings))
        self.code.measure_millisecond(*call)
        return readings

    def ticks(self, count: int) -> list[Readings]:
        return [self.tick() for _ in range(count)]


def pulses_of(readings: Sequence[Readings]) -> list[tuple[float, float, float, float]]:
    """Delay, discharge, plateau and energy of all pulses."""
    return [
        (r.delay_us[i], r.discharge_us[i], r.plateau_v[i], r.energy_uj[i])
        for r in readings
        for i in range(r.pulses)
    ]


def check_pulse(
    seen: tuple[float, float, float, float], pulse: Pulse, on_us: float, gain_a: float = 1.0
) -> None:
    """Times to 0.1 µs, voltage to an ADC step, energy to an ADC step of current, 3 % and the rise of the current."""
    delay, discharge, plateau, energy = seen
    if pulse.delay_us >= on_us:
        assert (discharge, energy) == (0.0, 0.0)
        assert delay == pytest.approx(on_us, abs=0.02)
        assert plateau == pytest.approx(OPEN_V, abs=VOLT_STEP)
        return
    true_us = min(pulse.discharge_us, on_us - pulse.delay_us)
    true_a = (OPEN_V - pulse.plateau_v) * SIEMENS * gain_a
    assert delay == pytest.approx(pulse.delay_us, abs=0.1)
    assert discharge == pytest.approx(true_us, abs=0.1)
    assert plateau == pytest.approx(pulse.plateau_v, abs=VOLT_STEP)
    true_uj = pulse.plateau_v * true_a * true_us
    assert energy == pytest.approx(true_uj, rel=0.03 + 0.3 / true_us, abs=plateau * AMP_STEP * true_us)


def mean_v(pulse: Pulse, on_us: float, period_us: float) -> float:
    delay = min(pulse.delay_us, on_us)
    discharge = min(pulse.discharge_us, on_us - delay)
    return (delay * OPEN_V + discharge * pulse.plateau_v) / period_us


@pytest.mark.parametrize("pulse", [OPEN, NORMAL, ARC, SHORT], ids=["open", "normal", "arc", "short"])
def test_a_train_of_one_kind(code: ct.CDLL, pulse: Pulse) -> None:
    machine = Machine(code, pulse=lambda _: pulse)
    seen = machine.ticks(10)
    found = pulses_of(seen)
    assert len(found) == machine.next_pulse - (machine.next_pulse * machine.period_us > 10_000)
    for one in found:
        check_pulse(one, pulse, machine.on_us)
    lit = pulse is not OPEN
    for readings in seen:
        assert readings.gap_v == pytest.approx(mean_v(pulse, machine.on_us, machine.period_us), abs=0.1)
        assert readings.generator_siemens == pytest.approx(SIEMENS if lit else 0, rel=0.03)
        assert readings.off_time_a == 0
        true_uc = (
            readings.pulses
            * (OPEN_V - pulse.plateau_v)
            * SIEMENS
            * (machine.on_us - min(pulse.delay_us, machine.on_us))
        )
        assert readings.charge_uc == pytest.approx(true_uc, rel=0.03)


@pytest.mark.parametrize(("share", "is_set"), [(0.99, True), (0.97, False)])
def test_open_pulses_read_the_voltage_that_is_set(code: ct.CDLL, share: float, is_set: bool) -> None:
    """The core takes 0.999 of the duty voltage for an open gap: less than an ADC tells."""
    machine = Machine(code, pulse=lambda _: OPEN, waves=lambda v, a: (v * share, a))
    duty_v = OPEN_V * machine.on_us / machine.period_us
    seen = machine.ticks(3)[-1].gap_v
    assert seen == pytest.approx(duty_v if is_set else duty_v * share, rel=2e-3)
    assert (seen > 0.999 * duty_v) == is_set


def test_a_mixed_train_is_told_in_its_order(code: ct.CDLL) -> None:
    kinds = [OPEN, NORMAL, ARC, SHORT, Pulse(100.2, 22.0), Pulse(128.9, 22.0)]
    machine = Machine(code, pulse=lambda i: kinds[i * 7 % 6])
    found = pulses_of(machine.ticks(20))
    assert len(found) >= 45
    for i, one in enumerate(found):
        check_pulse(one, kinds[i * 7 % 6], machine.on_us)


def test_a_pulse_belongs_to_the_millisecond_in_which_its_gate_closes(code: ct.CDLL) -> None:
    machine = Machine(code, first_us=950.0)
    first, second = machine.ticks(2)
    assert (first.pulses, math.isnan(first.gap_v)) == (0, True)
    assert second.pulses == 3  # begun at 950, 1384.8 and 1819.6 µs
    assert second.first_pulse_ns == pytest.approx(950_000, abs=13)
    check_pulse(pulses_of([second])[0], NORMAL, machine.on_us)


def test_a_pulse_that_closes_with_the_millisecond_is_told_once(code: ct.CDLL) -> None:
    machine = Machine(code, on_us=100.0, off_us=900.0, first_us=900.0)
    assert [r.pulses for r in machine.ticks(4)] == [1, 1, 1, 1]


def test_rings_and_timers_start_over(code: ct.CDLL) -> None:
    """500 ms are 1150 pulses through 256 places, and 14 turns of the samples; the timer passes its end in them."""
    kinds = [NORMAL, ARC, SHORT]
    machine = Machine(code, pulse=lambda i: kinds[i % 3], origin=0xFFFFFFFF - 250 * 1000 * PER_US)
    seen = machine.ticks(500)
    found = pulses_of(seen)
    assert 1149 <= len(found) <= 1151
    for i, one in enumerate(found):
        check_pulse(one, kinds[i % 3], machine.on_us)
    starts = [r.first_pulse_ns for r in seen if r.pulses]
    number = 0
    for start, readings in zip(starts, seen, strict=True):
        assert start == pytest.approx((machine.first_us + number * machine.period_us) * 1e3, abs=25)
        number += readings.pulses


@pytest.mark.parametrize(
    ("pulse", "delay_us", "discharge_us"),
    [
        (Pulse(40.0, 22.0, rise=False, fall=False), 0.0, 130.435),
        (Pulse(40.0, 22.0, 50.0, rise=False), 0.0, 90.0),
        (Pulse(40.0, 22.0, 50.0, fall=False), 40.0, 90.435),
        (Pulse(math.inf, OPEN_V, rise=False, fall=False), 130.435, 0.0),
    ],
    ids=["none-but-current", "no-rise", "no-fall", "none-no-current"],
)
def test_edges_that_are_missing(code: ct.CDLL, pulse: Pulse, delay_us: float, discharge_us: float) -> None:
    """Current without an edge is a discharge from the begin: never an open gap."""
    machine = Machine(code, pulse=lambda _: pulse)
    for seen in pulses_of(machine.ticks(5)):
        assert seen[:2] == pytest.approx((delay_us, discharge_us), abs=0.1)


def test_chatter_of_the_comparator_is_one_discharge(code: ct.CDLL) -> None:
    machine = Machine(code, pulse=lambda _: Pulse(40.0, 22.0, 60.0))
    machine._strike(1000.0)
    for name, at in (("ends", 40.3), ("ignitions", 40.6), ("ends", 41.0), ("ignitions", 41.2)):
        machine.times[name] = sorted([*machine.times[name], machine.counts(machine.first_us + at)])
    check_pulse(pulses_of([machine.tick()])[0], Pulse(40.0, 22.0, 60.0), machine.on_us)


STRUCK = Pulse(3.0, 22.0)


def times_of(readings: Sequence[Readings]) -> set[tuple[float, float]]:
    """Delays and discharges of all pulses, to 0.1 µs."""
    return {(round(delay, 1), round(discharge, 1)) for delay, discharge, *_ in pulses_of(readings)}


@pytest.mark.parametrize("chatters", [4, 5, 9, 20])
@pytest.mark.parametrize("late_us", [0, 200, 900])
def test_a_comparator_that_chatters_more_than_its_ring_holds_says_nothing(
    code: ct.CDLL, chatters: int, late_us: int
) -> None:
    """The samples do, for every pulse alike: what the ring holds still is of the last ones alone."""
    machine = Machine(code, on_us=10.0, off_us=10.0, pulse=lambda _: STRUCK, chatters=chatters)
    seen = [machine.tick(late_us) for _ in range(20)]
    assert sum(r.pulses for r in seen) == pytest.approx(1000, abs=1)
    assert times_of(seen) == {(0.0, 10.0)}
    for readings in seen:
        assert readings.plateau_v[0] == pytest.approx(22.0, abs=VOLT_STEP)
        assert readings.generator_siemens == pytest.approx(SIEMENS, rel=0.03)


@pytest.mark.parametrize("chatters", [1, 2])
def test_chatter_that_a_ring_holds_changes_nothing(code: ct.CDLL, chatters: int) -> None:
    machine = Machine(code, on_us=10.0, off_us=10.0, pulse=lambda _: STRUCK, chatters=chatters)
    assert times_of(machine.ticks(20)) == {(3.0, 7.0)}


def test_a_comparator_that_chatters_no_more_is_heard_again(code: ct.CDLL) -> None:
    """But for the pulse in whose time edges were lost."""
    machine = Machine(code, on_us=10.0, off_us=10.0, first_us=15.0, pulse=lambda _: STRUCK, chatters=8)
    seen = [machine.tick(late_us=0) for _ in range(4)]
    machine.chatters = 0
    seen += [machine.tick(late_us=0) for _ in range(2)]
    assert times_of(seen[:4]) == {(0.0, 10.0)}
    assert pulses_of(seen[4:])[0][:2] == pytest.approx((0.0, 10.0), abs=0.1)
    assert times_of([seen[5]]) == {(3.0, 7.0)}
    assert all(one[:2] == pytest.approx((3.0, 7.0), abs=0.1) for one in pulses_of([seen[4]])[1:])


def test_a_long_pulse_with_more_edges_than_a_ring_holds(code: ct.CDLL) -> None:
    """None of its milliseconds has too many."""
    machine = Machine(code, on_us=20_000.0, off_us=20_000.0, pulse=lambda _: NORMAL, chatters=300)
    found = pulses_of(machine.ticks(70))
    assert [one[:2] for one in found] == [pytest.approx((0.0, 20_000.0), abs=0.1)] * 2


@pytest.mark.parametrize("count", [192, 250, 256, 300, 512])
def test_more_edges_of_the_gate_than_a_ring_holds(code: ct.CDLL, count: int) -> None:
    """With the gate off all of them are strays, with the gate on there is no pulse that could be told."""
    for is_on in (False, True):
        machine = Machine(code, on_us=2.0, gate_on=False)
        machine.gate.on = is_on
        machine.ticks(3)
        machine.times["gates"] += [machine.counts(3001.0 + 990.0 * i / count) for i in range(count)]
        seen, after = machine.ticks(2)
        assert (seen.stray_pulses, seen.pulses) == (0 if is_on else 255, 0)
        assert math.isnan(seen.gap_v)
        assert (after.stray_pulses, after.pulses) == (0, 0)


def test_current_of_the_pulse_before_is_none_of_this_one(code: ct.CDLL) -> None:
    machine = Machine(code, on_us=10.0, off_us=10.0, pulse=lambda _: OPEN)
    machine._strike(1000.0)
    machine.times["ends"] = [time + PER_US // 4 for time in machine.times["gates"]]
    assert {seen[1] for seen in pulses_of([machine.tick()])} == {0.0}


@pytest.mark.parametrize("pulse", [OPEN, Pulse(3.0, 22.0), SHORT], ids=["open", "normal", "short"])
def test_50_khz(code: ct.CDLL, pulse: Pulse) -> None:
    machine = Machine(code, on_us=10.0, off_us=10.0, pulse=lambda _: pulse)
    seen = machine.ticks(30)
    assert all(r.pulses in (49, 50, 51) for r in seen)
    assert sum(r.pulses for r in seen) == pytest.approx(1500, abs=1)
    for one in pulses_of(seen):
        check_pulse(one, pulse, machine.on_us)
    assert seen[-1].gap_v == pytest.approx(mean_v(pulse, 10.0, 20.0), abs=0.15)
    assert seen[-1].off_time_a == 0


def test_a_discharge_shorter_than_a_sample_has_a_voltage_below_the_open_one(code: ct.CDLL) -> None:
    machine = Machine(code, on_us=10.3, off_us=10.0, pulse=lambda _: Pulse(9.7, 22.0))
    for delay, discharge, plateau, _ in pulses_of(machine.ticks(5)):
        assert (delay, discharge) == pytest.approx((9.7, 0.6), abs=0.1)
        assert plateau <= 22.0 + VOLT_STEP


@pytest.mark.parametrize("on_us", [1000.0, 20_000.0, 500_000.0], ids=["1ms", "20ms", "500ms"])
def test_a_period_of_one_second(code: ct.CDLL, on_us: float) -> None:
    """Of an on-time longer than the ring the end is looked at."""
    machine = Machine(code, on_us=on_us, off_us=1e6 - on_us, pulse=lambda _: Pulse(41.3, 22.0))
    seen = machine.ticks(1010 + int(on_us / 1000))
    found = pulses_of(seen)
    assert len(found) == 2
    for one in found:
        check_pulse(one, Pulse(41.3, 22.0), on_us)
    assert sum(1 for r in seen if r.pulses == 0 and math.isnan(r.gap_v)) == len(seen) - 2


def test_too_much_current_shows(code: ct.CDLL) -> None:
    machine = Machine(code, gain_a=2.0, pulse=lambda _: NORMAL)
    assert machine.ticks(3)[-1].generator_siemens == pytest.approx(2.0 * SIEMENS, rel=0.03)


@pytest.mark.parametrize(("leak_a", "seen_a"), [(0.3, 0.3), (0.05, 0.05), (0.015, 0.0)])
def test_current_in_the_off_time(code: ct.CDLL, leak_a: float, seen_a: float) -> None:
    for on_us, off_us in ((130.435, 304.348), (10.0, 10.0), (14.0, 6.0)):
        machine = Machine(code, on_us=on_us, off_us=off_us, leak_a=leak_a, pulse=lambda _: Pulse(3.0, 22.0))
        assert machine.ticks(3)[-1].off_time_a == pytest.approx(seen_a, abs=2 * AMP_STEP)


def test_more_pulses_than_there_is_room_for(code: ct.CDLL) -> None:
    machine = Machine(code, on_us=4.0, off_us=6.0, pulse=lambda _: OPEN)
    assert [r.pulses for r in machine.ticks(3)] == [MOST_PULSES] * 3


def test_without_samples_nothing_is_a_number(code: ct.CDLL) -> None:
    machine = Machine(code, good=False)
    seen = machine.ticks(2)[-1]
    assert seen.pulses > 0
    for value in (seen.gap_v, seen.plateau_v[0], seen.sensor_um, seen.monitor_v, seen.charge_uc):
        assert math.isnan(value)
    assert not seen.generator_siemens <= 1.0


@pytest.mark.parametrize(("v", "a"), [(400.0, None), (None, 20.0)], ids=["voltage", "current"])
def test_an_adc_at_its_rail_is_no_reading(code: ct.CDLL, v: float | None, a: float | None) -> None:
    def stuck(volts: Any, amps: Any) -> tuple[Any, Any]:
        return np.full_like(volts, v) if v else volts, np.full_like(amps, a) if a else amps

    seen = Machine(code, waves=stuck).ticks(2)[-1]
    assert math.isnan(seen.gap_v) == (v is not None)
    assert math.isnan(seen.generator_siemens) or math.isnan(seen.gap_v)
    assert math.isnan(seen.charge_uc) == (a is not None)


@pytest.mark.parametrize(
    ("rest_v", "seen_v"), [(0.0, math.nan), (0.9, math.nan), (12.0, 12.0), (400.0, math.nan)]
)
def test_a_gap_without_pulses(code: ct.CDLL, rest_v: float, seen_v: float) -> None:
    machine = Machine(code, gate_on=False, waves=lambda v, a: (np.full_like(v, rest_v), a))
    seen = machine.ticks(2)[-1]
    assert seen.pulses == 0
    assert seen.gap_v == pytest.approx(seen_v, abs=VOLT_STEP, nan_ok=True)


def test_pulses_while_the_gate_is_off_are_strays(code: ct.CDLL) -> None:
    machine = Machine(code, gate_on=False)
    assert machine.tick().stray_pulses == 0
    for at in (1100.0, 1534.8, 1969.6, 2000.0):
        machine.times["gates"].append(machine.counts(at))
    assert [r.stray_pulses for r in machine.ticks(3)] == [3, 1, 0]


def test_the_last_pulse_before_the_gate_goes_off_is_no_stray(code: ct.CDLL) -> None:
    machine = Machine(code)
    machine.tick()
    machine.gate.on, machine.gate.changes, machine.gate.off_since = False, 2, machine.counts(1850.0)
    seen = machine.ticks(1)[0]
    assert (seen.pulses, seen.stray_pulses) == (0, 0)
    assert seen.gap_v > 1.0  # what the pulses before it left in the mean


def test_a_gate_that_opens_again_begins_with_its_own_pulses(code: ct.CDLL) -> None:
    machine = Machine(code, first_us=2300.0)
    machine.gate.on_since = machine.counts(2300.0)
    machine.times["gates"] += [machine.counts(at) for at in (500.0, 1500.0, 2100.0)]
    machine.gate_on, machine.gate.on, machine.gate.changes = False, False, 0
    machine.ticks(2)
    machine.gate_on, machine.gate.on, machine.gate.changes = True, True, 1
    assert machine.tick().first_pulse_ns == pytest.approx(2_300_000, abs=13)


@pytest.mark.parametrize(
    ("channel", "count", "value"),
    [
        (0, 0, math.nan),
        (0, 4095, math.nan),
        (0, 120, -5.0 + 120 * 170.0 / 4095),
        (1, 0, math.nan),
        (1, 819, -50.0 + 819 * 500.0 / 4095),
        (2, 0, 0.0),
        (2, 1024, 25.0),
        (3, 2048, 2.5),
        (3, 4095, math.nan),
    ],
)
def test_slow_channels(code: ct.CDLL, channel: int, count: int, value: float) -> None:
    ring = np.full(SLOW, 77, np.uint16)
    ring[channel::4] = count
    for at in (0, 64, 67, 127):
        scans = Scans(ring.ctypes.data, SLOW, at, good=True)
        assert code.measure_slow(ct.byref(scans), channel) == pytest.approx(value, abs=0.02, nan_ok=True)
        scans.good = False
        assert math.isnan(code.measure_slow(ct.byref(scans), channel))


def test_a_slow_channel_is_the_mean_of_the_last_millisecond(code: ct.CDLL) -> None:
    ring = np.zeros((SLOW // 4, 4), np.uint16)
    ring[:, 2] = [4000] * 16 + list(range(1000, 1016))
    scans = Scans(ring.ctypes.data, SLOW, 0, good=True)
    assert code.measure_slow(ct.byref(scans), 2) == pytest.approx(1007.5 / 4095 * 100, abs=1e-3)
