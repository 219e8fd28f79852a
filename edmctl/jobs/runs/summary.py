"""A run in sentences (objective, steps with reasons, end) and as a summary, from its file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from itertools import groupby, pairwise
from statistics import median
from typing import Any

from edmctl.jobs.runs.opening import command_to_go_on
from edmctl.labels import PAD
from edmctl.link.faults import FAULTS
from edmctl.machine.interface import EventCode
from edmctl.record.layout import NO_EXIT_CODE, TOUCHES
from edmctl.record.reader import RunFile, error_code_of, estimated_depth, recorded_events, sites_of, status_of
from edmctl.record.rows import RunEvent
from edmctl.results.run_file import FileEvent, JumpTimes, RunSummary, Sentence
from edmctl.wording import duration, earlier, ended_as, facts, plain_number, plural, with_u95

Values = dict[str, float | int | str | bool]
LEFT_OUT = frozenset({"READING", "LINK", "STAGE_MOVED", "CONTROLLER_LOG", "JUMP_PERIOD", "APPROACHED"})
"""Single steps that sentences about readings, jumps and cuts summarize."""
OF_A_HOLE = frozenset(
    {
        *("CUT_PLANNED", "CUT_ENDED", "CUT_DECIDED", "CUT_GIVEN_UP", "SITE_MEASURED", "SITE_ESTIMATED"),
        *("TARGET_REACHED", "TARGET_MISSED", "LEFT_UNMEASURED", "BREAKTHROUGH"),
    }
)
"""Events of a hole: in a job with several holes these sentences start with its name."""
TIME_LINE = frozenset(
    {
        *("TOUCHED", "FACE_FITTED", "RESUMED", "CUT_ENDED", "CUT_GIVEN_UP", "BREAKTHROUGH", "PASS_ENDED"),
        *("SITE_MEASURED", "SITE_ESTIMATED", "TARGET_REACHED", "TARGET_MISSED", "VERDICT", "LEFT_UNMEASURED"),
        *("CHANNEL_MEASURED", "WEAR_MEASURED", "SURFACE_FOUND", "JUMP_MEASURED", "ENDED_EARLY"),
    }
)
"""Kinds of sentences in a time line; `run explain` has all."""
ENDS = ("ENDED_EARLY", "TARGET_MISSED", "SITES_LEFT", "SETUP_WRONG", "VERDICT")
"""Kinds of sentences that give the reason for an early end."""
SOFTWARE = {"edmctl": "version", "Python": "python", "h5py": "h5py", "HDF5": "hdf5"}
DEBUG, WARNING_LEVEL = 0, 2


def events_of(opened: RunFile, start: int = 0) -> list[FileEvent]:
    """The events of the file from row `start` on, in the order in which they were written."""
    names = {int(code): code.name for code in (*EventCode, *RunEvent)}
    events = []
    for event in recorded_events(opened, start=start):
        name, args = names.get(event.code, str(event.code)), dict(event.values)
        if name == RunEvent.ENDED_EARLY.name and not args.get("hint"):
            code = str(args.get("code", ""))
            args["hint"] = next((row.hint for row in FAULTS.values() if row.error == code), "")
        events.append(FileEvent(event.time_s, name, event.level, event.message, args))
    return events


def place_of_move(event: FileEvent) -> str:
    """Return the name of the place that a STAGE_MOVED event states."""
    return event.message.removeprefix("At ").rpartition(" (")[0]


def holes_of(events: Sequence[FileEvent]) -> list[str]:
    """Return the hole of each event; empty between holes."""
    holes, hole = [], ""
    for event in events:
        if event.code == "STAGE_MOVED":
            place = place_of_move(event)
            hole = hole if place == PAD else place
        elif event.code == "FACE_FITTED":
            hole = ""
        holes.append(hole)
        if event.code in ("TARGET_REACHED", "TARGET_MISSED"):
            hole = ""
    return holes


def event_sentences(
    events: Sequence[FileEvent], period_s: float, *, names_holes: bool = False
) -> list[Sentence]:
    """Describe the events: jumps by intervals with their reason, hints, all else as recorded.

    period_s : jump period of the recipe
    names_holes : start sentences with the hole's name
    """
    sentences: list[Sentence] = []
    jumps: list[FileEvent] = []
    for event, hole in zip(events, holes_of(events), strict=True):
        if event.code == "JUMPED":
            jumps.append(event)
            continue
        if event.level == DEBUG or event.code in LEFT_OUT:
            continue
        if event.code in ("CUT_ENDED", "ENDED_EARLY") or event.code.endswith("_CHANGED"):
            sentences += _jump_sentences(jumps, period_s)
            jumps.clear()
        name = f"{hole}: " if names_holes and hole and event.code in OF_A_HOLE else ""
        sentences.append(Sentence(event.time_s, f"{name}{event.message}", event.code))
        if hint := _hint(event):
            sentences.append(Sentence(event.time_s, hint, "HINT"))
    sentences += _jump_sentences(jumps, period_s)
    return sorted(sentences, key=lambda sentence: sentence.time_s)


def _hint(event: FileEvent) -> str:
    hint = event.args.get("hint")
    return hint if isinstance(hint, str) else ""


def _jump_sentences(jumps: Sequence[FileEvent], period_s: float) -> list[Sentence]:
    """Describe the jumps of one cut, in order of time, by intervals with and without a shortened period."""

    def is_flushing(jump: FileEvent) -> bool:
        own_s = plain_number(jump.args.get("period_s", period_s))
        return bool(jump.args.get("asked")) or own_s < period_s

    sentences = []
    for flushing, group in groupby(jumps, key=is_flushing):
        part = list(group)
        sentences.append(Sentence(part[0].time_s, _jump_sentence(part, flushing=flushing), "JUMPED"))
    return sentences


def _jump_sentence(jumps: Sequence[FileEvent], *, flushing: bool) -> str:
    """Describe jumps of one interval; shares of arcs and shorts are those since the jump before."""
    most, means, why = dict[str, float](), dict[str, float](), "as its period asks for"
    for name in ("arcs", "shorts"):
        asking = [plain_number(jump.args.get(f"asking_{name}")) for jump in jumps]
        if known := [share for share in asking if math.isfinite(share)]:
            most[name] = max(known)
        mean = sum(plain_number(jump.args.get(name)) for jump in jumps) / len(jumps)
        if mean >= 0.0005:
            means[name] = mean
    if flushing:
        why = f"because {' and '.join(most) or 'arcs or shorts'} asked for more flushing"
        if most:
            why += f": up to {_percent(most)} within a second"
    if means:
        why += f"; {_percent(means)} between jumps" + (" on average" if flushing else "")
    if len(jumps) == 1:
        return f"It jumped once, {why}."
    times_s = [jump.time_s for jump in jumps]
    gaps_s = [after - before for before, after in pairwise(times_s)]
    low, high = f"{min(gaps_s):.2g}", f"{max(gaps_s):.2g}"
    every = f"every {low} s" if low == high else f"every {low}–{high} s"
    span = f"From {duration(times_s[0])} to {duration(times_s[-1])}"
    return f"{span} it jumped {plural(len(jumps), 'time')}, {every}, {why}."


def _percent(shares: Mapping[str, float]) -> str:
    return " and ".join(f"{100.0 * share:.1f} % {name}" for name, share in shares.items())


def sentences_of(opened: RunFile) -> list[Sentence]:
    """Return the sentences of an open run file, from its objective to its end."""
    events, values = events_of(opened), opened.profile_values()
    last_s = max((event.time_s for event in events), default=0.0)
    makes_holes = _objective_of_procedure(opened, values) is None
    several = makes_holes and (len(depths_of_holes(values)) > 1 or _has_file(values))
    period_s = float(values.get("jump.period_s", 0.0))
    sentences = [*touches_of(opened), *event_sentences(events, period_s, names_holes=several)]
    sentences.sort(key=lambda sentence: sentence.time_s)
    found = "; ".join(f"{name} {value}" for name, value in facts(opened.summary() or {}))
    ends = {
        "SETTLED": _settled(opened, events),
        "DONE": _done(opened, events, values) if several else "",
        "FOUND": f"Found: {found}." if found and not makes_holes else "",
        "END": _ended(opened, events),
    }
    return [
        Sentence(0.0, wanted(opened), "WANTED"),
        *sentences,
        *(Sentence(last_s, text, code) for code, text in ends.items() if text),
    ]


def _places(values: Values) -> list[dict[str, Any]]:
    places: list[dict[str, Any]] = json.loads(str(values.get("sites") or "[]"))
    return places


def depths_of_holes(values: Values) -> list[float]:
    """Return the target depth of each hole, µm, NaN for the profile's; places from files are not recorded."""
    depths_um: list[float] = []
    for site in _places(values):
        if site["kind"] != "file":
            number = site.get("count", site.get("columns", 1) * site.get("rows", 1))
            depths_um += [site.get("depth_um", math.nan)] * number
    return depths_um


