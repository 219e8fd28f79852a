"""The tables of a run's page: wanted, found, touched, pulses, and where it all comes from."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

from edmctl.dataclasses import astuple
from edmctl.labels import basis_of, heading, is_doubtful, marked, meanings
from edmctl.report.html import PageTable
from edmctl.report.numbers import CLASSES, RunNumbers, numbers_of
from edmctl.results.run_file import RecordedSite
from edmctl.wording import (
    BEYOND_EXIT,
    UNKNOWN,
    count,
    decimal,
    duration,
    facts,
    percent,
    plural,
    significant,
    with_u95,
)

if TYPE_CHECKING:
    from edmctl.record.reader import RunFile

U95_NOTE = "± is half the 95 % interval of a result; lengths in µm."
FEED_NOTE = "Feed is depth and wear together; its ± is at most the sum of theirs."
TRUTH = "truth (simulated)"

_PRETTY = {"um": "µm", "um/s": "µm/s", "um3/uJ": "µm³/µJ", "us": "µs", "degC": "°C", "mm3/min": "mm³/min"}


def results(numbers: RunNumbers) -> PageTable | None:
    """What was found, a row for each quantity of one hole, or a row for each of several."""
    if not numbers.sites:
        return None
    if len(numbers.sites) == 1:
        return _one_site(numbers.sites[0])
    has_truth = any(site.truth.is_known for site in numbers.sites)
    header = ["site", "x", "y", "depth", "tool wear", "feed", "machining", "cuts", "wear ratio"]
    header += ["true depth (simulated)", "true wear (simulated)"] if has_truth else []
    rows = [
        [
            site.name,
            decimal(site.x_um, 1),
            decimal(site.y_um, 1),
            "through" if site.through else _marked(site, "depth", with_u95(site.depth_um, site.depth_u95_um)),
            _marked(site, "wear", with_u95(site.wear_um, site.wear_u95_um)),
            _marked(site, "feed", with_u95(site.feed_um, site.feed_u95_um)),
            f"{duration(site.machining_time_s)}{', through' if site.through else ''}",
            str(site.cuts),
            _marked(site, "wear_ratio", decimal(site.wear_ratio_lin, 3)),
            *([decimal(site.truth.depth_um), decimal(site.truth.wear_um)] if has_truth else []),
        ]
        for site in numbers.sites
    ]
    per = "the thickness of the sheet" if all(site.through for site in numbers.sites) else "depth"
    marks = meanings({basis for site in numbers.sites for basis in (site.depth_basis, site.wear_basis)})
    note = " ".join([U95_NOTE, FEED_NOTE, f"Wear ratio is wear over {per}.", *marks])
    if any(is_doubtful(site.verdict) for site in numbers.sites):
        header.append("verdict")
        rows = [[*row, site.verdict or ""] for row, site in zip(rows, numbers.sites, strict=True)]
    return PageTable("What each site has become", header, rows, note)


def _marked(site: RecordedSite, name: str, text: str, head: str = "result") -> str:
    return marked(text, basis_of(name, site.depth_basis, site.wear_basis), head)


def _one_site(site: RecordedSite) -> PageTable:
    truth = site.truth if site.truth.is_known else None
    bases = (site.depth_basis, site.wear_basis)
    head = heading(bases)
    header = [site.name, head, "from voltage alone", *([TRUTH] if truth else [])]
    depth_um = (
        with_u95(site.beyond_exit_um, site.beyond_exit_u95_um)
        if site.through
        else with_u95(site.depth_um, site.depth_u95_um)
    )

    def row(name: str, measured: str, model: str = "", true: float = math.nan) -> list[str]:
        ending = [decimal(true) if math.isfinite(true) else ""] if truth else []
        return [name, measured, model, *ending]

    cuts = f"{duration(site.machining_time_s)} in {plural(site.cuts, 'cut')}"
    rows = [
        row(
            BEYOND_EXIT if site.through else "depth, Z2 − Z3",
            _marked(site, "depth", depth_um, head),
            with_u95(site.depth_model_um, site.depth_model_u95_um),
            site.truth.depth_um,
        ),
        row(
            "tool wear, Z3 − Z1",
            _marked(site, "wear", with_u95(site.wear_um, site.wear_u95_um), head),
            with_u95(site.wear_model_um, site.wear_model_u95_um),
            site.truth.wear_um,
        ),
        *([row("hole, as long as the sheet is thick", decimal(site.length_um))] if site.through else []),
        row(
            "feed, Z2 − Z1",
            _marked(site, "feed", with_u95(site.feed_um, site.feed_u95_um), head),
            "",
            truth.feed_um if truth else math.nan,
        ),
        row("Z1, surface before", decimal(site.z1_um)),
        row("Z2, tip at the end" if site.through else "Z2, bottom", decimal(site.z2_um)),
        row("Z3, surface after", decimal(site.z3_um)),
        row("machining time", f"{cuts}, through the sheet" if site.through else cuts),
        row(
            "removal rate (MRR), 10⁻³ mm³/min",
            _marked(site, "mrr", decimal(1e3 * site.mrr_mm3_min, 3), head),
        ),
        row("wear ratio, lengths", _marked(site, "wear_ratio", decimal(site.wear_ratio_lin, 3), head)),
        row("wear ratio, volumes", _marked(site, "wear_ratio", decimal(site.wear_ratio_vol, 3), head)),
        row("discharge energy, J", significant(site.energy_j)),
        row("side gap", "", "", site.truth.side_gap_um),
        row("taper, wider at the mouth", "", "", site.truth.taper_um),
        row("roughness Ra", "", "", site.truth.ra_um),
        row("roughness Rz", "", "", site.truth.rz_um),
        row("radius of the corner", "", "", site.truth.corner_um),
        row("verdict", (is_doubtful(site.verdict) and site.verdict) or ""),
    ]
    shown = [row for row in rows if {*row[1:]} - {"", UNKNOWN}]
    notes = [U95_NOTE, FEED_NOTE if math.isfinite(site.feed_um) else "", *meanings(bases, head)]
    return PageTable("Results", header, shown, " ".join(filter(None, notes)))


def pulses(numbers: RunNumbers) -> PageTable | None:
    """How many pulses of which class, for each site and altogether."""
    totals = numbers.totals
    if not totals.pulses:
        return None
    rows = [
        [site.name, count(site.pulses), *(percent(share, 2) for share in astuple(site.ratios))]
        for site in numbers.sites
    ]
    if len(rows) > 1:
        whole = [percent(getattr(totals.ratios, name), 2) for name in CLASSES]
        rows.append(["all", count(totals.pulses), *whole])
    return PageTable("Pulses while machining", ["site", "pulses", *CLASSES], rows)


def touches(run: RunFile) -> PageTable | None:
    """Every reading of surface and bottom."""
    found = run.table("/entry/touches")
    if not len(found):
        return None
    rows = [
        [
            f"{row['kind'].decode(errors='ignore')} {row['site'].decode(errors='ignore')}",
            duration(float(row["time"])),
            decimal(float(row["z_sensor"])),
            decimal(float(row["z_model"])),
            decimal(float(row["v_cmd"])),
            str(int(row["n"])),
            decimal(float(row["sd"])),
            decimal(float(row["drift"])),
            "yes" if row["accepted"] else "no",
        ]
        for row in found
    ]
    header = ["reading", "at", "sensor", "from voltage", "actuator V", "touches", "sd", "drift", "used"]
    note = "Z1 is the surface before, Z2 the bottom, Z3 the surface after, Zr the face at a place not yet machined. "
    return PageTable(
        "Readings by touching", header, rows, f"{note}Lengths in µm; sd is that of a single touch."
    )


def found(run: RunFile) -> PageTable | None:
    """What a run without sites found, for instance an approach: its result as it stands."""
    rows = [list(fact) for fact in facts(run.summary() or {})]
    return PageTable("What it found", ["quantity", "value"], rows, words=True) if rows else None


def profile_values(run: RunFile) -> PageTable | None:
    """Every value of the profile in effect; those of the simulator only where it ran."""
    values = run.profile_values()
    simulated = run.is_simulated
    rows = [
        [key, str(value), _PRETTY.get(unit, unit) if (unit := str(values.get(f"{key}_units", ""))) else ""]
        for key, value in values.items()
        if key != "NX_class" and not key.endswith("_units") and (simulated or not key.startswith("sim."))
    ]
    return PageTable("Every value in effect", ["key", "value", "unit"], rows, words=True) if rows else None


def overrides(run: RunFile) -> PageTable | None:
    """What was changed against the profile's own text, for this run."""
    lines = run.text("/entry/profile/overrides").splitlines()
    rows = [line.partition(" = ")[::2] for line in lines if line.endswith("--set)")]
    return PageTable("Changed for this run", ["key", "value"], rows, words=True) if rows else None


