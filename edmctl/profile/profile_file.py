"""A profile file: the recipe and the `[sim]` table of the virtual machine, with a JSON schema for editors."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from edmctl.profile.model import Profile
from edmctl.profile.tables import Table


class SimSettings(Table):
    """Constants of the simulated discharge process.

    The generator's series resistance is not among them: current and voltages of `[pulse]` fix it. Orders of
    magnitude after Muralidhara et al. 2009; the rest is fitted so that its holes come out.
    """

    theta: float = Field(0.337, ge=0.0, le=10.0, description="tool volume lost per work volume removed")
    discharge_v: float = Field(22.0, gt=0.0, le=100.0, description="plateau of a normal discharge, V")
    arc_v: float = Field(17.0, gt=0.0, le=100.0, description="plateau of an arc, V")
    short_v: float = Field(1.0, ge=0.0, le=20.0, description="gap voltage of a short, V")
    kappa_um3_per_uj: float = Field(0.0424, gt=0.0, le=10.0, description="work removed per energy, µm³/µJ")
    scatter: float = Field(0.3, ge=0.0, le=2.0, description="log-normal spread of a crater's volume")
    gap_reference_um: float = Field(2.5, gt=0.0, le=50.0, description="gap that ignites as below at 40 V, µm")
    tau_reference_us: float = Field(60.0, gt=0.0, le=1e5, description="its mean statistical delay, µs")
    gap_exponent: float = Field(4.0, ge=1.0, le=12.0, description="delay against gap, a power")
    formative_us: float = Field(1.0, ge=0.0, le=100.0, description="least ignition delay, µs")
    roughness_um: float = Field(0.20, ge=0.0, le=5.0, description="surface peaks in the gap, µm")
    debris_gap_factor: float = Field(1.5, ge=0.0, le=10.0, description="narrowing per debris fraction")
    flush_time_s: float = Field(0.5, gt=0.0, le=1000.0, description="debris clearance at Ø270 µm, s")
    flush_depth_ratio: float = Field(0.7, gt=0.0, le=100.0, description="depth/diameter that doubles it")
    arc_base: float = Field(0.01, ge=0.0, le=1.0, description="arc probability without debris")
    arc_debris: float = Field(
        3.0, ge=0.0, le=100.0, description="arc probability per debris fraction squared"
    )
    bridge_base: float = Field(0.02, ge=0.0, le=1.0, description="bridging probability at the debris below")
    bridge_debris: float = Field(0.25, gt=0.0, le=1.0, description="debris fraction of that")
    bridge_gap_um: float = Field(1.5, gt=0.0, le=50.0, description="gap over which bridging fades, µm")
    bridge_clear: float = Field(0.02, gt=0.0, le=1.0, description="chance per pulse that a bridge burns off")
    side_base: float = Field(0.03, ge=0.0, le=1.0, description="share of discharges at the wall")
    side_debris: float = Field(0.6, ge=0.0, le=10.0, description="more of them per debris fraction")
    side_gap_um: float = Field(8.0, gt=0.0, le=100.0, description="gap at the wall, µm")
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
