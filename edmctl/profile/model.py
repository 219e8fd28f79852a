"""The tables of a profile file with their units and limits: the recipe of a job, and `[sim]`; their JSON schema."""

from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import Discriminator, Field, Tag

from edmctl.profile.tables import ONE_LINE, Coordinate, FileName, Line, Name, Table, entry


class PointSite(Table):
    """One place to machine, in stage coordinates."""

    kind: Literal["point"] = "point"
    name: Name | None = entry(None, "numbered when not given")
    x_um: Coordinate = entry(..., "stage coordinate, µm")
    y_um: Coordinate = entry(0.0, "stage coordinate, µm")
    theta_deg: float = entry(0.0, "of the rotary table, degrees", ge=-360.0, le=360.0)
    depth_um: float | None = entry(None, "instead of target.depth_um, µm", gt=0.0, le=2000.0)


class GridSites(Table):
    """Rows and columns of places."""

    kind: Literal["grid"]
    name: str = entry("grid", "prefix of the names", min_length=1, max_length=32, pattern=ONE_LINE)
    x_um: Coordinate = entry(..., "first place, µm")
    y_um: Coordinate = entry(0.0, "first place, µm")
    columns: int = entry(..., "places along x", ge=1, le=1000)
    rows: int = entry(1, "places along y", ge=1, le=1000)
    dx_um: float = entry(..., "from column to column, µm", ge=-1e5, le=1e5)
    dy_um: float = entry(0.0, "from row to row, µm", ge=-1e5, le=1e5)
    depth_um: float | None = entry(None, "instead of target.depth_um, µm", gt=0.0, le=2000.0)


class CircleSites(Table):
    """Places on a circle."""

    kind: Literal["circle"]
    name: str = entry("circle", "prefix of the names", min_length=1, max_length=32, pattern=ONE_LINE)
    x_um: Coordinate = entry(..., "centre, µm")
    y_um: Coordinate = entry(0.0, "centre, µm")
    radius_um: float = entry(..., "from the centre, µm", gt=0.0, le=1e6)
    count: int = entry(..., "number of places", ge=1, le=1000)
    start_deg: float = entry(0.0, "direction of the first place, from x towards y", ge=-360.0, le=360.0)
    depth_um: float | None = entry(None, "instead of target.depth_um, µm", gt=0.0, le=2000.0)


class FileSites(Table):
    """Places from a CSV file with the columns x_um and y_um, and name, theta_deg and depth_um where wanted."""

    kind: Literal["file"]
    path: FileName = entry(..., "relative to the profile that names it")


class Array(Table):
    """How the places of `[[sites]]` are worked off."""

    order: Literal["nearest", "given"] = entry("nearest", "shortest way, or as written")
    surface: Literal["plane", "pad"] = entry("plane", "touch three places for a plane, or trust the pad")


class PathTable(Table):
    """A channel: a way of the tool's axis in stage coordinates, cut in layers to target.depth_um."""

    kind: Literal["rectangle", "circle", "spiral"]
    x_um: Coordinate = entry(..., "centre, µm")
    y_um: Coordinate = entry(0.0, "centre, µm")
    width_um: float | None = entry(None, "rectangle: along x, µm", gt=0.0, le=1e5)
    height_um: float | None = entry(None, "rectangle: along y, µm", gt=0.0, le=1e5)
    radius_um: float | None = entry(None, "circle: its radius; spiral: the inner one, µm", gt=0.0, le=1e5)
    pitch_um: float | None = entry(None, "spiral: from turn to turn, µm", gt=0.0, le=1e5)
    turns: float | None = entry(None, "spiral: number of turns", gt=0.0, le=100.0)
    layer_um: float = entry(2.0, "depth of one layer, µm", gt=0.0, le=50.0)
    speed_um_s: float = entry(100.0, "along the path, µm/s", ge=1.0, le=5000.0)


def _kind_of(site: object) -> str:
    """The kind that an item of `[[sites]]` states; one that states none is a point."""
    kind = site.get("kind", "point") if isinstance(site, dict) else getattr(site, "kind", "point")
    return kind if isinstance(kind, str) else repr(kind)


