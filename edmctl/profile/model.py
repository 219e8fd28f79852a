"""The recipe of a job: every table of a profile file with its units and limits."""

from typing import Annotated, Literal

from pydantic import Field

from edmctl.profile.sites import Array, PathTable, SiteTable
from edmctl.profile.tables import ONE_LINE, Line, Name, Table, entry


class Meta(Table):
    """What the recipe is called."""

    schema_version: int = Field(1, ge=1, le=1, alias="schema", description="version of this format")
    name: str = entry(..., "short name of the recipe", min_length=1, max_length=80, pattern=ONE_LINE)
    description: Line = entry("", "title of the run file")


class Tool(Table):
    """The electrode."""

    id: Name | None = entry(
        None,
        "name of this very electrode, whose wear is carried from job to job; "
        "its material and diameter when not given",
    )
    material: Name = entry(
        ..., "Cu, W, WC, brass, graphite, CuW or steel, or another that nothing is known of"
    )
    diameter_um: float = entry(..., "diameter, µm", ge=20.0, le=1000.0)
    free_length_um: float = entry(
        10_000.0, "length out of the holder, µm; recorded, not acted on", ge=500.0, le=20_000.0
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
    kind: Literal["blind", "through"] = entry(
        "blind", 'a blind hole, or one through the sheet (target.kind = "through")'
    )
    removal_um3_per_uj: float = entry(
        0.0,
        "volume removed per discharge energy, until it is measured, µm³/µJ; "
        "by materials and pulses when not given",
        gt=0.0,
        le=10.0,
    )
    removal_u_rel: float = entry(
        0.0,
        "standard uncertainty of that, relative; by the material when not given [assumed]",
        gt=0.0,
        le=1.0,
    )
    side_gap_um: float = entry(
        0.0, "gap between tool and hole wall, µm; by voltage and energy when not given", gt=0.0, le=100.0
    )


class Pulse(Table):
    """The pulse generator."""

    mode: Literal["isofrequency", "isopulse"] = entry(
        "isofrequency", "fixed on-time, or fixed discharge time after ignition"
    )
    frequency_hz: float = entry(..., "pulses per second, Hz", ge=100.0, le=50_000.0)
    duty: float = entry(..., "on-time over period", ge=0.05, le=0.85)
    discharge_us: float | None = entry(None, "isopulse only: burning time, µs", gt=0.0, le=5000.0)
    open_voltage_v: float = entry(..., "voltage of the open gap, V", ge=20.0, le=120.0)
    current_a: float = entry(..., "peak current, A", ge=0.01, le=3.0)
    discharge_voltage_v: float = entry(22.0, "plateau of a normal discharge, V", ge=10.0, le=60.0)
    polarity: Literal["tool-negative", "tool-positive"] = entry(
        "tool-negative", "the generator is wired by hand; forecasts and the virtual machine go by it"
    )

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
    """The gap servo.

    The reference is stated once: as `reference` (share of the open mean voltage) or as `reference_v` (volts).
    After loading, `reference` always holds the share.
    """

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
    completion_um: float | None = entry(
        None, "feed after the breakthrough, µm; half the tool's diameter when not given", ge=0.0, le=1000.0
    )


class Wear(Table):
    """What is known of tool wear, and how often it is measured."""

    expected_ratio: float = entry(
        0.0, "wear length per depth; by materials and pulses when not given", ge=0.0, le=5.0
    )
    ratio_u_rel: float = entry(
        0.10, "standard uncertainty of that before it is measured, relative [assumed]", gt=0.0, le=1.0
    )
    remeasure: Literal["auto", "sparing", "never"] | Annotated[int, Field(ge=1, le=20)] = entry(
        "auto",
        "auto: as often as the uncertainty of the depth asks for, and at the end of a single hole; "
        "sparing: not there either after a small last cut; never: only at the end; n: n times before",
    )
    first_fraction: float = entry(
        0.85, "share of the depth in the first cut, which feeds no further than the depth", ge=0.1, le=1.0
    )
    max_cuts: int = entry(5, "of a hole; of several regimes, of each", ge=1, le=20)


class Jump(Table):
    """Electrode jumps that flush the gap."""

    mode: Literal["off", "fixed", "adaptive"] = entry(
        "fixed", "adaptive: from period_s down to period_min_s while arcs or shorts ask for it, or rarer"
    )
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
    begins where pulses and materials let expect the most removal, whatever `[servo]` says, and follows the arcs.
    """

    arc_high: float = entry(0.05, "share of arcs that halves the jump period", gt=0.0, le=1.0)
    short_high: float = entry(0.03, "share of shorts that does", gt=0.0, le=1.0)
    arc_low: float = entry(0.02, "below this the period grows again", gt=0.0, le=1.0)
    short_low: float = entry(0.005, "together with this share of shorts", gt=0.0, le=1.0)
    reference_step: float = entry(0.02, "raise of the servo reference at a time", ge=0.0, le=0.1)
    reference_max: float = entry(0.90, "highest servo reference", gt=0.0, lt=1.0)
    duty_step: float = entry(0.20, "share of the duty that is taken off at a time", ge=0.0, lt=1.0)
    duty_min: float = entry(0.10, "lowest duty", ge=0.05, le=0.6)
    seek_reference: bool = entry(
        False, "find the servo reference of the most removal during the cut, in any `jump.mode`"
    )
    arc_target: float | None = entry(
        None,
        "share of arcs that is kept then; where removal is expected to be the most, when not given",
        gt=0.0,
        le=0.5,
    )


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
    expected_gap_um: float = entry(
        0.0,
        "working gap assumed until the first cut was measured, µm; by the pulses when not given",
        ge=0.5,
        le=20.0,
    )


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
    pulses: Literal["blocks", "full", "off"] = entry(
        "blocks", "counts per block of pulses, every pulse, or neither"
    )


class Regime(Table):
    """Pulses for a share of the depth, from roughing to finishing; what is not given is that of the profile."""

    name: Name = entry(..., "what messages call it")
    share: float = entry(..., "of the depth; all shares together are 1", gt=0.0, lt=1.0)
    current_a: float | None = entry(None, "peak current, A", ge=0.01, le=3.0)
    frequency_hz: float | None = entry(None, "pulses per second, Hz", ge=100.0, le=50_000.0)
    duty: float | None = entry(None, "on-time over period", ge=0.05, le=0.85)
    reference: float | None = entry(
        None, "of the servo: mean gap voltage over its open value", gt=0.0, lt=1.0
    )


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
