"""The recipe of a job: every table of a profile file with its units and limits."""

from typing import Annotated, Literal

from pydantic import Field

from edmctl.profile.sites import Array, PathTable, SiteTable
from edmctl.profile.tables import ONE_LINE, Table


class Meta(Table):
    """What the recipe is called."""

    schema_version: int = Field(1, ge=1, le=1, alias="schema", description="version of this format")
    name: str = Field(min_length=1, max_length=80, pattern=ONE_LINE, description="short name of the recipe")
    description: str = Field("", pattern=ONE_LINE, description="title of the run file")


class Tool(Table):
    """The electrode."""

    id: str | None = Field(
        None,
        min_length=1,
        max_length=40,
        pattern=ONE_LINE,
        description="name of this very electrode, whose wear is carried from job to job; "
        "its material and diameter when not given",
    )
    material: str = Field(
        min_length=1,
        max_length=40,
        pattern=ONE_LINE,
        description="Cu, W, WC, brass, graphite, CuW or steel, or another that nothing is known of",
    )
    diameter_um: float = Field(ge=20.0, le=1000.0, description="diameter, µm")
    free_length_um: float = Field(
        10_000.0, ge=500.0, le=20_000.0, description="length out of the holder, µm; recorded, not acted on"
    )
    max_wear_um: float = Field(2000.0, gt=0.0, le=20_000.0, description="length it may lose in all, µm")

    @property
    def label(self) -> str:
        """What the job ledger calls this electrode."""
        return self.id or f"{self.material} {self.diameter_um:g} µm"


class Work(Table):
    """The workpiece, and how it erodes."""

    material: str = Field(
        min_length=1,
        max_length=40,
        pattern=ONE_LINE,
        description="Cu, steel, Ti-6Al-4V, WC-Co or brass, or another that nothing is known of",
    )
    thickness_um: float = Field(gt=0.0, le=20_000.0, description="sheet thickness, µm")
    kind: Literal["blind", "through"] = Field(
        "blind", description='a blind hole, or one through the sheet (target.kind = "through")'
    )
    removal_um3_per_uj: float = Field(
        0.0,
        gt=0.0,
        le=10.0,
        description="volume removed per discharge energy, until it is measured, µm³/µJ; "
        "by materials and pulses when not given",
    )
    removal_u_rel: float = Field(
        0.0,
        gt=0.0,
        le=1.0,
        description="standard uncertainty of that, relative; by the material when not given [assumed]",
    )
    side_gap_um: float = Field(
        0.0,
        gt=0.0,
        le=100.0,
        description="gap between tool and hole wall, µm; by voltage and energy when not given",
    )


