"""A profile file: the recipe and the `[sim]` table of the virtual machine, with a JSON schema for editors."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from edmctl.profile.model import Profile
from edmctl.profile.tables import Table

CONTROLLER_SYNONYMS = {"python": "firmware"}
"""Names in profiles and run files of former versions."""


def _present_name(controller: object) -> object:
    return CONTROLLER_SYNONYMS.get(controller, controller) if isinstance(controller, str) else controller


class SimSettings(Table):
    """Constants of the simulated discharge process.

    The generator's series resistance is not among them: current and voltages of `[pulse]` fix it. Orders of
    magnitude after Muralidhara et al. 2009; the rest is fitted so that its holes come out.
    """

    work_removal: float | None = Field(
        None,
        gt=0.0,
        le=100.0,
        description="removal of the work over that of copper; else by its material",
    )
    tool_wear: float | None = Field(
        None,
        ge=0.0,
        le=100.0,
        description="wear of the tool over that of copper; else by its material",
    )
    controller: Annotated[
        Literal["firmware", "firmware-float", "stm32"],
        BeforeValidator(_present_name),
    ] = Field(
        "firmware",
        description="what drives it: the firmware's core, that in a board's arithmetic, or the image of a board",
    )
    spread: float = Field(
        0.03, ge=0.0, le=0.5, description="relative sd by which every machine differs from the figures below"
    )
    sensor_gain_sd: float | None = Field(
        None,
        ge=0.0,
        le=0.2,
        description="sd of the draw of the sensor's gain, relative; else by the setup",
    )
    sensor_drift_sd_um_s: float | None = Field(
        None,
        ge=0.0,
        le=1.0,
        description="sd of the draw of its steady drift, µm/s; else by the setup",
    )
    machine_drift_sd_um_s: float = Field(
        0.0, ge=0.0, le=1.0, description="the same of the work against the tool, which no sensor sees, µm/s"
    )
    tilt_sd_mrad: float | None = Field(
        None,
        ge=0.0,
        le=50.0,
        description="sd of the draw of the slope of the work, along x and y, mrad; else by the setup",
    )
    discharge_v: float = Field(22.0, gt=0.0, le=100.0, description="plateau of a normal discharge, V")
    arc_v: float = Field(17.0, gt=0.0, le=100.0, description="plateau of an arc, V")
    short_v: float = Field(1.0, ge=0.0, le=20.0, description="gap voltage of a short, V")
    scatter: float = Field(0.3, ge=0.0, le=2.0, description="log-normal spread of a crater's volume")
    gap_reference_um: float = Field(2.5, gt=0.0, le=50.0, description="gap that ignites as below at 40 V, µm")
    tau_reference_us: float = Field(60.0, gt=0.0, le=1e5, description="its mean statistical delay, µs")
    gap_exponent: float = Field(4.0, ge=1.0, le=12.0, description="delay against gap, a power")
    formative_us: float = Field(1.0, ge=0.0, le=100.0, description="least ignition delay, µs")
    roughness_um: float = Field(0.20, ge=0.0, le=5.0, description="surface peaks at a pulse of 344 µJ, µm")
    debris_gap_factor: float = Field(1.5, ge=0.0, le=10.0, description="narrowing per debris fraction")
    flush_time_s: float = Field(0.5, gt=0.0, le=1000.0, description="debris clearance at Ø270 µm, s")
    flush_depth_ratio: float = Field(1.1, gt=0.0, le=100.0, description="depth/diameter that doubles it")
    redeposition: float = Field(0.19, gt=0.0, le=100.0, description="debris fraction that halves removal")
    arc_base: float = Field(0.01, ge=0.0, le=1.0, description="arc probability without debris")
    arc_debris: float = Field(0.16, gt=0.0, le=100.0, description="debris fraction at which sparks arc")
    arc_delay_us: float = Field(20.0, gt=0.0, le=1e4, description="ignition delay that fades this, µs")
    arc_pause_us: float = Field(800.0, gt=0.0, le=1e6, description="off-time that halves this, µs")
    arc_work: float = Field(0.15, ge=0.0, le=10.0, description="work removed by an arc over a discharge")
    arc_tool: float = Field(0.9, ge=0.0, le=10.0, description="tool removed by an arc over a discharge")
    bridge_clear: float = Field(0.02, gt=0.0, le=1.0, description="chance per pulse that a bridge burns off")
    side_base: float = Field(0.03, ge=0.0, le=1.0, description="share of discharges at the wall")
    side_debris: float = Field(0.6, ge=0.0, le=10.0, description="more of them per debris fraction")
    removal_um3_per_uj: float = Field(
        0.0811, gt=0.0, le=10.0, description="work removed per energy at best, µm³/µJ"
    )
    tool_share: float = Field(0.827, ge=0.0, le=10.0, description="tool removed per work, at equal shares")
    peak_us: float = Field(40.0, gt=0.0, le=1e4, description="burning time of the most removal at 0.12 A, µs")
    peak_exponent: float = Field(0.75, gt=0.0, le=4.0, description="sharpness of that optimum")
    peak_per_current: float = Field(0.3, ge=0.0, le=2.0, description="its growth with current, a power")
    threshold_uj: float = Field(1.0, ge=0.0, le=1000.0, description="energy that removes nothing, µJ")
    cathode_least: float = Field(0.15, ge=0.0, le=10.0, description="erosion of cathode over anode, shortest")
    cathode_us: float = Field(568.0, gt=0.0, le=1e5, description="burning time that adds as much, µs")
    cathode_exponent: float = Field(0.8, gt=0.0, le=4.0, description="of that growth")
    carbon_us: float = Field(60.0, gt=0.0, le=1e5, description="burning time that halves positive wear, µs")
    carbon_per_current: float = Field(-0.3, ge=-2.0, le=2.0, description="its change with current, a power")
    deionisation_us: float = Field(15.0, ge=0.0, le=1e4, description="decay of a channel at 344 µJ, µs")
    deionisation_exponent: float = Field(0.3, ge=0.0, le=2.0, description="its growth with energy, a power")
    deionisation_debris: float = Field(4.0, ge=0.0, le=100.0, description="its growth per debris fraction")
    deionisation_after_arc: float = Field(1.5, ge=1.0, le=10.0, description="its growth after an arc")
    bridge_base: float = Field(0.2, ge=0.0, le=1.0, description="bridging across half a particle, full gap")
    particle_um: float = Field(0.9, gt=0.0, le=50.0, description="particles of a pulse of 344 µJ, µm")
    side_per_voltage_um: float = Field(4.0, ge=0.0, le=100.0, description="gap at the wall by 40 V, µm")
    side_per_energy_um: float = Field(4.0, ge=0.0, le=100.0, description="and by a pulse of 344 µJ, µm")
    tip_rounding_um: float = Field(
        0.0,
        ge=0.0,
        le=100.0,
        description="rounding of the tool's rim: how far its edge lies behind its tip, µm",
    )


class ProfileFile(Profile):
    """A profile file as written: the recipe and the `[sim]` table."""

    sim: SimSettings = SimSettings()


def profile_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a profile file. One that extends another may leave any key to that."""
    schema = ProfileFile.model_json_schema(by_alias=True)
    required = {"required": schema.pop("required"), "properties": _required_keys(schema)}
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "profile whose values hold where this one states none, relative to this file, or shipped",
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "edmctl machining profile",
        "if": {"not": {"required": ["extends"]}},
        "then": required,
    }


def _required_keys(schema: dict[str, Any]) -> dict[str, Any]:
    """Move the required keys out of the tables' definitions: for each table, what it must hold.

    Items of a list keep theirs, because a list is inherited whole or not at all.
    """
    found = {}
    for table, description in schema["properties"].items():
        kinds = description.get("oneOf", description.get("anyOf", [description]))
        names = [kind["$ref"].rpartition("/")[2] for kind in kinds if "$ref" in kind]
        if names:
            required = [schema["$defs"][name].pop("required", []) for name in names]
            found[table] = {"anyOf": [{"required": keys} for keys in required]}
    return found