SiteTable: TypeAlias = Annotated[
    Annotated[PointSite, Tag("point")]
    | Annotated[GridSites, Tag("grid")]
    | Annotated[CircleSites, Tag("circle")]
    | Annotated[FileSites, Tag("file")],
    Discriminator(_kind_of),
]
"""One item of `[[sites]]`."""


class Meta(Table):
    """What the recipe is called."""

    schema_version: int = Field(1, ge=1, le=1, alias="schema", description="version of this format")
    name: str = entry(..., "short name of the recipe", min_length=1, max_length=80, pattern=ONE_LINE)
    description: Line = entry("", "title of the run file")


class Tool(Table):
    """The electrode."""

    id: Name | None = entry(None, "this very electrode, whose wear adds up; else material and diameter")
    material: Name = entry(..., "Cu, W, WC, brass, graphite, CuW, steel, or an unknown one")
    diameter_um: float = entry(..., "diameter, µm", ge=20.0, le=1000.0)
    free_length_um: float = entry(
        10_000.0, "out of the holder, µm; recorded, not acted on", ge=500.0, le=20_000.0
    )
    max_wear_um: float = entry(2000.0, "length it may lose in all, µm", gt=0.0, le=20_000.0)

    @property
    def label(self) -> str:
        """What the job ledger calls this electrode."""
        return self.id or f"{self.material} {self.diameter_um:g} µm"


class Work(Table):
    """The workpiece, and how it erodes."""

    material: Name = entry(..., "Cu, steel, Ti-6Al-4V, WC-Co or brass, or another that nothing is known of")
    thickness_um: float = entry(..., "sheet thickness, µm", gt=0.0, le=20_000.0)
    kind: Literal["blind", "through"] = entry("blind", 'or through the sheet (target.kind = "through")')
    removal_um3_per_uj: float = entry(
        0.0, "volume per energy, µm³/µJ; else by the materials", gt=0.0, le=10.0
    )
    removal_u_rel: float = entry(0.0, "its standard uncertainty; else by the material", gt=0.0, le=1.0)
    side_gap_um: float = entry(0.0, "from tool to wall, µm; else by the pulses", gt=0.0, le=100.0)


class Pulse(Table):
    """The pulse generator."""

    mode: Literal["isofrequency", "isopulse"] = entry("isofrequency", "fixed on-time, or burning time")
    frequency_hz: float = entry(..., "pulses per second, Hz", ge=100.0, le=50_000.0)
    duty: float = entry(..., "on-time over period", ge=0.05, le=0.85)
    discharge_us: float | None = entry(None, "isopulse only: burning time, µs", gt=0.0, le=5000.0)
    open_voltage_v: float = entry(..., "voltage of the open gap, V", ge=20.0, le=120.0)
    current_a: float = entry(..., "peak current, A", ge=0.01, le=3.0)
    discharge_voltage_v: float = entry(22.0, "plateau of a normal discharge, V", ge=10.0, le=60.0)
    polarity: Literal["tool-negative", "tool-positive"] = entry("tool-negative", "as the generator is wired")

    @property
    def period_s(self) -> float:
        """Time from pulse to pulse, s."""
        return 1.0 / self.frequency_hz

    @property
    def on_time_us(self) -> float:
        """Time per pulse with voltage applied, µs."""
        return 1e6 * self.duty / self.frequency_hz

    @property
    def off_time_us(self) -> float:
        """Time per pulse without voltage, µs."""
        return 1e6 * (1.0 - self.duty) / self.frequency_hz

    @property
    def duty_voltage_v(self) -> float:
        """Mean gap voltage while every pulse stays open, V: what servo level 1 means."""
        return self.duty * self.open_voltage_v

    @property
    def rho(self) -> float:
        """Servo level while every pulse ignites at once: discharge voltage over open voltage."""
        return self.discharge_voltage_v / self.open_voltage_v

    @property
    def burning_time_us(self) -> float:
        """Longest time a discharge burns in one pulse, µs."""
        return self.on_time_us if self.discharge_us is None else self.discharge_us


