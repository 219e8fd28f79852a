"""The job ledger: lines that outlive processes, and what they come to."""

from __future__ import annotations

import fcntl
import json
import math
import multiprocessing
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from edmctl.errors import RunFileError
from edmctl.record import ledger
from edmctl.record.ledger import (
    FILE_NAME,
    UNFINISHED,
    Entry,
    JobBegun,
    Ledger,
    Line,
    MachineHistory,
    ReferenceTouched,
    RunEnded,
    SiteMachined,
    ToolChanged,
    WearMeasured,
    history_of,
    text_of,
)

SERIAL = "SIM-1"
LINES_EACH = 40


def reference(z_um: float = 50.0, **other: Any) -> ReferenceTouched:
    made = ReferenceTouched(
        tool="Cu", run_file="r.h5", z_um=z_um, sd_um=0.1, touches=3, model_um=z_um + 1.0, sensor=True,
        x_um=0.0, y_um=0.0, speed_um_s=1.0, time_s=40.0, truth={"tool_wear_um": 2.5},
    )  # fmt: skip
    return replace(made, **other)


def site(name: str = "a", x_um: float = 500.0, **other: Any) -> SiteMachined:
    made = SiteMachined(
        tool="Cu", run_file=f"{name}.h5", name=name, x_um=x_um, y_um=0.0, radius_um=143.0, status="done",
        depth_um=20.0, wear_um=10.0, wear_u95_um=0.6,
    )  # fmt: skip
    return replace(made, **other)


def refused(call: Callable[[], object]) -> RunFileError:
    with pytest.raises(RunFileError) as caught:
        call()
    assert caught.value.hint
    return caught.value


def history(*entries: Entry) -> MachineHistory:
    return history_of([Line(SERIAL, 1.0, entry) for entry in entries], SERIAL)


END, REFERENCE, SITE = (
    text_of(Line(SERIAL, 1.0, entry)).rstrip()
    for entry in (RunEnded("r.h5", "done", 1.5), reference(), site())
)


def test_what_is_appended_is_read_again(tmp_path: Path) -> None:
    assert Ledger.open(tmp_path / "runs").lines == ()
    entries = (
        ToolChanged("Cu"),
        reference(),
        JobBegun("Cu", "a.h5", 143.0, (("a", 500.0, 0.0),)),
        site(),
        WearMeasured("Cu", "w.h5", 60.0, 10.0, 1.0),
        RunEnded("a.h5", "done", 100.0),
    )
    Ledger.open(tmp_path).append(SERIAL, *entries)
    lines = Ledger.open(tmp_path).lines
    assert [line.serial for line in lines] == [SERIAL] * len(entries)
    # NaN is not itself; its text is.
    assert [repr(line.entry) for line in lines] == [repr(entry) for entry in entries]


def test_a_torn_last_line_is_left_out_and_nothing_is_glued_to_it(tmp_path: Path) -> None:
    Ledger.open(tmp_path).append(SERIAL, reference(), site())
    path = tmp_path / FILE_NAME
    whole = path.read_bytes()
    for cut in range(1, len(whole) - whole.index(b"\n") - 2, 17):
        path.write_bytes(whole[:-cut])
        torn = Ledger.open(tmp_path)
        assert len(torn.lines) == (2 if cut == 1 else 1)
        torn.append(SERIAL, RunEnded("r.h5", "done", 1.0))
        assert isinstance(Ledger.open(tmp_path).lines[-1].entry, RunEnded)
        assert len(Ledger.open(tmp_path).lines) == len(torn.lines)
    for unreadable in ('"serial": ' + "[" * 100_000, END.replace("1.5", "9" * 400)):
        path.write_bytes(whole + unreadable.encode())
        book = Ledger.open(tmp_path)
        assert len(book.lines) == 2
        book.append(SERIAL, site())
        assert len(Ledger.open(tmp_path).lines) == 3


