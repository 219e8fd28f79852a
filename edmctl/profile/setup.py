"""The machine's own settings, what stays when the recipe changes, and loading them."""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from pydantic import Field, PrivateAttr, ValidationError

from edmctl.errors import Diagnostic, ProfileError
from edmctl.failures import Code
from edmctl.files import user_path
from edmctl.profile.diagnose import schema_diagnostics, schema_problems
from edmctl.profile.read import Sources, parse, read_source
from edmctl.profile.tables import Coordinate, FileName, Table, entry

ARRIVAL_RUN_UM = 50.0
"""A stage that comes from above goes this far beyond its place and comes back, so that the play of the drive always
lies on the same side."""
ASSUMED_TRAVEL_UM = 50_000.0
"""The stages travel so far to each side if the setup does not state it: 100 mm in all [assumed]."""
ASSUMED_EDGE = 0.4
"""Where the workpiece ends if the setup does not state it, as a share of the way from the pad to the parking place:
the parking place has to be clear of the workpiece by the holder of the tool."""


class Limit(NamedTuple):
    """A straight limit: nothing may lie further than `um` from the origin in the direction (`ux`, `uy`)."""

    ux: float
    uy: float
    um: float
    stated: str

    def beyond_um(self, x_um: float, y_um: float, half_um: float = 0.0) -> float:
        """Return by how much a place of that half width lies beyond the limit, µm; negative within it."""
        return self.ux * x_um + self.uy * y_um + half_um - self.um


class Actuator(Table):
    """Amplified piezo actuator; defaults: Cedrat APA400M, 445 µm at 150 V (Muralidhara et al. 2009, §2.1)."""

    gain_um_per_v: float = entry(2.967, "displacement per voltage, µm/V", ge=0.1, le=20.0)
    stroke_v: float = entry(150.0, "voltage of the full stroke, V", ge=10.0, le=200.0)
    slew_v_s: float = entry(1000.0, "fastest ramp, V/s", ge=1.0, le=20_000.0)
    conditioning_cycles: int = entry(2, "full strokes before the first touch", ge=0, le=20)
    conditioning_slew_v_s: float = entry(60.0, "their ramp, V/s", ge=1.0, le=20_000.0)
    calibration: FileName | None = entry(None, "calibration file, relative to the setup file")


class Sensor(Table):
    """Displacement sensor; the uncertainties are standard uncertainties."""

    fitted: bool = entry(True, "false: the machine runs on the calibrated actuator alone")
    gain_u_rel: float = entry(0.003, "of its calibration, relative", ge=0.0, le=0.2)
    linearity_u_um: float = entry(0.1, "of its characteristic, µm", ge=0.0, le=20.0)
    noise_um: float = entry(0.15, "RMS of one sample, µm; recorded, not acted on", ge=0.0, le=20.0)
    drift_um_per_s: float = entry(0.0017, "of its drift rate, µm/s", ge=0.0, le=1.0)


class Drift(Table):
    """What `edmctl measure-drift` does, and whether jobs are corrected by its file."""

    use: bool = entry(True, "false: jobs correct nothing, whatever was measured")
    file: FileName | None = entry(None, "of measure-drift, relative to this file; else the machine's")
    max_age_days: float = entry(30.0, "older than this it counts no more, days", gt=0.0, le=3650.0)
    apart_u_um_per_s: float = entry(0.0001, "of a drift that touches see, µm/s [assumed]", ge=0.0, le=1.0)
    duration_s: float = entry(900.0, "touches and rests, hold included, s", ge=300.0, le=14_400.0)
    interval_s: float = entry(60.0, "from touch to touch, s", ge=20.0, le=600.0)
    hold_um: float = entry(250.0, "depth of the hold between them, µm", ge=20.0, le=1000.0)
    hold_s: float = entry(300.0, "its time, s", ge=30.0, le=7200.0)
    walk_um_per_sqrt_s: float = entry(0.008, "random walk of the sensor's zero, µm/√s", ge=0.0, le=10.0)


class Surface(Table):
    """The workpiece surface. Without any limit it is assumed to end 2/5 of the way from pad to parking place."""

    tilt_u_mrad: float = entry(0.3, "standard uncertainty of its slope, mrad", ge=0.0, le=50.0)
    x_min_um: Coordinate | None = entry(None, "edge of the workpiece at its least x, µm")
    x_max_um: Coordinate | None = entry(None, "edge at its greatest x, µm")
    y_min_um: Coordinate | None = entry(None, "edge at its least y, µm")
    y_max_um: Coordinate | None = entry(None, "edge at its greatest y, µm")