def _has_file(values: Values) -> bool:
    return any(site["kind"] == "file" for site in _places(values))


def touches_of(opened: RunFile) -> list[Sentence]:
    """One sentence per reading of pad, face or bottom."""
    sentences = []
    for row in opened.table("/entry/touches"):
        kind, site = (row[name].decode(errors="ignore") for name in ("kind", "site"))
        where = {
            "Z1": "the pad",
            "Z2": f"the bottom of {site}",
            "Z3": site if site == PAD else f"the pad after {site}",
            "Zr": f"the face at {site}",
        }.get(kind, site)
        z_um = row["z_model"] if math.isnan(row["z_sensor"]) else row["z_sensor"]
        times = "1 touch" if row["n"] == 1 else f"{row['n']} touches within {row['sd']:.2f} µm rms"
        refused = "" if row["accepted"] else "; the reading was not used"
        text = f"Touched {where} at {z_um:.2f} µm ({kind}, {times}){refused}."
        sentences.append(Sentence(float(row["time"]), text, "TOUCHED"))
    return sentences


def _settled(opened: RunFile, events: list[FileEvent]) -> str:
    """Describe the holes that a later touch of the pad gave another depth than feed and energy had."""
    estimated_um = {
        hole.encode()[:32]: (depth_um, plain_number(event.args.get("depth_u95_um")))
        for event, hole in zip(events, holes_of(events), strict=True)
        if event.code == "SITE_ESTIMATED" and isinstance(depth_um := event.args.get("depth_um"), float)
    }
    changed, grew = [], False
    for row in opened.table("/entry/results"):
        before = estimated_um.get(bytes(row["site"]))
        now = with_u95(row["depth"], row["depth_u95"])
        if before is not None and with_u95(*before) != now:
            name = row["site"].decode(errors="ignore")
            changed.append(f"{name} {now} µm (was {with_u95(*before)})")
            grew |= round(row["depth_u95"], 2) > round(before[1], 2)
    if not changed:
        return ""
    message = (
        f"The touches that came later gave holes that had not been touched new depths: {', '.join(changed)}."
    )
    why = (
        "An interval that grew holds that the touch was not quite where it was expected, and that nobody knows how "
        "the holes share the difference."
    )
    return f"{message} {why}" if grew else message