@pytest.mark.parametrize(
    "damage",
    [
        "not JSON",
        "[]",
        '{"v": 1}',
        '{"v": 1, "kind": "nothing", "serial": "s", "utc_s": 1}',
        '{"v": 1, "kind": "tool", "serial": "s", "utc_s": 1, "tool": 5}',
        '{"v": 1, "kind": "tool", "serial": "s", "utc_s": 1, "tool": "Cu", "more": 1}',
        '{"v": 1, "kind": "end", "serial": "s", "utc_s": 1, "run_file": "r", "status": "done", "time_s": "x"}',
        "\x00\x00",
        END.replace("1.5", "9" * 400),
        END.replace("1.5", "1e300"),
        END.replace("1.5", "[" * 100_000),
        END.replace("r.h5", "\\ud800"),
        REFERENCE.replace('"touches": 3', '"touches": 0'),
        SITE.replace('"depth_um": 20.0', '"depth_um": null'),
        SITE.replace('"z3_um": null', '"z3_um": 1e300'),
        SITE.replace('"x_um": 500.0', '"x_um": null'),
    ],
)
def test_a_damaged_line_is_refused_with_its_number(tmp_path: Path, damage: str) -> None:
    book = Ledger.open(tmp_path)
    book.append(SERIAL, reference())
    with book.path.open("a", encoding="utf-8") as file:
        file.write(damage + "\n")
    book.append(SERIAL, site())
    error = refused(lambda: Ledger.open(tmp_path))
    assert (error.code, f"{FILE_NAME}:2:" in error.message) == ("E9031", True)
    error.message.encode()


def test_what_is_no_file_or_of_a_later_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / FILE_NAME
    path.write_text('{"v": 5, "kind": "dream"}\n', encoding="utf-8")
    assert refused(lambda: Ledger.open(tmp_path)).code == "E9032"
    inside = Ledger(path / FILE_NAME, ())
    assert refused(lambda: inside.append(SERIAL, site())).code == "E9033"
    path.unlink()
    path.mkdir()
    assert refused(lambda: Ledger.open(tmp_path)).code == "E9030"


def test_a_ledger_that_stays_locked_is_refused_before_a_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ledger, "OPENING_WAIT_S", 0.0)
    Ledger.open(tmp_path).append(SERIAL, site())
    with (tmp_path / FILE_NAME).open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        error = refused(lambda: Ledger.open(tmp_path))
        assert error.code == "E9030"
        assert re.search(f"process {os.getpid()}.* has it open for writing", error.message)
    assert len(Ledger.open(tmp_path).lines) == 1


def _append_many(folder: Path, serial: str) -> None:
    for number in range(LINES_EACH):
        Ledger.open(folder).append(serial, RunEnded(f"{number}.h5", "done", float(number)))