class Stage(Table):
    """XY stage, its travel, where the reference pad is, and a parking place beside the work for the full stroke."""

    reference_x_um: Coordinate = 0.0
    reference_y_um: Coordinate = 0.0
    park_x_um: Coordinate = -5000.0
    park_y_um: Coordinate = 0.0
    x_min_um: Coordinate = entry(-ASSUMED_TRAVEL_UM, "least x within travel, µm")
    x_max_um: Coordinate = entry(ASSUMED_TRAVEL_UM, "greatest x within travel, µm")
    y_min_um: Coordinate = entry(-ASSUMED_TRAVEL_UM, "least y within travel, µm")
    y_max_um: Coordinate = entry(ASSUMED_TRAVEL_UM, "greatest y within travel, µm")
    speed_um_s: float = entry(1000.0, "travel, µm/s", gt=0.0, le=1e6)
    rotary_deg_s: float = entry(10.0, "turning of the rotary table, degrees/s", gt=0.0, le=1000.0)
    repeatability_um: float = entry(1.0, "of a place, ±2 standard deviations, µm", ge=0.0, le=100.0)


class Controller(Table):
    """The real-time controller."""

    servo_period_us: int = entry(
        1000,
        "period of the servo decision, µs; the controller ticks every 1000 µs",
        ge=1000,
        le=200_000,
        multiple_of=1000,
    )
    latency: int = entry(1, "decisions from reading to command", ge=0, le=50)
    actuator_lag_s: float = entry(0.002, "of amplifier and actuator, s", ge=0.0, le=1.0)
    watchdog_s: float = entry(0.25, "silence of the host that stops the machine, s", ge=0.1, le=1.0)
    telemetry_hz: float = entry(1000.0, "samples sent to the host, Hz; 1000 at most", ge=10.0, le=1000.0)

    @property
    def servo_period_s(self) -> float:
        """Period of the servo decision, s."""
        return 1e-6 * self.servo_period_us


class Link(Table):
    """The serial line to the controller."""

    baud: int = entry(500_000, "of a UART; USB ignores it", ge=9600, le=10_000_000)
    hello_s: float = entry(1.5, "longest wait for HELLO: boards reset when opened, s", ge=0.1, le=30.0)
    usb_ids: list[str] = entry(
        ["2341:0042", "2341:0010", "1a86:7523"],
        "VID:PID of boards that `auto` may ask (Arduino Mega 2560, CH340)",
    )
    candidates: list[str] = entry([], "further ports that `auto` and `serial:ID` may ask")
    secret_file: FileName | None = entry(None, "secret of a socket, relative to the setup file")


class Setup(Table):
    """All settings of one machine. `port` is where it is found when neither option nor environment say so."""

    port: str | None = Field(None, min_length=1)
    actuator: Actuator = Actuator()
    sensor: Sensor = Sensor()
    drift: Drift = Drift()
    surface: Surface = Surface()
    stage: Stage = Stage()
    controller: Controller = Controller()
    link: Link = Link()
    _file: Path | None = PrivateAttr(None)

    @property
    def file(self) -> Path | None:
        """The file that states the settings; None for the defaults."""
        return self._file

    @property
    def sha256(self) -> str:
        """Hash of all values but the port, and of edges and limits of travel only where they are stated."""
        edges = {f"{axis}_{end}_um" for axis in "xy" for end in ("min", "max")}
        assumed = {name: edges - getattr(self, name).model_fields_set for name in ("stage", "surface")}
        values = self.model_dump(mode="json", exclude={"port": True, **assumed})
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()

    def in_words(self) -> str:
        """Return which setup it is, as runs show it: `setup /etc/edm/machine.toml`."""
        return "default setup" if self._file is None else f"setup {self._file}"

    def as_mapping(self) -> Mapping[str, object]:
        """Return what results state of it: the file, the hash of its values, pad and parking place."""
        keys = ("reference_x_um", "reference_y_um", "park_x_um", "park_y_um")
        file = None if self._file is None else str(self._file)
        return {"file": file, "sha256": self.sha256, **{key: getattr(self.stage, key) for key in keys}}

    def stage_limits(self) -> list[Limit]:
        """Return the limits of the tool's axis: the travel of the stages, less what a move overruns."""
        return list(_box("stage", self.stage, ARRIVAL_RUN_UM))

    def workpiece_limits(self) -> list[Limit]:
        """Return the edges of the workpiece: those stated, else the assumed one towards the parking place."""
        if stated := list(_box("surface", self.surface)):
            return stated
        stage = self.stage
        dx_um, dy_um = stage.park_x_um - stage.reference_x_um, stage.park_y_um - stage.reference_y_um
        away_um = math.hypot(dx_um, dy_um)
        if away_um == 0.0:
            return []
        ux, uy = dx_um / away_um, dy_um / away_um
        pad_um, edge_um = ux * stage.reference_x_um + uy * stage.reference_y_um, ASSUMED_EDGE * away_um
        words = f"assumed {edge_um:g} µm from the reference pad towards the parking place"
        return [Limit(ux, uy, pad_um + edge_um, words)]