class Servo(Table):
    """The gap servo. The reference is stated as share or in volts; after loading, `reference` is the share."""

    mode: Literal["relay", "pi"] = "relay"
    reference: float = entry(0.0, "mean gap voltage over its open value", gt=0.0, lt=1.0)
    reference_v: float | None = entry(None, "the same in V, instead", gt=0.0, le=120.0)
    forward_um_s: float = entry(5.0, "ramp towards the work, µm/s", ge=0.5, le=50.0)
    back_um_s: float = entry(5.0, "ramp away from the work, µm/s", ge=0.25, le=500.0)
    short_back_um_s: float = entry(50.0, "ramp away while shorted, µm/s", ge=5.0, le=500.0)
    filter_hz: float = entry(20.0, "low-pass of the mean gap voltage, Hz", ge=2.0, le=300.0)
    hysteresis: float = entry(0.02, "of the open mean voltage", ge=0.0, le=0.05)
    kp: float = entry(20.0, "PI law: µm/s per unit of level", ge=0.0, le=1000.0)
    ki: float = entry(20.0, "PI law: µm/s² per unit of level", ge=0.0, le=10_000.0)


class Approach(Table):
    """From home to the spark gap."""

    speed_um_s: float = entry(1.0, "feed, µm/s; that of the cut where sparks erode faster", ge=0.2, le=5.0)
    offset_um: float = entry(50.0, "gap between tool and work at 0 V, µm", gt=0.0, le=200.0)
    max_travel_um: float = entry(120.0, "give up after this way, µm", gt=0.0, le=500.0)


class DepthTarget(Table):
    """Cut until the measured depth is reached."""

    kind: Literal["depth"] = entry(..., 'or "feed" with feed_um, or "through"')
    depth_um: float = entry(..., "depth below the surface, µm", gt=0.0, le=2000.0)
    tolerance_um: float = entry(2.0, "permitted deviation, µm", gt=0.0, le=100.0)


class FeedTarget(Table):
    """Cut until the tool has fed this far below the surface, wear and all."""

    kind: Literal["feed"] = entry(..., 'or "depth" with depth_um and tolerance_um, or "through"')
    feed_um: float = entry(..., "feed below the surface, µm", gt=0.0, le=2000.0)


class ThroughTarget(Table):
    """Cut through the sheet, and on until the worn tip has gone through."""

    kind: Literal["through"] = entry(..., 'or "depth", or "feed"; with work.kind = "through"')
    completion_um: float | None = entry(None, "feed after it, µm; else half the diameter", ge=0.0, le=1000.0)


class Wear(Table):
    """What is known of tool wear, and how often it is measured."""

    expected_ratio: float = entry(0.0, "wear length per depth; else by materials and pulses", ge=0.0, le=5.0)
    ratio_u_rel: float = entry(0.10, "its relative standard uncertainty [assumed]", gt=0.0, le=1.0)
    remeasure: Literal["auto", "sparing", "never"] | Annotated[int, Field(ge=1, le=20)] = entry(
        "auto",
        "auto: as often as the uncertainty of the depth asks for, and at the end of a single hole; "
        "sparing: not there either after a small last cut; never: only at the end; n: n times before",
    )
    first_fraction: float = entry(0.85, "share of the depth that the first cut feeds at most", ge=0.1, le=1.0)
    max_cuts: int = entry(5, "of a hole; of several regimes, of each", ge=1, le=20)


class Jump(Table):
    """Electrode jumps that flush the gap."""

    mode: Literal["off", "fixed", "adaptive"] = entry("fixed", "adaptive: period by arcs and shorts")
    period_s: float = entry(10.0, "from jump to jump, s", ge=0.2, le=600.0)
    period_min_s: float = entry(1.5, "adaptive: shortest period, s", ge=0.2, le=600.0)
    height_um: float = entry(60.0, "retraction, µm", ge=5.0, le=400.0)
    speed_um_s: float = entry(2000.0, "up and down, µm/s", ge=50.0, le=5000.0)
    dwell_ms: float = entry(20.0, "pause at the top, ms", ge=0.0, le=5000.0)

    @property
    def dwell_s(self) -> float:
        """Pause at the top, s."""
        return 1e-3 * self.dwell_ms


