"""A run in plain sentences, from its file: what was wanted, what it did and why, and what ended it."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

from edmctl.jobs.runs.events import event_sentences, events_of, holes_of
from edmctl.labels import PAD
from edmctl.record.events import error_code_of
from edmctl.results.run_file import FileEvent, Sentence
from edmctl.wording import duration, earlier, ended_as, facts, plain_number, with_u95

if TYPE_CHECKING:
    from edmctl.record.reader import RunFile

    Values = dict[str, float | int | str | bool]

ENDS = ("ENDED_EARLY", "TARGET_MISSED", "SITES_LEFT", "SETUP_WRONG", "VERDICT")
"""Kinds of sentences that say why a run did not come to its end."""


def sentences_of(opened: RunFile) -> list[Sentence]:
    """Return the sentences of an open run file, from what was wanted to what ended it."""
    events = events_of(opened)
    values = opened.profile_values()
    last_s = max((event.time_s for event in events), default=0.0)
    period_s = float(values.get("jump.period_s", 0.0))
    makes_holes = _alone(opened, values) is None
    several = makes_holes and (len(depths_of_holes(values)) > 1 or "file" in _kinds(values))
    sentences = [*touches_of(opened), *event_sentences(events, period_s, names_holes=several)]
    sentences.sort(key=lambda sentence: sentence.time_s)
    ends = [
        ("SETTLED", _settled(opened, events, holes_of(events))),
        ("DONE", _done(opened, events) if several else ""),
        ("FOUND", "" if makes_holes else _found(opened)),
        ("END", _ended(opened, events)),
    ]
    return [
        Sentence(0.0, wanted(opened), "WANTED"),
        *sentences,
        *(Sentence(last_s, text, code) for code, text in ends if text),
    ]


def _found(opened: RunFile) -> str:
    """What a command found that makes no hole."""
    found = "; ".join(f"{name} {value}" for name, value in facts(opened.summary() or {}))
    return f"Found: {found}." if found else ""


def depths_of_holes(values: Values) -> list[float]:
    """How deep each hole was to be, µm, NaN where the target says it; places from files are not in the run file."""
    depths_um: list[float] = []
    for site in json.loads(str(values.get("sites") or "[]")):
        if site["kind"] != "file":
            number = site.get("count", site.get("columns", 1) * site.get("rows", 1))
            depths_um += [site.get("depth_um", math.nan)] * number
    return depths_um


def _kinds(values: Values) -> set[str]:
    return {site["kind"] for site in json.loads(str(values.get("sites") or "[]"))}


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
    of_how_many = "" if "file" in _kinds(values) else f" of {len(depths_of_holes(values))}"
    parent = opened.text("/entry/parent_run")
    earlier = f" in this run; those before are in {parent}" if parent else ""
    return f"{done}{of_how_many} holes reached their target{earlier}."


def wanted(opened: RunFile) -> str:
    """What was wanted, by the command and the profile."""
    values = opened.profile_values()
    name = values.get("meta.name") or opened.text("/entry/title")
    alone = _alone(opened, values)
    if alone is not None:
        return f"{name}: wanted was {alone}."
    kind = values.get("target.kind")
    depths_um = depths_of_holes(values)
    objective = {
        "depth": f"a depth of {_depths(values, depths_um)} ± {values.get('target.tolerance_um', 0):g} µm",
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
    """What a procedure wanted that makes no hole; None where it was a whole job."""
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
    }.get(_procedure(opened))


def _procedure(opened: RunFile) -> str:
    """What was done; files of before this was kept tell it by their command line."""
    if told := opened.text("/entry/procedure"):
        return told
    words = json.loads(opened.text("/entry/command") or "[]")[1:]
    command = words[0] if words else ""
    special = {("approach", "--contact"): "contact touch", ("measure-wear", "--reference"): "wear reference"}
    return next(
        (kind for (name, option), kind in special.items() if name == command and option in words), command
    )


def _tool(values: Values) -> str:
    label, diameter_um = values.get("tool.id"), float(values.get("tool.diameter_um", math.nan))
    if not math.isfinite(diameter_um):
        return f"tool ({label})"
    text = f"{values.get('tool.material', '?')} tool of {diameter_um:g} µm"
    return f"{text} ({label})" if label and not str(label).endswith(f" {diameter_um:g} µm") else text


def _depths(values: Values, depths_um: list[float]) -> str:
    """The depth that was wanted, or from which to which."""
    target_um = float(values.get("target.depth_um", 0.0))
    own_um = sorted({target_um if math.isnan(um) else um for um in depths_um}) or [target_um]
    return f"{own_um[0]:g}" if len(own_um) == 1 else f"{own_um[0]:g} to {own_um[-1]:g}"


def _ended(opened: RunFile, events: list[FileEvent]) -> str:
    from edmctl.record.create import NO_EXIT_CODE

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
    return f"The run ended with exit code {exit_code} ({how}){took}{_why(events)}"


def trouble_of(sentences: list[Sentence]) -> str:
    """What ended a run that did not come to its end, with what to do about it; empty where no sentence says so."""
    for number, sentence in reversed(list(enumerate(sentences))):
        if sentence.code in ENDS:
            after = sentences[number + 1 :][:1]
            return " ".join([sentence.text, *(hint.text for hint in after if hint.code == "HINT")])
    return ""


def _why(events: list[FileEvent]) -> str:
    """Where the file says what ended a run that did not come to its end."""
    last = next((event for event in reversed(events) if event.code in ENDS), None)
    if last is None:
        return (
            ": it was refused before the machine did anything. The file does not hold the reason; "
            "the command that wrote it said so on the terminal, and refuses again with the same one."
        )
    code = last.args.get("code", "")
    return f": {code}, see above." if code else ", see above."