def _done(opened: RunFile, events: list[FileEvent], values: Values) -> str:
    """Return how many holes are done, of how many."""
    counts = [sum(event.code == code for event in events) for code in ("TARGET_REACHED", "VERDICT")]
    of_how_many = "" if _has_file(values) else f" of {len(depths_of_holes(values))}"
    parent = opened.text("/entry/parent_run")
    before = f" in this run; those before are in {parent}" if parent else ""
    return f"{counts[0] - counts[1]}{of_how_many} holes reached their target{before}."


def wanted(opened: RunFile) -> str:
    """Return the objective, by the command and the profile."""
    values = opened.profile_values()
    name = values.get("meta.name") or opened.text("/entry/title")
    objective = _objective_of_procedure(opened, values)
    if objective is not None:
        return f"{name}: wanted was {objective}."
    depths_um, target_um = depths_of_holes(values), float(values.get("target.depth_um", 0.0))
    own_um = {target_um if math.isnan(um) else um for um in depths_um} or {target_um}
    depth = " to ".join(f"{um:g}" for um in sorted({min(own_um), max(own_um)}))
    objective = {
        "depth": f"a depth of {depth} ± {values.get('target.tolerance_um', 0):g} µm",
        "feed": f"a feed of {values.get('target.feed_um', 0):g} µm",
        "through": f"a hole through the sheet of {values.get('work.thickness_um', 0):g} µm",
    }.get(str(values.get("target.kind")), "no objective that this version knows")
    jumps = {"off": "without jumps", "fixed": f"with a jump every {values.get('jump.period_s', 0):g} s"}
    how = jumps.get(str(values.get("jump.mode")), "with adaptive jumps")
    if len(depths_um) > 1:
        objective = f"{objective} at each of {len(depths_um)} places"
    work = values.get("work.material", "?")
    return f"{name}: wanted was {objective} in {work} with a {_tool(values)}, {how}."