class Adaptive(Table):
    """How the supervisor answers arcs and shorts where `jump.mode` is "adaptive".

    The jump period comes first, then the servo reference, then the off-time. With `seek_reference` the reference
    begins where the most removal is expected by pulses and materials, whatever `[servo]` says, and follows the arcs.
    """

    arc_high: float = entry(0.05, "share of arcs that halves the jump period", gt=0.0, le=1.0)
    short_high: float = entry(0.03, "share of shorts that does", gt=0.0, le=1.0)
    arc_low: float = entry(0.02, "below this the period grows again", gt=0.0, le=1.0)
    short_low: float = entry(0.005, "together with this share of shorts", gt=0.0, le=1.0)
    reference_step: float = entry(0.02, "raise of the servo reference at a time", ge=0.0, le=0.1)
    reference_max: float = entry(0.90, "highest servo reference", gt=0.0, lt=1.0)
    duty_step: float = entry(0.20, "share of the duty that is taken off at a time", ge=0.0, lt=1.0)
    duty_min: float = entry(0.10, "lowest duty", ge=0.05, le=0.6)
    seek_reference: bool = entry(False, "find the servo reference of the most removal, in any `jump.mode`")
    arc_target: float | None = entry(None, "share of arcs; else of the most removal", gt=0.0, le=0.5)


class Measure(Table):
    """How Z is touched. One slow speed serves Z1, Z2 and Z3, so that creep enters all three alike."""

    speed_um_s: float = entry(1.0, "speed at contact, µm/s", ge=0.1, le=5.0)
    fast_um_s: float = entry(20.0, "speed up to near contact, µm/s", ge=1.0, le=200.0)
    touches: int = entry(3, "touches per Z", ge=1, le=20)
    settle_s: float = entry(1.0, "rest before touching, s", ge=0.0, le=60.0)
    max_sd_um: float = entry(0.5, "scatter of touches that is accepted, µm", gt=0.0, le=10.0)
    site_dx_um: float = entry(500.0, "from the hole to the pad, µm", ge=0.0, le=50_000.0)
    back_off_um: float = entry(3.0, "retraction between touches, µm", ge=1.0, le=50.0)
    dwell_s: float = entry(0.3, "hunting at contact, s", ge=0.05, le=10.0)
    expected_gap_um: float = entry(0.0, "gap until it is measured, µm; else by the pulses", ge=0.5, le=20.0)


class Limits(Table):
    """Where a job stops."""

    stroke_v_max: float = entry(120.0, "largest actuator command, V", ge=10.0, le=150.0)
    max_time_s: float = entry(0.0, "longest job, s; three times the forecast when not given", gt=0.0, le=1e6)
    arc_ratio: float = entry(0.15, "share of arcs that stops the job", gt=0.0, le=1.0)
    short_ratio: float = entry(0.5, "share of shorts that stops the job", gt=0.0, le=1.0)
    open_lost_um: float = entry(15.0, "advance without sparks that stops, µm", ge=1.0, le=500.0)


class Flush(Table):
    """The dielectric."""

    required: bool = True
    min_flow_lpm: float = entry(0.5, "least flow, L/min", ge=0.0, le=100.0)
    max_temp_c: float = entry(30.0, "warmest dielectric, °C", ge=0.0, le=60.0)


class Log(Table):
    """What the run file holds."""

    servo_hz: float = entry(100.0, "samples of voltage and displacement, Hz", ge=1.0, le=1000.0)
    pulses: Literal["blocks", "full", "off"] = entry("blocks", "counts per block, every pulse, or none")