def test_two_writers_lose_nothing(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    writers = [context.Process(target=_append_many, args=(tmp_path, serial)) for serial in ("A", "B")]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
        assert writer.exitcode == 0
    lines = Ledger.open(tmp_path).lines
    for serial in ("A", "B"):
        times_s = [line.entry.time_s for line in lines if line.serial == serial]  # type: ignore[union-attr]
        assert times_s == [float(number) for number in range(LINES_EACH)]


def test_wear_is_carried_from_the_reference_on() -> None:
    entries: list[Entry] = [reference(), site(), site("b", 1000.0, z3_um=71.0)]
    other = Line("SIM-2", 1.0, site("d", tool="W"))
    machine = history_of([*(Line(SERIAL, 1.0, entry) for entry in entries), other], SERIAL)
    account = machine.account("Cu")
    assert (account.worn_um, account.lost_um, account.pad_um) == (20.0, 20.0, 71.0)
    assert account.worn_u95_um == pytest.approx(0.6 * math.sqrt(2.0))
    assert [hole.name for hole in machine.holes] == ["a", "b"]
    assert (machine.tool, account.replaced_by) == ("Cu", "")
    account = history(*entries, reference(72.0)).account("Cu")
    assert (account.worn_um, account.lost_um, account.pad_um) == (0.0, 20.0, 72.0)
    account = history(*entries, reference(72.0), ToolChanged("Cu")).account("Cu")
    assert (account.reference, account.lost_um, len(account.holes)) == (None, 0.0, 0)


def test_a_tool_that_was_replaced_has_no_reference_before_it_is_touched_again() -> None:
    begun = JobBegun("W", "w.h5", 143.0, (("c", 1500.0, 0.0),))
    entries = (reference(), site(), begun, RunEnded("w.h5", "done", 1.0))
    account = history(*entries).account("Cu")
    assert (account.reference, account.replaced_by) == (None, "W")
    assert (account.worn_um, account.lost_um) == (0.0, 10.0)
    assert math.isnan(account.pad_um)
    account = history(*entries, reference(64.0), site("d", 2000.0, wear_um=5.0)).account("Cu")
    assert (account.replaced_by, account.worn_um, account.lost_um) == ("", 5.0, 15.0)
    assert account.reference is not None


def test_the_tool_touches_later_by_a_wear_that_was_not_measured() -> None:
    entries = (reference(), site(wear_um=7.0, status=UNFINISHED))
    assert history(*entries).account("Cu").pad_um == 57.0
    assert history(*entries, WearMeasured("Cu", "w.h5", 58.5, 8.5, 1.0)).account("Cu").pad_um == 58.5


def test_a_hole_that_was_taken_up_again_counts_once() -> None:
    entries = (reference(), site(wear_um=4.0, status=UNFINISHED), site(wear_um=9.0, z3_um=59.0))
    machine = history(*entries)
    assert [hole.status for hole in machine.holes] == ["done"]
    assert (machine.account("Cu").worn_um, machine.account("Cu").pad_um) == (9.0, 59.0)
    # Also when the reference was touched anew between the two.
    assert history(*entries, reference(59.0), site(wear_um=12.0)).account("Cu").lost_um == 12.0


def test_a_hole_that_is_told_of_once_more_is_no_news_of_the_tool() -> None:
    measured = site(z3_um=60.0)
    entries: list[Entry] = [reference()]
    for wear_um in (4.0, 6.0):
        entries += [measured, site("b", 1000.0, wear_um=wear_um, status=UNFINISHED)]
    account = history(*entries).account("Cu")
    assert (account.pad_um, account.lost_um) == (66.0, 16.0)
    # Nor does it make the hole one that was machined after a later reference, or after those of other jobs.
    account = history(*entries, reference(66.0), site("c", 1500.0, z3_um=76.0), measured).account("Cu")
    assert (account.pad_um, account.worn_um, account.lost_um) == (76.0, 10.0, 26.0)
    assert account.holes[-1].name == "c"


def test_places_of_a_job_that_never_ended_are_taken() -> None:
    begun = JobBegun("Cu", "a.h5", 143.0, (("a", 500.0, 0.0), ("b", 1000.0, 0.0)))
    holes = history(begun, site()).holes
    assert [(hole.name, hole.status) for hole in holes] == [("a", "done"), ("b", UNFINISHED)]
    assert math.isnan(holes[1].depth_um)
    ended = history(begun, site(), RunEnded("a.h5", "interrupted", 10.0))
    assert [hole.name for hole in ended.holes] == ["a"]


def test_lines_are_json_with_the_time_of_the_bench(tmp_path: Path) -> None:
    Ledger.open(tmp_path).append(SERIAL, reference(), bench_s=1234.5)
    Ledger.open(tmp_path).append(SERIAL, site(home_um=3.0))
    machine = history_of(Ledger.open(tmp_path).lines, SERIAL)
    assert machine.account("Cu").reference_bench_s == 1234.5
    assert math.isnan(machine.homes[-1].bench_s)
    line = json.loads((tmp_path / FILE_NAME).read_text(encoding="utf-8").splitlines()[1])
    assert (line["v"], line["kind"], line["serial"], line["tool"]) == (4, "site", SERIAL, "Cu")
    assert (line["z3_um"], line["home_um"]) == (None, 3.0)


def test_where_a_touch_was_counts_from_home_and_from_zero_before_home_was_told(tmp_path: Path) -> None:
    touched = reference(80.0, home_um=30.0)
    assert history(touched).account("Cu").pad_um == 50.0
    assert history(touched, site(z3_um=97.0, home_um=33.0)).account("Cu").pad_um == 64.0
    file = tmp_path / FILE_NAME
    line = json.loads(text_of(Line(SERIAL, 1.0, touched)))
    del line["home_um"]
    file.write_text(json.dumps({**line, "v": 1}) + "\n", encoding="utf-8")
    assert history_of(Ledger.open(tmp_path).lines, SERIAL).account("Cu").pad_um == 80.0
