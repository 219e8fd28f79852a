"""A run in sentences, from its file: objective, steps with reasons, and end."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Any

from edmctl.dataclasses import dataclass
from edmctl.labels import PAD
from edmctl.link.faults import FAULTS
from edmctl.machine.interface import EventCode
from edmctl.record.layout import NO_EXIT_CODE
from edmctl.record.reader import RunFile, error_code_of, recorded_events
from edmctl.record.rows import RunEvent
from edmctl.results.run_file import FileEvent, Sentence
from edmctl.wording import duration, earlier, ended_as, facts, plain_number, plural, with_u95

if TYPE_CHECKING:
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
DEBUG = 0


@dataclass(frozen=True, slots=True)
class Jump:
    """One jump. `is_flushing`: arcs or shorts have shortened the period.

    `shares` has the arcs and shorts since the last jump, NaN if not recorded; `asking` caused this jump.
    """

    time_s: float
    is_flushing: bool
    shares: Mapping[str, float]
    asking: Mapping[str, float]


def events_of(opened: RunFile, start: int = 0) -> list[FileEvent]:
    """The events of the file from row `start` on, in the order in which they were written."""
    names = {int(code): code.name for code in (*EventCode, *RunEvent)}
    found = []
    for event in recorded_events(opened, start=start):
        name, args = names.get(event.code, str(event.code)), dict(event.values)
        if name == RunEvent.ENDED_EARLY.name and not args.get("hint"):
            code = str(args.get("code", ""))
            args["hint"] = next((row.hint for row in FAULTS.values() if row.error == code), "")
        found.append(FileEvent(event.time_s, name, event.level, event.message, args))
    return found


def event_sentences(
    events: Sequence[FileEvent], period_s: float, *, names_holes: bool = False
) -> list[Sentence]:
    """Describe the events: jumps by intervals with their reason, hints, all else as recorded.

    period_s : jump period of the recipe
    names_holes : start sentences with the hole's name
    """
    sentences: list[Sentence] = []
    jumps: list[Jump] = []
    for event, hole in zip(events, holes_of(events), strict=True):
        if event.code == "JUMPED":
            jumps.append(_jump(event, period_s))
            continue
        if event.level == DEBUG or event.code in LEFT_OUT:
            continue
        if event.code == "CUT_ENDED" or event.code.endswith("_CHANGED") or event.code == "ENDED_EARLY":
            sentences += jump_sentences(jumps)
            jumps.clear()
        name = f"{hole}: " if names_holes and hole and event.code in OF_A_HOLE else ""
        sentences.append(Sentence(event.time_s, f"{name}{event.message}", event.code))
        hint = event.args.get("hint")
        if isinstance(hint, str) and hint:
            sentences.append(Sentence(event.time_s, hint, "HINT"))
    sentences += jump_sentences(jumps)
    return sorted(sentences, key=lambda sentence: sentence.time_s)


def holes_of(events: Sequence[FileEvent]) -> list[str]:
    """Return the hole of each event; empty between holes."""
    found, hole = [], ""
    for event in events:
        if event.code == "STAGE_MOVED":
            place = event.message.removeprefix("At ").rpartition(" (")[0]
            hole = hole if place == PAD else place
        elif event.code == "FACE_FITTED":
            hole = ""
        found.append(hole)
        if event.code in ("TARGET_REACHED", "TARGET_MISSED"):
            hole = ""
    return found


def _jump(event: FileEvent, period_s: float) -> Jump:
    values = {name: plain_number(value) for name, value in event.args.items()}
    asking = {name: values.get(f"asking_{name}", math.nan) for name in ("arcs", "shorts")}
    return Jump(
        event.time_s,
        bool(event.args.get("asked")) or values.get("period_s", period_s) < period_s,
        {"arcs": values.get("arcs", 0.0), "shorts": values.get("shorts", math.nan)},
        {name: share for name, share in asking.items() if math.isfinite(share)},
    )


def jump_sentences(jumps: Sequence[Jump]) -> list[Sentence]:
    """Describe the jumps of one cut, in order of time, by intervals with and without a shortened period."""
    groups = [list(group) for _, group in groupby(jumps, key=lambda jump: jump.is_flushing)]
    return [Sentence(group[0].time_s, _sentence(group), "JUMPED") for group in groups]


def _percent(shares: Mapping[str, float]) -> str:
    return " and ".join(f"{100.0 * share:.1f} % {name}" for name, share in shares.items())


def _sentence(group: Sequence[Jump]) -> str:
    flushing, why = group[0].is_flushing, "as its period asks for"
    if flushing:
        most = {
            name: max(jump.asking.get(name, 0.0) for jump in group) for jump in group for name in jump.asking
        }
        why = f"because {' and '.join(most) or 'arcs or shorts'} asked for more flushing"
        if most:
            why += f": up to {_percent(most)} within a second"
    means = {name: sum(jump.shares[name] for jump in group) / len(group) for name in ("arcs", "shorts")}
    if between := _percent({name: mean for name, mean in means.items() if mean >= 0.0005}):
        why += f"; {between} between jumps" + (" on average" if flushing else "")
    if len(group) == 1:
        return f"It jumped once, {why}."
    times_s = [jump.time_s for jump in group]
    gaps_s = sorted(later - earlier for earlier, later in pairwise(times_s))
    low, high = f"{gaps_s[0]:.2g}", f"{gaps_s[-1]:.2g}"
    every = f"every {low} s" if low == high else f"every {low}–{high} s"
    return (
        f"From {duration(times_s[0])} to {duration(times_s[-1])} it jumped {plural(len(group), 'time')}, "
        f"{every}, {why}."
    )


ENDS = ("ENDED_EARLY", "TARGET_MISSED", "SITES_LEFT", "SETUP_WRONG", "VERDICT")
"""Kinds of sentences that give the reason for an early end."""


def sentences_of(opened: RunFile) -> list[Sentence]:
    """Return the sentences of an open run file, from its objective to its end."""
    events = events_of(opened)
    values = opened.profile_values()
    last_s = max((event.time_s for event in events), default=0.0)
    period_s = float(values.get("jump.period_s", 0.0))
    makes_holes = _alone(opened, values) is None
    several = makes_holes and (len(depths_of_holes(values)) > 1 or _has_file(values))
    sentences = [*touches_of(opened), *event_sentences(events, period_s, names_holes=several)]
    sentences.sort(key=lambda sentence: sentence.time_s)
    found = "; ".join(f"{name} {value}" for name, value in facts(opened.summary() or {}))
    ends = [
        ("SETTLED", _settled(opened, events, holes_of(events))),
        ("DONE", _done(opened, events) if several else ""),
        ("FOUND", f"Found: {found}." if found and not makes_holes else ""),
        ("END", _ended(opened, events)),
    ]
    return [
        Sentence(0.0, wanted(opened), "WANTED"),
        *sentences,
        *(Sentence(last_s, text, code) for code, text in ends if text),
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
        spread = f" within {row['sd']:.2f} µm rms" if row["n"] > 1 else ""
        refused = "" if row["accepted"] else "; the reading was not used"
        times = "1 touch" if row["n"] == 1 else f"{row['n']} touches"
        text = f"Touched {where} at {z_um:.2f} µm ({kind}, {times}{spread}){refused}."
        sentences.append(Sentence(float(row["time"]), text, "TOUCHED"))
    return sentences


def _settled(opened: RunFile, events: list[FileEvent], holes: list[str]) -> str:
    """Which holes a later touch of the pad gave another depth than feed and energy had."""
    said_um = {
        hole: (depth_um, plain_number(event.args.get("depth_u95_um")))
        for event, hole in zip(events, holes, strict=True)
        if event.code == "SITE_ESTIMATED" and isinstance(depth_um := event.args.get("depth_um"), float)
    }
    changed, grew = [], False
    for row in opened.table("/entry/results"):
        name = row["site"].decode(errors="ignore")
        said = next((known for hole, known in said_um.items() if hole.encode()[:32] == row["site"]), None)
        if said is None:
            continue
        before, now = with_u95(*said), with_u95(row["depth"], row["depth_u95"])
        if before != now:
            changed.append(f"{name} {now} µm (was {before})")
            grew |= round(row["depth_u95"], 2) > round(said[1], 2)
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


def _done(opened: RunFile, events: list[FileEvent]) -> str:
    """How many holes are done, of how many."""
    values = opened.profile_values()
    doubtful = sum(event.code == "VERDICT" for event in events)
    done = sum(event.code == "TARGET_REACHED" for event in events) - doubtful
    of_how_many = "" if _has_file(values) else f" of {len(depths_of_holes(values))}"
    parent = opened.text("/entry/parent_run")
    earlier = f" in this run; those before are in {parent}" if parent else ""
    return f"{done}{of_how_many} holes reached their target{earlier}."


def wanted(opened: RunFile) -> str:
    """Return the objective, by the command and the profile."""
    values = opened.profile_values()
    name = values.get("meta.name") or opened.text("/entry/title")
    alone = _alone(opened, values)
    if alone is not None:
        return f"{name}: wanted was {alone}."
    kind = values.get("target.kind")
    depths_um, target_um = depths_of_holes(values), float(values.get("target.depth_um", 0.0))
    own_um = {target_um if math.isnan(um) else um for um in depths_um} or {target_um}
    depth = " to ".join(f"{um:g}" for um in sorted({min(own_um), max(own_um)}))
    objective = {
        "depth": f"a depth of {depth} ± {values.get('target.tolerance_um', 0):g} µm",
        "feed": f"a feed of {values.get('target.feed_um', 0):g} µm",
        "through": f"a hole through the sheet of {values.get('work.thickness_um', 0):g} µm",
    }.get(str(kind), "no objective that this version knows")
    jumps = {"off": "without jumps", "fixed": f"with a jump every {values.get('jump.period_s', 0):g} s"}
    how = jumps.get(str(values.get("jump.mode")), "with adaptive jumps")
    if len(depths_um) > 1:
        objective = f"{objective} at each of {len(depths_um)} places"
    return (
        f"{name}: wanted was {objective} in {values.get('work.material', '?')} with a {_tool(values)}, {how}."
    )


def _alone(opened: RunFile, values: Values) -> str | None:
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
    if not opened.is_finished:
        return (
            "The file has no end: the program that wrote it was killed, or is still running. "
            "What is above is what had reached the disk."
        )
    exit_code = int(opened.number("/entry/exit_code"))
    if exit_code == NO_EXIT_CODE:
        return "The program that wrote the file was killed. What is above is what could be recovered."
    summary = opened.summary() or {}
    machining_s, time_s = plain_number(summary.get("machining_time_s")), plain_number(summary.get("time_s"))
    took = ""
    if math.isfinite(time_s) and math.isfinite(machining_s):
        took = f" after {duration(time_s)}, {duration(machining_s)} of them machining"
        earlier_s = plain_number(summary.get("earlier_time_s", 0.0))
        if math.isfinite(earlier_s) and earlier_s:
            took += f", {earlier(earlier_s, plain_number(summary.get('pause_s')))}"
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