class Regime(Table):
    """Pulses for a share of the depth, from roughing to finishing; what is not given is that of the profile."""

    name: Name = entry(..., "what messages call it")
    share: float = entry(..., "of the depth; all shares together are 1", gt=0.0, lt=1.0)
    current_a: float | None = entry(None, "peak current, A", ge=0.01, le=3.0)
    frequency_hz: float | None = entry(None, "pulses per second, Hz", ge=100.0, le=50_000.0)
    duty: float | None = entry(None, "on-time over period", ge=0.05, le=0.85)
    reference: float | None = entry(None, "of the servo, over its open value", gt=0.0, lt=1.0)


class Profile(Table):
    """A whole recipe."""

    meta: Meta
    tool: Tool
    work: Work
    pulse: Pulse
    servo: Servo
    approach: Approach = Approach()
    target: Annotated[DepthTarget | FeedTarget | ThroughTarget, Field(discriminator="kind")]
    wear: Wear = Wear()
    jump: Jump = Jump()
    adaptive: Adaptive = Adaptive()
    sites: list[SiteTable] = entry([], "places to machine; one beside the reference pad when there are none")
    regimes: list[Regime] = entry([], "roughing to finishing, in this order, for one blind hole")
    array: Array = Array()
    path: PathTable | None = entry(None, "a channel instead of holes")
    measure: Measure = Measure()
    limits: Limits = Limits()
    flush: Flush = Flush()
    log: Log = Log()

    def having(self, table: str, **values: Any) -> Self:
        """Return a copy with other values in a table."""
        return self.model_copy(update={table: getattr(self, table).model_copy(update=values)})


