"""A profile file: the recipe and the `[sim]` table of the virtual machine, with a JSON schema for editors."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator

from edmctl.profile.model import Profile
from edmctl.profile.tables import Table, entry

CONTROLLER_SYNONYMS = {"python": "firmware"}  # names in profiles and run files of former versions


def _present_name(controller: object) -> object:
    return CONTROLLER_SYNONYMS.get(controller, controller) if isinstance(controller, str) else controller


class SimSettings(Table):
    """Constants of the simulated discharge process.

    The generator's series resistance is not among them: current and voltages of `[pulse]` fix it. Orders of
    magnitude after Muralidhara et al. 2009; the rest is fitted so that its holes come out.
    """

    work_removal: float | None = entry(
        None, "removal of the work over that of copper; else by its material", gt=0.0, le=100.0
    )
    tool_wear: float | None = entry(
        None, "wear of the tool over that of copper; else by its material", ge=0.0, le=100.0
    )
    controller: Annotated[
        Literal["firmware", "firmware-float", "stm32"],
        BeforeValidator(_present_name),
    ] = entry(
        "firmware",
        "what drives it: the firmware's core, that in a board's arithmetic, or the image of a board",
    )
    spread: float = entry(
        0.03, "relative sd by which every machine differs from the figures below", ge=0.0, le=0.5
    )
    sensor_gain_sd: float | None = entry(
        None, "sd of the draw of the sensor's gain, relative; else by the setup", ge=0.0, le=0.2
    )
    sensor_drift_sd_um_s: float | None = entry(
        None, "sd of the draw of its steady drift, µm/s; else by the setup", ge=0.0, le=1.0
    )
    machine_drift_sd_um_s: float = entry(
        0.0, "the same of the work against the tool, which no sensor sees, µm/s", ge=0.0, le=1.0
    )
    tilt_sd_mrad: float | None = entry(
        None,
        "sd of the draw of the slope of the work, along x and y, mrad; else by the setup",
        ge=0.0,
        le=50.0,
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
    tip_rounding_um: float = entry(
        0.0, "rounding of the tool's rim: how far its edge lies behind its tip, µm", ge=0.0, le=100.0
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