def provenance(run: RunFile) -> PageTable:
    """Machine, calibration, versions and seed: what it takes to judge or repeat the run."""
    seed = "" if run.seed is None else f", seed {run.seed}"
    command = run.text("/entry/command")
    rows = [
        ("machine", run.text("/entry/machine/serial")),
        (
            "firmware, protocol",
            f"{run.text('/entry/machine/firmware')}, {run.text('/entry/machine/protocol')}",
        ),
        ("simulated", f"yes{seed}" if run.is_simulated else "no"),
        ("actuator model", run.text("/entry/machine/calibration")),
        (
            "work",
            f"{run.text('/entry/sample/material')}, {_length(run.number('/entry/sample/thickness'))} thick",
        ),
        ("tool", f"{run.text('/entry/tool/material')}, {_length(run.number('/entry/tool/diameter'))} wide"),
        ("edmctl", run.text("/entry/software/version")),
        (
            "Python, h5py, HDF5",
            ", ".join(run.text(f"/entry/software/{n}") for n in ("python", "h5py", "hdf5")),
        ),
        ("procedure", run.text("/entry/procedure")),
        ("started", run.text("/entry/start_time")),
        ("ended", run.text("/entry/end_time")),
        ("by", f"{run.text('/entry/user/name')} on {run.text('/entry/machine/host')}"),
        ("recipe (SHA-256)", run.text("/entry/profile/recipe_sha256")),
        ("goes on with", run.text("/entry/parent_run")),
        ("recovered", run.text("/entry/recovery")),
        ("command", " ".join(json.loads(command)) if command else ""),
    ]
    return PageTable("", ["", ""], [row for row in rows if row[1].strip(", ")], words=True)


def _length(um: float) -> str:
    return f"{um:g} µm" if math.isfinite(um) else "unknown"


def all_numbers(run: RunFile) -> list[PageTable]:
    """The tables of what was found, in the order of the page."""
    numbers = numbers_of(run)
    tables = [results(numbers) or found(run), touches(run), pulses(numbers)]
    return [table for table in tables if table]