class SimSettings(Table):
    """Constants of the simulated discharge process.

    The generator's series resistance is not among them: current and voltages of `[pulse]` fix it. Orders of
    magnitude after Muralidhara et al. 2009; the rest is fitted so that its holes come out.
    """

    work_removal: float | None = entry(None, "of the work over copper; else by material", gt=0.0, le=100.0)
    tool_wear: float | None = entry(None, "of the tool over copper; else by material", ge=0.0, le=100.0)
    controller: Literal["firmware", "firmware-float", "stm32"] = entry(
        "firmware", "what drives it: the firmware's core, that in a board's arithmetic, or a board's image"
    )
    spread: float = entry(0.03, "relative sd of the figures below from machine to machine", ge=0.0, le=0.5)
    sensor_gain_sd: float | None = entry(None, "sd of the sensor's gain; else by the setup", ge=0.0, le=0.2)
    sensor_drift_sd_um_s: float | None = entry(None, "of its drift, µm/s; else by the setup", ge=0.0, le=1.0)
    machine_drift_sd_um_s: float = entry(0.0, "sd of a drift that no sensor sees, µm/s", ge=0.0, le=1.0)
    tilt_sd_mrad: float | None = entry(
        None, "sd of the work's slopes, mrad; else by the setup", ge=0.0, le=50.0
    )
    discharge_v: float = entry(22.0, "plateau of a normal discharge, V", gt=0.0, le=100.0)
    arc_v: float = entry(17.0, "plateau of an arc, V", gt=0.0, le=100.0)
    short_v: float = entry(1.0, "gap voltage of a short, V", ge=0.0, le=20.0)
    scatter: float = entry(0.3, "log-normal spread of a crater's volume", ge=0.0, le=2.0)
    gap_reference_um: float = entry(2.5, "gap that ignites as below at 40 V, µm", gt=0.0, le=50.0)
    tau_reference_us: float = entry(60.0, "its mean statistical delay, µs", gt=0.0, le=1e5)
    gap_exponent: float = entry(4.0, "delay against gap, a power", ge=1.0, le=12.0)
    formative_us: float = entry(1.0, "least ignition delay, µs", ge=0.0, le=100.0)
    roughness_um: float = entry(0.20, "surface peaks at a pulse of 344 µJ, µm", ge=0.0, le=5.0)
    debris_gap_factor: float = entry(1.5, "narrowing per debris fraction", ge=0.0, le=10.0)
    flush_time_s: float = entry(0.5, "debris clearance at Ø270 µm, s", gt=0.0, le=1000.0)
    flush_depth_ratio: float = entry(1.1, "depth/diameter that doubles it", gt=0.0, le=100.0)
    redeposition: float = entry(0.19, "debris fraction that halves removal", gt=0.0, le=100.0)
    arc_base: float = entry(0.01, "arc probability without debris", ge=0.0, le=1.0)
    arc_debris: float = entry(0.16, "debris fraction at which sparks arc", gt=0.0, le=100.0)
    arc_delay_us: float = entry(20.0, "ignition delay that fades this, µs", gt=0.0, le=1e4)
    arc_pause_us: float = entry(800.0, "off-time that halves this, µs", gt=0.0, le=1e6)
    arc_work: float = entry(0.15, "work removed by an arc over a discharge", ge=0.0, le=10.0)
    arc_tool: float = entry(0.9, "tool removed by an arc over a discharge", ge=0.0, le=10.0)
    bridge_clear: float = entry(0.02, "chance per pulse that a bridge burns off", gt=0.0, le=1.0)
    side_base: float = entry(0.03, "share of discharges at the wall", ge=0.0, le=1.0)
    side_debris: float = entry(0.6, "more of them per debris fraction", ge=0.0, le=10.0)
    removal_um3_per_uj: float = entry(0.0811, "work removed per energy at best, µm³/µJ", gt=0.0, le=10.0)
    tool_share: float = entry(0.827, "tool removed per work, at equal shares", ge=0.0, le=10.0)
    peak_us: float = entry(40.0, "burning time of the most removal at 0.12 A, µs", gt=0.0, le=1e4)
    peak_exponent: float = entry(0.75, "sharpness of that optimum", gt=0.0, le=4.0)
    peak_per_current: float = entry(0.3, "its growth with current, a power", ge=0.0, le=2.0)
    threshold_uj: float = entry(1.0, "energy that removes nothing, µJ", ge=0.0, le=1000.0)
    cathode_least: float = entry(0.15, "erosion of cathode over anode, shortest", ge=0.0, le=10.0)
    cathode_us: float = entry(568.0, "burning time that adds as much, µs", gt=0.0, le=1e5)
    cathode_exponent: float = entry(0.8, "of that growth", gt=0.0, le=4.0)
    carbon_us: float = entry(60.0, "burning time that halves positive wear, µs", gt=0.0, le=1e5)
    carbon_per_current: float = entry(-0.3, "its change with current, a power", ge=-2.0, le=2.0)
    deionisation_us: float = entry(15.0, "decay of a channel at 344 µJ, µs", ge=0.0, le=1e4)
    deionisation_exponent: float = entry(0.3, "its growth with energy, a power", ge=0.0, le=2.0)
    deionisation_debris: float = entry(4.0, "its growth per debris fraction", ge=0.0, le=100.0)
    deionisation_after_arc: float = entry(1.5, "its growth after an arc", ge=1.0, le=10.0)
    bridge_base: float = entry(0.2, "bridging across half a particle, full gap", ge=0.0, le=1.0)
    particle_um: float = entry(0.9, "particles of a pulse of 344 µJ, µm", gt=0.0, le=50.0)
    side_per_voltage_um: float = entry(4.0, "gap at the wall by 40 V, µm", ge=0.0, le=100.0)
    side_per_energy_um: float = entry(4.0, "and by a pulse of 344 µJ, µm", ge=0.0, le=100.0)
    tip_rounding_um: float = entry(0.0, "how far the tool's edge is behind its tip, µm", ge=0.0, le=100.0)


class ProfileFile(Profile):
    """A profile file as written: the recipe and the `[sim]` table."""

    sim: SimSettings = SimSettings()


def profile_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a profile file; tables may be inherited, items of a list have all their
    keys.
    """
    schema = ProfileFile.model_json_schema(by_alias=True)
    complete = {"required": schema.pop("required")}
    for description in schema["properties"].values():
        for kind in description.get("oneOf", description.get("anyOf", [description])):
            schema["$defs"].get(kind.get("$ref", "").rpartition("/")[2], {}).pop("required", None)
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "profile whose values hold where this one states none, relative to this file, or shipped",
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "edmctl machining profile",
        "anyOf": [{"required": ["extends"]}, complete],
    }