class Pulse(Table):
    """The pulse generator."""

    mode: Literal["isofrequency", "isopulse"] = Field(
        "isofrequency", description="fixed on-time, or fixed discharge time after ignition"
    )
    frequency_hz: float = Field(ge=100.0, le=50_000.0, description="pulses per second, Hz")
    duty: float = Field(ge=0.05, le=0.85, description="on-time over period")
    discharge_us: float | None = Field(None, gt=0.0, le=5000.0, description="isopulse only: burning time, µs")
    open_voltage_v: float = Field(ge=20.0, le=120.0, description="voltage of the open gap, V")
    current_a: float = Field(ge=0.01, le=3.0, description="peak current, A")
    discharge_voltage_v: float = Field(22.0, ge=10.0, le=60.0, description="plateau of a normal discharge, V")
    polarity: Literal["tool-negative", "tool-positive"] = Field(
        "tool-negative",
        description="the generator is wired by hand; forecasts and the virtual machine go by it",
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
    reference: float = Field(0.0, gt=0.0, lt=1.0, description="mean gap voltage over its open value")
    reference_v: float | None = Field(None, gt=0.0, le=120.0, description="the same in V, instead")
    forward_um_s: float = Field(5.0, ge=0.5, le=50.0, description="ramp towards the work, µm/s")
    back_um_s: float = Field(5.0, ge=0.25, le=500.0, description="ramp away from the work, µm/s")
    short_back_um_s: float = Field(50.0, ge=5.0, le=500.0, description="ramp away while shorted, µm/s")
    filter_hz: float = Field(20.0, ge=2.0, le=300.0, description="low-pass of the mean gap voltage, Hz")
    hysteresis: float = Field(0.02, ge=0.0, le=0.05, description="of the open mean voltage")
    kp: float = Field(20.0, ge=0.0, le=1000.0, description="PI law: µm/s per unit of level")
    ki: float = Field(20.0, ge=0.0, le=10_000.0, description="PI law: µm/s² per unit of level")


class Approach(Table):
    """From home to the spark gap."""

    speed_um_s: float = Field(
        1.0, ge=0.2, le=5.0, description="feed, µm/s; that of the cut where sparks erode faster"
    )
    offset_um: float = Field(50.0, gt=0.0, le=200.0, description="gap between tool and work at 0 V, µm")
    max_travel_um: float = Field(120.0, gt=0.0, le=500.0, description="give up after this way, µm")


class DepthTarget(Table):
    """Cut until the measured depth is reached."""

    kind: Literal["depth"] = Field(description='or "feed" with feed_um, or "through"')
    depth_um: float = Field(gt=0.0, le=2000.0, description="depth below the surface, µm")
    tolerance_um: float = Field(2.0, gt=0.0, le=100.0, description="permitted deviation, µm")


class FeedTarget(Table):
    """Cut until the tool has fed this far below the surface, wear and all."""

    kind: Literal["feed"] = Field(description='or "depth" with depth_um and tolerance_um, or "through"')
    feed_um: float = Field(gt=0.0, le=2000.0, description="feed below the surface, µm")


class ThroughTarget(Table):
    """Cut through the sheet, and on until the worn tip has gone through."""

    kind: Literal["through"] = Field(description='or "depth", or "feed"; with work.kind = "through"')
    completion_um: float | None = Field(
        None,
        ge=0.0,
        le=1000.0,
        description="feed after the breakthrough, µm; half the tool's diameter when not given",
    )


class Wear(Table):
    """What is known of tool wear, and how often it is measured."""

    expected_ratio: float = Field(
        0.0, ge=0.0, le=5.0, description="wear length per depth; by materials and pulses when not given"
    )
    ratio_u_rel: float = Field(
        0.10,
        gt=0.0,
        le=1.0,
        description="standard uncertainty of that before it is measured, relative [assumed]",
    )
    remeasure: Literal["auto", "sparing", "never"] | Annotated[int, Field(ge=1, le=20)] = Field(
        "auto",
        description="auto: as often as the uncertainty of the depth asks for, and at the end of a single hole; "
        "sparing: not there either after a small last cut; never: only at the end; n: n times before",
    )
    first_fraction: float = Field(
        0.85,
        ge=0.1,
        le=1.0,
        description="share of the depth in the first cut, which feeds no further than the depth",
    )
    max_cuts: int = Field(5, ge=1, le=20, description="of a hole; of several regimes, of each")


class Jump(Table):
    """Electrode jumps that flush the gap."""

    mode: Literal["off", "fixed", "adaptive"] = Field(
        "fixed",
        description="adaptive: from period_s down to period_min_s while arcs or shorts ask for it, or rarer",
    )
    period_s: float = Field(10.0, ge=0.2, le=600.0, description="from jump to jump, s")
    period_min_s: float = Field(1.5, ge=0.2, le=600.0, description="adaptive: shortest period, s")
    height_um: float = Field(60.0, ge=5.0, le=400.0, description="retraction, µm")
    speed_um_s: float = Field(2000.0, ge=50.0, le=5000.0, description="up and down, µm/s")
    dwell_ms: float = Field(20.0, ge=0.0, le=5000.0, description="pause at the top, ms")

    @property
    def dwell_s(self) -> float:
        """Pause at the top, s."""
        return 1e-3 * self.dwell_ms


class Adaptive(Table):
    """How the supervisor answers arcs and shorts where `jump.mode` is "adaptive".

    The jump period comes first, then the servo reference, then the off-time. With `seek_reference` the reference
    begins where pulses and materials let expect the most removal, whatever `[servo]` says, and follows the arcs.
    """

    arc_high: float = Field(0.05, gt=0.0, le=1.0, description="share of arcs that halves the jump period")
    short_high: float = Field(0.03, gt=0.0, le=1.0, description="share of shorts that does")
    arc_low: float = Field(0.02, gt=0.0, le=1.0, description="below this the period grows again")
    short_low: float = Field(0.005, gt=0.0, le=1.0, description="together with this share of shorts")
    reference_step: float = Field(0.02, ge=0.0, le=0.1, description="raise of the servo reference at a time")
    reference_max: float = Field(0.90, gt=0.0, lt=1.0, description="highest servo reference")
    duty_step: float = Field(
        0.20, ge=0.0, lt=1.0, description="share of the duty that is taken off at a time"
    )
    duty_min: float = Field(0.10, ge=0.05, le=0.6, description="lowest duty")
    seek_reference: bool = Field(
        False, description="find the servo reference of the most removal during the cut, in any `jump.mode`"
    )
    arc_target: float | None = Field(
        None,
        gt=0.0,
        le=0.5,
        description="share of arcs that is kept then; where removal is expected to be the most, when not given",
    )


class Measure(Table):
    """How Z is touched. One slow speed serves Z1, Z2 and Z3, so that creep enters all three alike."""

    speed_um_s: float = Field(1.0, ge=0.1, le=5.0, description="speed at contact, µm/s")
    fast_um_s: float = Field(20.0, ge=1.0, le=200.0, description="speed up to near contact, µm/s")
    touches: int = Field(3, ge=1, le=20, description="touches per Z")
    settle_s: float = Field(1.0, ge=0.0, le=60.0, description="rest before touching, s")
    max_sd_um: float = Field(0.5, gt=0.0, le=10.0, description="scatter of touches that is accepted, µm")
    site_dx_um: float = Field(500.0, ge=0.0, le=50_000.0, description="from the hole to the pad, µm")
    back_off_um: float = Field(3.0, ge=1.0, le=50.0, description="retraction between touches, µm")
    dwell_s: float = Field(0.3, ge=0.05, le=10.0, description="hunting at contact, s")
    expected_gap_um: float = Field(
        0.0,
        ge=0.5,
        le=20.0,
        description="working gap assumed until the first cut was measured, µm; by the pulses when not given",
    )


class Limits(Table):
    """Where a job stops."""

    stroke_v_max: float = Field(120.0, ge=10.0, le=150.0, description="largest actuator command, V")
    max_time_s: float = Field(
        0.0, gt=0.0, le=1e6, description="longest job, s; three times the forecast when not given"
    )
    arc_ratio: float = Field(0.15, gt=0.0, le=1.0, description="share of arcs that stops the job")
    short_ratio: float = Field(0.5, gt=0.0, le=1.0, description="share of shorts that stops the job")
    open_lost_um: float = Field(15.0, ge=1.0, le=500.0, description="advance without sparks that stops, µm")


class Flush(Table):
    """The dielectric."""

    required: bool = True
    min_flow_lpm: float = Field(0.5, ge=0.0, le=100.0, description="least flow, L/min")
    max_temp_c: float = Field(30.0, ge=0.0, le=60.0, description="warmest dielectric, °C")


class Log(Table):
    """What the run file holds."""

    servo_hz: float = Field(100.0, ge=1.0, le=1000.0, description="samples of voltage and displacement, Hz")
    pulses: Literal["blocks", "full", "off"] = Field(
        "blocks", description="counts per block of pulses, every pulse, or neither"
    )


class Regime(Table):
    """Pulses for a share of the depth, from roughing to finishing; what is not given is that of the profile."""

    name: str = Field(min_length=1, max_length=40, pattern=ONE_LINE, description="what messages call it")
    share: float = Field(gt=0.0, lt=1.0, description="of the depth; all shares together are 1")
    current_a: float | None = Field(None, ge=0.01, le=3.0, description="peak current, A")
    frequency_hz: float | None = Field(None, ge=100.0, le=50_000.0, description="pulses per second, Hz")
    duty: float | None = Field(None, ge=0.05, le=0.85, description="on-time over period")
    reference: float | None = Field(
        None, gt=0.0, lt=1.0, description="of the servo: mean gap voltage over its open value"
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
    sites: list[SiteTable] = Field(
        [], description="places to machine; one beside the reference pad when there are none"
    )
    regimes: list[Regime] = Field([], description="roughing to finishing, in this order, for one blind hole")
    array: Array = Array()
    path: PathTable | None = Field(None, description="a channel instead of holes")
    measure: Measure = Measure()
    limits: Limits = Limits()
    flush: Flush = Flush()
    log: Log = Log()