def _objective_of_procedure(opened: RunFile, values: Values) -> str | None:
    """Return the objective of a procedure that makes no hole; None for a whole job."""
    tool, work = _tool(values), values.get("work.material")
    height_um, period_s = values.get("jump.height_um", 0), values.get("jump.period_s", 0)
    return {
        "wear reference": f"to touch the pad with a {tool}, as the reference of its wear",
        "measure-wear": f"to measure wear: how much shorter a {tool} is, and how deep its hole",
        "measure-drift": f"to find out what touches of a {tool} and rests at 0 V tell of drift",
        "contact touch": f"to find the surface of {work} with a {tool}",
        "approach": f"to find the spark gap of {work} with a {tool}",
        "jump-flush": f"to jump {height_um:g} µm every {period_s:g} s with a {tool}, "
        "and measure how well it comes back",
    }.get(opened.text("/entry/procedure"))


def _tool(values: Values) -> str:
    label, diameter_um = values.get("tool.id"), float(values.get("tool.diameter_um", math.nan))
    if not math.isfinite(diameter_um):
        return f"tool ({label})"
    text = f"{values.get('tool.material', '?')} tool of {diameter_um:g} µm"
    return f"{text} ({label})" if label and not str(label).endswith(f" {diameter_um:g} µm") else text


def _ended(opened: RunFile, events: list[FileEvent]) -> str:
    """Return how the run ended, and how long it took."""
    if not opened.is_finished:
        return (
            "The file has no end: the program that wrote it was killed, or is still running. "
            "What is above is what had reached the disk."
        )
    exit_code = int(opened.number("/entry/exit_code"))
    if exit_code == NO_EXIT_CODE:
        return "The program that wrote the file was killed. What is above is what could be recovered."
    summary, names = opened.summary() or {}, ("machining_time_s", "time_s", "earlier_time_s", "pause_s")
    machining_s, time_s, earlier_s, pause_s = (plain_number(summary.get(name)) for name in names)
    took = ""
    if math.isfinite(time_s) and math.isfinite(machining_s):
        took = f" after {duration(time_s)}, {duration(machining_s)} of them machining"
        if math.isfinite(earlier_s) and earlier_s:
            took += f", {earlier(earlier_s, pause_s)}"
    if exit_code == 0:
        return f"The run came to its end{took}."
    how = ended_as(opened.text("/entry/status"), error_code_of(opened))
    last = next((event for event in reversed(events) if event.code in ENDS), None)
    if last is None:
        why = (
            ": it was refused before the machine did anything. The file does not hold the reason; "
            "the command that wrote it said so on the terminal, and refuses again with the same one."
        )
    else:
        why = f": {code}, see above." if (code := last.args.get("code", "")) else ", see above."
    return f"The run ended with exit code {exit_code} ({how}){took}{why}"


def trouble_of(sentences: list[Sentence]) -> str:
    """Return the reason for an early end, with the remedy; empty if there is none."""
    for number, sentence in reversed(list(enumerate(sentences))):
        if sentence.code in ENDS:
            after = sentences[number + 1 :][:1]
            return " ".join([sentence.text, *(hint.text for hint in after if hint.code == "HINT")])
    return ""


