"""One page about a run: HTML that needs nothing but itself, no script and no network."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from functools import partial
from html import escape

from edmctl.dataclasses import astuple
from edmctl.labels import basis_of, heading, is_doubtful, marked, meanings
from edmctl.record.reader import RunFile, estimated_depth, sites_of
from edmctl.report import html
from edmctl.report.html import PageTable, Picture
from edmctl.report.kinds import KINDS, draw
from edmctl.report.removal import target_depths_um
from edmctl.results.job import length_text
from edmctl.results.run_file import RecordedSite, Sentence, Sites
from edmctl.results.telemetry import PULSE_CLASSES
from edmctl.wording import (
    BEYOND_EXIT,
    UNKNOWN,
    about,
    count,
    decimal,
    duration,
    facts,
    percent,
    plain_number,
    plural,
    removal_rate,
    significant,
    with_u95,
)

NARROW = "\u202f"
"""A narrow space that a line does not break."""
_CONTENTS = (
    ("target", "Target"),
    ("numbers", "Numbers"),
    ("figures", "Figures"),
    ("story", "What happened"),
    ("source", "Machine and versions"),
)
U95_NOTE = "± is half the 95 % interval of a result; lengths in µm."
FEED_NOTE = "Feed is depth and wear together; its ± is at most the sum of theirs."
_PRETTY = {"um": "µm", "um/s": "µm/s", "um3/uJ": "µm³/µJ", "us": "µs", "degC": "°C", "mm3/min": "mm³/min"}


def pictures_of(run: RunFile) -> list[Picture]:
    """Draw every kind of figure, or give the reason why the run has nothing for it."""
    pictures = []
    for kind in KINDS:
        sources = tuple(f"/entry/{name}" for name in kind.datasets)
        pictures.append(html.picture_of(kind.name, kind.title, kind.sees, partial(draw, kind, run), sources))
    return pictures


def render_page(
    run: RunFile, pictures: Sequence[Picture], sentences: Sequence[Sentence], trouble: str = ""
) -> str:
    """Return the page of an open run file.

    sentences : in order of time; the first states the target, the last the end of the run
    trouble : what ended a run that is not done, and the remedy; empty if unknown
    """
    run_id, status, sites = run.text("/entry/run_id"), run.text("/entry/status"), sites_of(run)
    title = run.text("/entry/title") or run_id
    history = [(duration(sentence.time_s), sentence.text) for sentence in sentences[1:]]
    every = _profile_values(run)
    target: list[PageTable | str] = [html.paragraph(sentence.text) for sentence in sentences[:1]]
    changed = [line.partition(" = ")[::2] for line in run.text("/entry/profile/overrides").splitlines()]
    overrides = [row for row in changed if row[1].endswith("--set)")]
    target.append(PageTable("Changed for this run", ["key", "value"], overrides, words=True))
    target += [html.folded(every.caption, html.table(every))] if every.rows else []
    numbers: list[PageTable | str] = [
        html.tiles(_key_numbers(run, sites)),
        _results(run, sites),
        _touches(run),
        _pulses(sites),
    ]
    story = PageTable("", ("at", ""), history, words=True)
    # All is read before the first figure is rendered.
    others: list[list[PageTable | str]] = [[story], [_provenance(run)]]
    sections: list[Sequence[PageTable | str]] = [target, numbers, html.figures(pictures), *others]
    body = [html.section(*names, parts) for names, parts in zip(_CONTENTS, sections, strict=True)]
    time_s = plain_number((run.summary() or {}).get("time_s"))
    took = f" · {duration(time_s)}" if math.isfinite(time_s) else ""
    began = run.text("/entry/start_time")[:16].replace("T", " ")
    badge = f"{status or UNKNOWN}{' · simulated' if run.is_simulated else ''}"
    header = [
        f"<h1>{escape(title)}</h1>",
        html.paragraph(f"{run_id} · {began}{took}", "sub"),
        f'<p><span class="status {"done" if status == "done" else "other"}">{escape(badge)}</span></p>',
    ]
    if status != "done":
        header.append(html.paragraph(trouble or (sentences[-1].text if sentences else ""), "trouble"))
    footer = f"From {run.path.name} alone. ± is half the 95 % interval."
    return html.document(f"{title}, {run_id}", header, _CONTENTS, body, footer)


def _key_numbers(run: RunFile, sites: Sites) -> Iterator[tuple[str, str, str]]:
    totals, estimated = sites.totals, estimated_depth(run)
    if math.isfinite(estimated.depth_um):
        depth = about(estimated.depth_um, estimated.depth_u95_um)
        yield "depth so far", depth, "of what was left without a result"
    if not sites:
        return
    target = target_depths_um(run.profile_values())
    several = len(sites) > 1
    of_many = f"mean of {len(sites)} sites" if several else ""
    of_target = f"target {target[0]:g} ± {target[1]:g} µm" if target and not several else of_many
    shown = [("depth", "depth", of_target), ("tool wear", "wear", of_many)]
    through = all(site.through for site in sites)
    if through:
        yield "depth", "through", f"the sheet of {sites[0].length_um:g} µm"
        del shown[0]
    for called, name, of_what in shown:
        text = with_u95(sites.mean(f"{name}_um"), sites.mean(f"{name}_u95_um"))
        yield called, f"{marked(text, sites.basis(name))} µm", of_what
    depths_um = [site.depth_um for site in sites if math.isfinite(site.depth_um)]
    if several and depths_um:
        ends = f"{decimal(min(depths_um))} to {decimal(max(depths_um))} µm"
        yield "depth, range", ends, "the least and the greatest"
    yield "machining", duration(sites.total("machining_time_s")), "with the servo on"
    rate = marked(removal_rate(totals.mrr_mm3_min), sites.basis("mrr"))
    yield "removal rate", rate, "volume over machining time"
    per = "the sheet's thickness" if through else "depth"
    ratio = marked(decimal(totals.wear_ratio_lin, 3), sites.basis("wear_ratio"))
    yield "wear ratio", ratio, f"wear over {per}"
    yield "arcs", percent(totals.ratios.arc, 2), f"of {count(totals.pulses, NARROW)} pulses"


def _results(run: RunFile, sites: Sites) -> PageTable:
    """Return a row for each quantity of one hole, or for each of several holes; without holes, the summary."""
    if not sites:
        rows = list(facts(run.summary() or {}))
        return PageTable("Results", ["quantity", "value"], rows, words=True)
    return _one_site(sites[0]) if len(sites) == 1 else _many_sites(sites)


def _many_sites(sites: Sites) -> PageTable:
    columns: dict[str, list[str]] = {
        "site": [site.name for site in sites],
        "x": [decimal(site.x_um, 1) for site in sites],
        "y": [decimal(site.y_um, 1) for site in sites],
        "depth": ["through" if site.through else length_text(site, "depth") for site in sites],
        "tool wear": [length_text(site, "wear") for site in sites],
        "feed": [length_text(site, "feed") for site in sites],
        "machining": [_machining(site, duration(site.machining_time_s)) for site in sites],
        "cuts": [str(site.cuts) for site in sites],
        "wear ratio": [_marked(site, "wear_ratio", decimal(site.wear_ratio_lin, 3)) for site in sites],
    }
    if any(site.truth.is_known for site in sites):
        columns["true depth (simulated)"] = [decimal(site.truth.depth_um) for site in sites]
        columns["true wear (simulated)"] = [decimal(site.truth.wear_um) for site in sites]
    if any(is_doubtful(site.verdict) for site in sites):
        columns["verdict"] = [site.verdict or "" for site in sites]
    per = "the thickness of the sheet" if all(site.through for site in sites) else "depth"
    marks = meanings({basis for site in sites for basis in (site.depth_basis, site.wear_basis)})
    note = " ".join([U95_NOTE, FEED_NOTE, f"Wear ratio is wear over {per}.", *marks])
    rows = list(zip(*columns.values(), strict=True))
    return PageTable("Results", list(columns), rows, note)


def _marked(site: RecordedSite, name: str, text: str, head: str = "result") -> str:
    return marked(text, basis_of(name, site.depth_basis, site.wear_basis), head)


def _machining(site: RecordedSite, text: str) -> str:
    return f"{text}, through the sheet" if site.through else text


def _one_site(site: RecordedSite) -> PageTable:
    truth, bases, through = site.truth, (site.depth_basis, site.wear_basis), site.through
    head = heading(bases)
    depth, wear, feed = (length_text(site, name, head=head) for name in ("depth", "wear", "feed"))
    if through:
        depth = _marked(site, "depth", with_u95(site.beyond_exit_um, site.beyond_exit_u95_um), head)
    by_voltage = [
        with_u95(getattr(site, f"{name}_model_um"), getattr(site, f"{name}_model_u95_um"))
        for name in ("depth", "wear")
    ]
    true_feed_um = truth.feed_um if truth.is_known else math.nan
    cuts = f"{duration(site.machining_time_s)} in {plural(site.cuts, 'cut')}"
    measured = {
        "hole, as long as the sheet is thick": decimal(site.length_um) if through else "",
        "Z1, surface before": decimal(site.z1_um),
        "Z2, tip at the end" if through else "Z2, bottom": decimal(site.z2_um),
        "Z3, surface after": decimal(site.z3_um),
        "machining time": _machining(site, cuts),
        "removal rate (MRR), 10⁻³ mm³/min": _marked(site, "mrr", decimal(1e3 * site.mrr_mm3_min, 3), head),
        "wear ratio, lengths": _marked(site, "wear_ratio", decimal(site.wear_ratio_lin, 3), head),
        "wear ratio, volumes": _marked(site, "wear_ratio", decimal(site.wear_ratio_vol, 3), head),
        "discharge energy, J": significant(site.energy_j),
    }
    true_um = {
        "side gap": truth.side_gap_um,
        "taper, wider at the mouth": truth.taper_um,
        "roughness Ra": truth.ra_um,
        "roughness Rz": truth.rz_um,
        "radius of the corner": truth.corner_um,
    }
    rows = [
        (BEYOND_EXIT if through else "depth, Z2 − Z3", depth, by_voltage[0], truth.depth_um),
        ("tool wear, Z3 − Z1", wear, by_voltage[1], truth.wear_um),
        ("feed, Z2 − Z1", feed, "", true_feed_um),
        *((name, text, "", math.nan) for name, text in measured.items()),
        *((name, "", "", value_um) for name, value_um in true_um.items()),
        ("verdict", site.verdict or "" if is_doubtful(site.verdict) else "", "", math.nan),
    ]
    header, width = [site.name, head, "from voltage alone", "truth (simulated)"], 4 if truth.is_known else 3
    cells = [[*texts, decimal(true) if math.isfinite(true) else ""][:width] for *texts, true in rows]
    shown = [row for row in cells if {*row[1:]} - {"", UNKNOWN}]
    notes = [U95_NOTE, FEED_NOTE if math.isfinite(site.feed_um) else "", *meanings(bases, head)]
    return PageTable("Results", header[:width], shown, " ".join(filter(None, notes)))


def _pulses(sites: Sites) -> PageTable:
    """Return the pulses by class, for each site and in total."""
    totals = sites.totals
    counted = [(site.name, site.pulses, site.ratios) for site in sites if totals.pulses]
    if len(counted) > 1:
        counted.append(("all", totals.pulses, totals.ratios))
    rows = [
        [name, count(number), *(percent(share, 2) for share in astuple(ratios))]
        for name, number, ratios in counted
    ]
    return PageTable("Pulses while machining", ["site", "pulses", *PULSE_CLASSES], rows)


def _touches(run: RunFile) -> PageTable:
    """Return every reading of surface and bottom."""
    numbers = ("z_sensor", "z_model", "v_cmd", "n", "sd", "drift")
    rows = [
        [
            " ".join(row[name].decode(errors="ignore") for name in ("kind", "site")),
            duration(float(row["time"])),
            *(str(int(row[name])) if name == "n" else decimal(float(row[name])) for name in numbers),
            "yes" if row["accepted"] else "no",
        ]
        for row in run.table("/entry/touches")
    ]
    header = ["reading", "at", "sensor", "from voltage", "actuator V", "touches", "sd", "drift", "used"]
    note = (
        "Z1 is the surface before, Z2 the bottom, Z3 the surface after, Zr the face at a place not yet machined. "
        "Lengths in µm; sd is that of a single touch."
    )
    return PageTable("Readings by touching", header, rows, note)


def _profile_values(run: RunFile) -> PageTable:
    """Return every value of the profile in effect, with those of the simulator if it ran."""
    values = run.profile_values()
    simulated = run.is_simulated
    rows = [
        [key, str(value), _PRETTY.get(unit, unit) if (unit := str(values.get(f"{key}_units", ""))) else ""]
        for key, value in values.items()
        if not key.endswith("_units") and (simulated or not key.startswith("sim."))
    ]
    return PageTable("Every value in effect", ["key", "value", "unit"], rows, words=True)


def _provenance(run: RunFile) -> PageTable:
    """Return machine, calibration, versions and seed: the data to evaluate or repeat the run."""
    seed = "" if run.seed is None else f", seed {run.seed}"
    command = run.text("/entry/command")

    def texts(folder: str, *names: str) -> str:
        return ", ".join(run.text(f"/entry/{folder}/{name}") for name in names)

    rows = [
        ("machine", texts("machine", "serial")),
        ("firmware, protocol", texts("machine", "firmware", "protocol")),
        ("simulated", f"yes{seed}" if run.is_simulated else "no"),
        ("actuator model", texts("machine", "calibration")),
        ("work", f"{texts('sample', 'material')}, {_length(run.number('/entry/sample/thickness'))} thick"),
        ("tool", f"{texts('tool', 'material')}, {_length(run.number('/entry/tool/diameter'))} wide"),
        ("edmctl", texts("software", "version")),
        ("Python, h5py, HDF5", texts("software", "python", "h5py", "hdf5")),
        ("procedure", run.text("/entry/procedure")),
        ("started", run.text("/entry/start_time")),
        ("ended", run.text("/entry/end_time")),
        ("by", f"{texts('user', 'name')} on {texts('machine', 'host')}"),
        ("recipe (SHA-256)", texts("profile", "recipe_sha256")),
        ("continues", run.text("/entry/parent_run")),
        ("recovered", run.text("/entry/recovery")),
        ("command", " ".join(json.loads(command)) if command else ""),
    ]
    return PageTable("", ["", ""], [row for row in rows if row[1].strip(", ")], words=True)


def _length(um: float) -> str:
    return f"{um:g} µm" if math.isfinite(um) else "unknown"
