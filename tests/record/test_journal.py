"""The journal of a run: whole or refused, rarely written, gone in the end."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from edmctl.errors import PreconditionError, RunFileError
from edmctl.record import journal as journals
from edmctl.record.journal import (
    Journal,
    JournalFile,
    JournalledJob,
    journal_path,
    read_journal,
    write_journal,
)

JOB = JournalledJob(
    run_id="a", start="2026-01-31T10:15:00.250+00:00", profile="/somewhere/cu150.toml",
    overrides=("target.depth_um=60",), profile_sha256="11", sim_sha256="22", setup="", setup_sha256="33",
    calibration="", allow_model=False, port="/dev/ttyACM0", serial="EDM-7", boots=3, tool="Cu 150 µm", seed=None,
    places=(("hole 1", 500.0, 0.0, 0.0, math.nan), ("hole 2", 900.0, 0.0, 0.0, 40.0)), parents=("first",),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Step:
    """A state of a job, numbers that JSON does not know in it."""

    time_s: float
    depth_um: float = 1.0
    done: tuple[dict[str, object], ...] = (
        {"name": "hole 1", "wear": math.nan, "ratios": {"open": math.nan}},
    )

    def as_mapping(self) -> dict[str, object]:
        return {"time_s": self.time_s, "depth_um": self.depth_um, "face": [], "done": self.done}


def kept(path: Path) -> JournalFile:
    return JournalFile(path, JOB, lambda: (500.0, 1.5))


def test_what_was_kept_is_what_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    kept(path).keep(Step(12.5, math.nan), urgent=True)
    found = read_journal(path)
    places = [[str(value) for value in place] for place in found.job.places]
    assert places == [[str(value) for value in place] for place in JOB.places]
    assert replace(found.job, places=JOB.places) == JOB
    assert (found.x_um, found.y_um) == (500.0, 1.5)
    assert found.state["time_s"] == 12.5
    assert found.state["depth_um"] is None
    assert found.state["face"] == []
    (site,) = found.state["done"]  # type: ignore[misc]
    assert site["wear"] is None  # type: ignore[has-type]
    assert site["ratios"]["open"] is None  # type: ignore[has-type]


def test_a_cut_is_written_every_five_seconds_of_the_machine_and_a_step_at_once(tmp_path: Path) -> None:
    path, places_um = tmp_path / "a.journal", iter([(1.0, 2.0), (3.0, 4.0)])
    file = JournalFile(path, JOB, lambda: next(places_um))
    steps = [(100.0, True), *((100.0 + tenth / 10.0, False) for tenth in range(1, 50))]
    # The stages are asked with urgent steps alone.
    for time_s, urgent, on_disk in (
        *((time_s, urgent, (100.0, 1.0)) for time_s, urgent in steps),
        (105.0, False, (105.0, 1.0)),
        (105.1, True, (105.1, 3.0)),
        (110.0, False, (105.1, 3.0)),
    ):
        file.keep(Step(time_s), urgent=urgent)
        journal = read_journal(path)
        assert (journal.state["time_s"], journal.x_um) == on_disk


class Site(dict[str, object]):
    """A finished site that counts how often it is converted."""

    converted = 0

    def items(self) -> Any:
        self.converted += 1
        return super().items()


def test_a_finished_site_is_converted_once_and_written_at_every_step(tmp_path: Path) -> None:
    file = kept(tmp_path / "a.journal")
    sites = tuple(Site(name=f"hole {number}", wear_um=math.nan) for number in range(5))
    for number in range(6):
        file.keep(Step(float(number), done=sites[:number]), urgent=True)
        names = [site["name"] for site in read_journal(file.path).state["done"]]  # type: ignore[attr-defined]
        assert names == [site["name"] for site in sites[:number]]
    assert [site.converted for site in sites] == [1] * 5
    file.keep(Step(9.0, done=(Site(name="corrected"), *sites[1:])), urgent=True)
    assert read_journal(file.path).state["done"][0] == {"name": "corrected"}  # type: ignore[index]


@pytest.mark.parametrize("fails", ["open", "fsync", "rename"])
def test_a_write_that_fails_leaves_the_journal_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    path = tmp_path / "a.journal"
    file = kept(path)
    file.keep(Step(1.0), urgent=True)

    def refuse(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    names = {"open": "pathlib.Path.open", "fsync": "os.fsync", "rename": "pathlib.Path.replace"}
    with monkeypatch.context() as patch:
        patch.setattr(names[fails], refuse)
        with pytest.raises(RunFileError, match="No space left") as refused:
            file.keep(Step(2.0), urgent=True)
    assert refused.value.code == "E9040"
    assert read_journal(path).state["time_s"] == 1.0
    assert [file.name for file in tmp_path.iterdir()] == ["a.journal"]


def test_the_new_one_is_on_the_disk_before_it_takes_the_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    for name in ("os.fsync", "pathlib.Path.replace"):
        call = {"os.fsync": os.fsync, "pathlib.Path.replace": type(tmp_path).replace}[name]

        def noted(*args: Any, call: Any = call, name: str = name) -> Any:
            order.append(name)
            return call(*args)

        monkeypatch.setattr(name, noted)
    kept(tmp_path / "a.journal").keep(Step(1.0), urgent=True)
    assert order == ["os.fsync", "pathlib.Path.replace", "os.fsync"]


def spoilt(how: str, path: Path) -> None:
    data = path.read_bytes()
    envelope = json.loads(data)
    if how == "part missing":
        envelope["content"].pop("job")
        envelope["sha256"] = journals._hash_of(journals._canonical(envelope["content"]))
    path.write_bytes(
        {
            "cut off": data[: len(data) // 2],
            "empty": b"",
            "one digit": data.replace(b"500.0", b"501.0"),
            "torn block": data[:512] + bytes(512) + data[1024:],
            "another file": b'{"schema": "something"}',
            "part missing": json.dumps(envelope).encode(),
            "no version": json.dumps({**envelope, "version": "one"}).encode(),
            "later version": json.dumps({**envelope, "version": 9}).encode(),
        }[how]
    )


@pytest.mark.parametrize(
    ("how", "message"),
    [
        *((how, "is damaged") for how in ("cut off", "empty", "one digit", "torn block", "another file")),
        *((how, "is damaged") for how in ("part missing", "no version")),
        ("later version", "version 9, this one knows 2"),
    ],
)
def test_a_damaged_or_later_journal_is_refused(tmp_path: Path, how: str, message: str) -> None:
    path = tmp_path / "a.journal"
    kept(path).keep(Step(1.0), urgent=True)
    spoilt(how, path)
    with pytest.raises(PreconditionError, match=message) as refused:
        read_journal(path)
    assert (refused.value.code, bool(refused.value.hint)) == ("E8052", True)


@pytest.mark.parametrize(
    "other",
    [
        {"overrides": (5,)},
        {"profile": 3},
        {"boots": "1"},
        {"seed": 1.5},
        {"allow_model": 1},
        {"parents": (None,)},
    ],
)
def test_a_job_with_a_member_of_another_type_is_refused(tmp_path: Path, other: dict[str, Any]) -> None:
    path = tmp_path / "a.journal"
    write_journal(path, Journal(replace(JOB, **other), {}, 0.0, 0.0, 0.0))
    with pytest.raises(PreconditionError, match=f"is damaged: {next(iter(other))}") as refused:
        read_journal(path)
    assert refused.value.code == "E8052"


def test_no_journal_and_an_unreadable_one_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_journal(tmp_path / "none.journal")
    (tmp_path / "folder.journal").mkdir()
    with pytest.raises(RunFileError) as refused:
        read_journal(tmp_path / "folder.journal")
    assert refused.value.code == "E9041"


def test_it_lies_beside_the_run_file_until_the_run_is_done(tmp_path: Path) -> None:
    path = journal_path(tmp_path / "cu150-2026.5Z.h5")
    assert path == tmp_path / "cu150-2026.5Z.journal"
    whole = Journal(
        replace(JOB, places=()), {"time_s": 1.0, "face": []}, 5.0, 1.0, 2.0, {"tool_wear_um": 3.0}
    )
    write_journal(path, whole)
    assert read_journal(path) == whole
    for _ in range(2):
        kept(path).remove()
        assert list(tmp_path.iterdir()) == []