def summary_of(opened: RunFile) -> RunSummary:
    """Read the summary of an open run file, also of one without an end."""
    from edmctl.report.export import TABLES, named

    sites, events, summary = sites_of(opened), events_of(opened), opened.summary() or {}
    exit_code = int(opened.number("/entry/exit_code"))
    estimated = estimated_depth(opened)
    warnings = [event for event in events if event.level >= WARNING_LEVEL]
    names = {column.name: named(column) for column in TOUCHES.columns}
    touches = []
    for row in opened.table(TOUCHES.path):
        cells = {names[name]: row[name].item() for name in row.dtype.names if name in names}
        touches.append(
            {
                name: cell.decode(errors="replace") if isinstance(cell, bytes) else cell
                for name, cell in cells.items()
            }
        )
    time_s = plain_number(summary.get("time_s"))
    if not math.isfinite(time_s):  # without an end: to its last row
        servo = opened.rows("/entry/servo")
        rows_s = opened.column("/entry/servo", "time", servo - 1, servo).tolist() if servo else []
        last_s = max([*rows_s, *(event.time_s for event in events[-1:])], default=math.nan)
        time_s = opened.number("/entry/parent_time") + last_s
    machine = ("host", "serial", "firmware", "protocol", "calibration")
    return RunSummary(
        file=str(opened.path),
        size_bytes=opened.path.stat().st_size,
        run_id=opened.text("/entry/run_id"),
        parent_run=opened.text("/entry/parent_run"),
        title=opened.text("/entry/title"),
        wanted=wanted(opened),
        command=tuple(json.loads(opened.text("/entry/command") or "[]")),
        user=opened.text("/entry/user/name"),
        start_time=opened.text("/entry/start_time"),
        end_time=opened.text("/entry/end_time"),
        status=status_of(opened),
        exit_code=None if exit_code == NO_EXIT_CODE else exit_code,
        error_code=error_code_of(opened),
        recovery=opened.text("/entry/recovery"),
        way_on=command_to_go_on(opened.path),
        simulated=opened.is_simulated,
        seed=opened.seed,
        time_s=time_s,
        machining_time_s=sites.total("machining_time_s"),
        earlier_time_s=opened.number("/entry/parent_time"),
        pause_s=plain_number(summary.get("pause_s", 0.0)),
        sites=sites,
        est_depth_um=estimated.depth_um,
        est_depth_u95_um=estimated.depth_u95_um,
        totals=sites.totals,
        jumps=jumps_of(events),
        touches=tuple(touches),
        moments=tuple(sentence for sentence in sentences_of(opened) if sentence.code in TIME_LINE),
        warnings=tuple(
            Sentence(event.time_s, f"{event.message} {_hint(event)}".rstrip(), event.code)
            for event in warnings
        ),
        machine={name: opened.text(f"/entry/machine/{name}") for name in machine},
        software={name: opened.text(f"/entry/software/{source}") for name, source in SOFTWARE.items()},
        profile={"path": opened.text("/entry/profile/path"), "values": opened.profile_values()},
        overrides=tuple(opened.text("/entry/profile/overrides").splitlines()),
        rows={name: opened.rows(table.path) for name, table in TABLES.items()},
        summary=opened.summary(),
    )


def jumps_of(events: Sequence[FileEvent]) -> JumpTimes:
    """Count all jumps, and the times between jumps of the same cut."""
    apart_s: list[float] = []
    count, last_s = 0, math.nan
    for event in events:
        if event.code == "JUMP_DONE":
            count += 1
            if math.isfinite(last_s):
                apart_s.append(event.time_s - last_s)
            last_s = event.time_s
        elif event.code == "CUT_ENDED":
            last_s = math.nan
    if not apart_s:
        return JumpTimes(count, math.nan, math.nan, math.nan)
    return JumpTimes(count, min(apart_s), median(apart_s), max(apart_s))