def _box(table: str, limits: Stage | Surface, overrun_um: float = 0.0) -> Iterator[Limit]:
    """Yield the limits that a table states; moves overrun a place towards smaller coordinates."""
    for axis, (ux, uy) in (("x", (1.0, 0.0)), ("y", (0.0, 1.0))):
        for end, sign, more_um in (("min", -1.0, overrun_um), ("max", 1.0, 0.0)):
            key = f"{axis}_{end}_um"
            value: float | None = getattr(limits, key)
            if value is not None:
                how = "" if key in limits.model_fields_set else " (assumed)"
                words = f"{table}.{key} = {value:g} µm{how}"
                yield Limit(sign * ux, sign * uy, sign * value - more_um, words)


def load_setup(path: Path | None = None) -> Setup:
    """Load a machine's settings, by default the stock ones. Raises ProfileError with every diagnostic."""
    if path is None:
        return Setup()
    source = read_source(path)
    sources, table = Sources((source,), source), parse(source)
    if {"servo", "target", "extends"} & set(table):
        message = f"{path} is a profile, and a setup is wanted: the settings of a machine"
        raise ProfileError((Diagnostic(Code.UNKNOWN_KEY, message, f"say --profile {path}"),))
    try:
        setup = Setup.model_validate(table)
    except ValidationError as error:
        problems = schema_problems(error, Setup, table)
        raise ProfileError(tuple(schema_diagnostics(problems, Setup, table, sources))) from None
    ramp_v_s, fastest_v_s = setup.actuator.conditioning_slew_v_s, setup.actuator.slew_v_s
    if fastest_v_s < ramp_v_s:
        fastest = f"the actuator's fastest, {fastest_v_s:g} V/s"
        message = f"the conditioning ramp, {ramp_v_s:g} V/s, is faster than {fastest}"
        hint = f"set actuator.conditioning_slew_v_s to at most {fastest_v_s:g} V/s"
        where = sources.value(("actuator", "slew_v_s"))
        raise ProfileError((Diagnostic(Code.OUT_OF_RANGE, message, hint, where),))
    if misplaced := list(_misplaced(setup, sources)):
        raise ProfileError(tuple(misplaced))
    beside: dict[str, Table] = {}
    for name, key in (("actuator", "calibration"), ("drift", "file"), ("link", "secret_file")):
        held: Table = getattr(setup, name)
        if (named := getattr(held, key)) is not None:
            beside[name] = held.model_copy(update={key: str(user_path(named, path.parent))})
    setup = setup.model_copy(update=beside)
    setup._file = path
    return setup


def _misplaced(setup: Setup, sources: Sources) -> Iterator[Diagnostic]:
    stage, edges = setup.stage, setup.workpiece_limits()
    pad, park = (stage.reference_x_um, stage.reference_y_um), (stage.park_x_um, stage.park_y_um)
    travel = ("the travel of the stages", setup.stage_limits(), "correct stage or its travel limits")
    edge = ("the edge of the workpiece", edges, "correct stage.reference or the edge")
    for name, place, key, (what, limits, hint) in (
        ("the reference pad", pad, "reference_x_um", travel),
        ("the parking place", park, "park_x_um", travel),
        ("the reference pad", pad, "reference_x_um", edge),
    ):
        where = sources.value(("stage", key))
        for limit in limits:
            if (beyond_um := limit.beyond_um(*place)) > 0.0:
                message = f"{name} is {beyond_um:g} µm beyond {what}, {limit.stated}"
                yield Diagnostic(Code.OUT_OF_REACH, message, hint, where)
    if all(one.beyond_um(*park) <= 0.0 for one in edges):
        message = "the parking place is over the workpiece, where the tool would collide in its full stroke"
        hint = "park the tool beside the workpiece, or correct the edges in [surface]"
        yield Diagnostic(Code.OUT_OF_REACH, message, hint, sources.value(("stage", "park_x_um")))
