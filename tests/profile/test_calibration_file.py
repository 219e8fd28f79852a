"""The calibration file: exact, whole, hashed; and where it is looked for."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from edmctl.actuator.identification import Identification
from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.validation import Bands, ErrorFigures
from edmctl.errors import RecordError, RunFileError
from edmctl.profile.calibration import (
    BEYOND_PLAYS,
    SCHEMA,
    Calibration,
    Figures,
    Made,
    MeasuredFile,
    Parameters,
    Quality,
    Spread,
    calibration_of,
    measured_file,
)
from edmctl.profile.folders import find_kept, kept_path
from edmctl.profile.tables import content_hash
from tests.planning.rules.documents import place_of

PAGE = Path(__file__).parents[2] / "docs/calibration-file.md"
MADE = Made(utc="2026-01-02T03:04:05Z", edmctl="0.1.0", serial="SIM-7", simulated=True)


def make_model(*, creeping: int = 2, rounded: int = 0) -> ActuatorModel:
    """Parameters with every digit that a float has."""
    rng = np.random.default_rng(5)
    others = np.random.default_rng(6)
    thresholds_v = np.array([0.0, 0.1, 1.0, 1.0 + 1e-15]) * 7.3 / 3.0
    return ActuatorModel(
        thresholds_v=thresholds_v,
        knots_v=np.sort(rng.uniform(0.0, 150.0, (4, 4)), axis=1),
        slopes_um_per_v=rng.uniform(1e-17, 3.0, (4, 3)),
        creep_plays=np.array([0, 2][:creeping], dtype=np.int64),
        time_constants_s=np.array([0.1, 0.7, 1e3][: 3 * bool(creeping)]),
        creep_um_per_v=rng.uniform(0.0, 0.05, (2, 3))[:creeping, : 3 * bool(creeping)],
        zero_um=-1.0 / 3.0,
        delay_s=0.0,
        low_v=0.0,
        high_v=150.0,
        rounded_limits_v=others.uniform(5.0, 30.0, (rounded, 2)),
        rounded_sharpness=others.uniform(0.0, 1.0, rounded),
        rounded_unloading=others.uniform(0.0, 1.0, rounded),
        rounded_um_per_v=others.uniform(0.0, 1.0, rounded),
        lag_s=rounded / 3000.0,
    )


def an_identification(
    problems: tuple[str, ...] = (), *, creeping: int = 2, rounded: int = 0
) -> Identification:
    return Identification(
        model=make_model(creeping=creeping, rounded=rounded),
        train=ErrorFigures.of_range(1.5, 0.3, 445.0),
        held_out=ErrorFigures.of_range(2.0, 0.5, 445.0),
        held_out_model=ErrorFigures.of_range(1.8, 0.4, 445.0),
        bands=Bands(0.1, 0.3, 2.9, 0.01, 0.15, 0.002, 0.017, 0.001),
        problems=problems,
        notes=("The records swing at one rate.",),
        samples=59_249,
    )


def a_calibration() -> Calibration:
    return calibration_of(an_identification(), MADE, {"line": ErrorFigures.of_range(40.0, 18.0, 445.0)})


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "deep" / "actuator.toml"
    a_calibration().save(path)
    return path


def refused(path: Path) -> RecordError:
    with pytest.raises(RecordError) as refusal:
        Calibration.load(path)
    assert refusal.value.exit_code == 3
    assert "edmctl calibrate" in refusal.value.hint
    return refusal.value


def rewritten(path: Path, change: Callable[[dict[str, object]], object]) -> Path:
    """Change the content, and give it its hash, as another program could."""
    import tomli_w

    table = tomllib.loads(path.read_text(encoding="utf-8"))
    del table["sha256"]
    change(table)
    path.write_text(tomli_w.dumps({"sha256": content_hash(table), **table}), encoding="utf-8")
    return path


@pytest.mark.parametrize(("creeping", "rounded"), [(0, 0), (2, 0), (2, 1), (0, 2)])
def test_a_model_comes_back_bit_by_bit(tmp_path: Path, creeping: int, rounded: int) -> None:
    identification = an_identification(creeping=creeping, rounded=rounded)
    calibration_of(identification, MADE).save(tmp_path / "c.toml")
    assert Calibration.load(tmp_path / "c.toml").schema_name == (BEYOND_PLAYS if rounded else SCHEMA)
    found = Calibration.load(tmp_path / "c.toml").model()
    for field in dataclasses.fields(ActuatorModel):
        written, read = getattr(identification.model, field.name), getattr(found, field.name)
        np.testing.assert_array_equal(read, written, strict=True)


def test_everything_else_comes_back(saved: Path) -> None:
    calibration = Calibration.load(saved)
    assert calibration == a_calibration()
    assert calibration.serial == "SIM-7"
    assert calibration.made.simulated
    assert calibration.quality.accepted
    assert calibration.quality.held_out.rms_pct == pytest.approx(100.0 * 0.5 / 445.0)
    assert calibration.quality.bands.loop_width_sd == 0.002
    assert calibration.baselines["line"].rms_um == 18.0


def test_problems_and_files_are_told(tmp_path: Path) -> None:
    data = tmp_path / "a.csv"
    data.write_bytes(b"t_s,u_V,y_um\n")
    made = Made(
        utc="2026-01-02", edmctl="0.1.0", records=[measured_file(data, 12, 75.0), measured_file(data, 9)]
    )
    calibration_of(an_identification(("Not covered.",)), made).save(tmp_path / "c.toml")
    calibration = Calibration.load(tmp_path / "c.toml")
    assert not calibration.quality.accepted
    assert calibration.quality.problems == ["Not covered."]
    assert calibration.serial is None
    records = [(file.name, file.samples, file.previous_v) for file in calibration.made.records]
    assert records == [("a.csv", 12, 75.0), ("a.csv", 9, None)]
    assert calibration.made.records[0].sha256 == hashlib.sha256(b"t_s,u_V,y_um\n").hexdigest()


def test_the_hash_is_of_the_content_and_not_of_comments_and_order(saved: Path) -> None:
    table = tomllib.loads(saved.read_text(encoding="utf-8"))
    written = table.pop("sha256")
    assert written == content_hash(table) == Calibration.load(saved).sha256
    assert table["schema"] == SCHEMA
    lines = saved.read_text(encoding="utf-8").splitlines()
    saved.write_text("\n".join(["# bench 3", lines[1], lines[0], *lines[2:]]), encoding="utf-8")
    assert Calibration.load(saved) == a_calibration()


def test_an_edited_or_shortened_file_is_refused(saved: Path) -> None:
    text = saved.read_text(encoding="utf-8")
    saved.write_text(text.replace("high_v = 150.0", "high_v = 149.0"), encoding="utf-8")
    error = refused(saved)
    assert error.code == "E3643"
    assert "edited or damaged" in error.message
    assert error.where is not None
    assert error.where.source_line.startswith("sha256 = ")
    saved.write_text("\n".join(line for line in text.splitlines() if "sha256" not in line), encoding="utf-8")
    assert refused(saved).code == "E3643"
    for size in range(0, len(text) - 1, 97):
        saved.write_text(text[:size], encoding="utf-8")
        assert refused(saved).code in ("E3641", "E3642", "E3643")


@pytest.mark.parametrize(
    ("name", "code", "message"),
    [
        ("gone.toml", "E3640", ""),
        ("a\0b.toml", "E3640", ""),
        ("", "E3640", "it is a folder"),
        ("pipe.toml", "E3640", "a pipe, a device or a socket"),  # not waited for
        (os.devnull, "E3640", "a pipe, a device or a socket"),
        ("schema = \nx", "E3641", ""),
        ('schema = "edmctl-calibration/3"', "E3642", "has the schema edmctl-calibration/3"),
        ('schema = "other"', "E3642", "is no calibration file"),
        ("schema = 1", "E3642", "is no calibration file"),
        ("x = 1", "E3642", "is no calibration file"),
    ],
)
def test_what_is_no_calibration_file_is_refused(tmp_path: Path, name: str, code: str, message: str) -> None:
    """A name of a file, or what a file holds."""
    os.mkfifo(tmp_path / "pipe.toml")
    path = tmp_path / name
    if " = " in name:
        path = tmp_path / "c.toml"
        path.write_text(name, encoding="utf-8")
    error = refused(path)
    assert error.code == code
    assert message in error.message
    assert ("Update edmctl" in error.hint) is ("/3" in name)
    if code == "E3641":
        assert place_of(error) == ("c.toml", 1, 10)


def test_a_new_calibration_takes_the_place_of_the_old_one(saved: Path) -> None:
    calibration_of(an_identification(), Made(utc="now", edmctl="9")).save(saved)
    assert Calibration.load(saved).made.edmctl == "9"
    assert [path.name for path in saved.parent.iterdir()] == ["actuator.toml"]
    beside = saved.parent / "beside"
    beside.touch()
    assert saved.stat().st_mode == beside.stat().st_mode  # readable as files of this user are


def test_a_full_disk_leaves_the_old_calibration(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: int) -> None:
        raise OSError(28, "No space left on device")

    before = saved.read_bytes()
    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(RunFileError, match="No space left") as refusal:
        a_calibration().save(saved)
    assert refusal.value.code == "E9012"
    assert saved.read_bytes() == before
    assert [path.name for path in saved.parent.iterdir()] == ["actuator.toml"]
    with pytest.raises(RunFileError):
        a_calibration().save(saved / "c.toml")  # a file is in the way of the folder


def test_the_nearest_word_decides_which_file_is_used(tmp_path: Path) -> None:
    environ = {"EDMCTL_HOME": str(tmp_path)}
    own = kept_path("calibration", "SIM-7", environ)
    assert own == tmp_path / "calibration" / "SIM-7.toml"
    assert kept_path("calibration", "a/../b", environ).parent == own.parent
    assert kept_path("calibration", "SIM-7", {}).parts[-3:] == ("edmctl", "calibration", "SIM-7.toml")
    assert find_kept("calibration", environ, None, "SIM-7") is None
    a_calibration().save(own)
    asked, setup, option = environ | {"EDMCTL_CALIBRATION": "/environ.toml"}, "/setup.toml", Path("/o.toml")
    assert find_kept("calibration", environ, None, "SIM-8") is None
    assert find_kept("calibration", environ, None, "SIM-7") == own
    assert find_kept("calibration", environ, setup, "SIM-7") == Path(setup)
    assert find_kept("calibration", asked, setup, "SIM-7") == Path("/environ.toml")
    assert find_kept("calibration", asked, setup, "SIM-7", option) == option


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("model.slopes_um_per_v", [[1.0, 1.0, -1e-9]] * 4, "slopes are not negative"),
        ("model.slopes_um_per_v", [[1.0, 1.0, 1.0]] * 3, "do not fit"),
        ("model.slopes_um_per_v", [[1.0, 1.0, 1.0], [1.0]] * 2, "do not fit"),
        ("model.slopes_um_per_v", [], "do not fit"),
        ("model.thresholds_v", [0.0, 2.0, float("nan"), 3.0], "finite"),
        ("model.thresholds_v", [], "do not fit"),
        ("model.thresholds_v", [0.0, "1"], "valid number"),
        ("model.knots_v", [[3.0, 2.0, 1.0, 0.0]] * 4, "knots of a play ascend"),
        ("model.creep_plays", [0], "do not fit"),
        ("model.creep_plays", [0, 10**30], "less than"),
        ("model.time_constants_s", [0.0, 1.0, 2.0], "time constants are positive"),
        ("model.zero_um", float("inf"), "finite"),
        ("model.extra", 0.0, "Extra inputs"),
        ("model.slopes_um_per_v", [[1e30, 1.0, 1.0]] * 4, "slopes up to 1e"),
        ("model.slopes_um_per_v", [[1e-7] * 3] * 4, "µm of creep on"),
        ("model.slopes_um_per_v", [[90.0] * 3] * 4, "a stroke of"),
        ("model.creep_um_per_v", [[3.0] * 3] * 2, "µm of creep on"),
        ("model.thresholds_v", [0.0, 1.0, 2.0, 1e6], "voltages up to 1e"),
        ("model.time_constants_s", [1e-9, 1.0, 2.0], "time constants of 1e-09 s"),
        ("model.delay_s", 60.0, "a delay of 60 s"),
        ("model.lag_s", 60.0, "a lag of 60 s"),
        ("model.zero_um", 1e9, "a zero of 1e"),
        ("model.high_v", 2000.0, "a range of 0 V to 2000 V"),
        ("quality.stroke_um", 30_000.0, "a stated stroke of 3e"),
        ("quality.problems", ["A knock: measure again."], "accepted with 1 problems"),
        ("quality.held_out.rms_pct", 0.01, "errors of held_out that contradict each other"),
        ("quality.train.rms_um", 5.0, "errors of train that contradict each other"),
    ],
)
def test_a_model_that_cannot_be_used_is_refused(saved: Path, place: str, value: object, message: str) -> None:
    def change(table: dict[str, object]) -> None:
        *parts, key = place.split(".")
        for part in parts:
            table = table[part]  # type: ignore[assignment]
        table[key] = value

    error = refused(rewritten(saved, change))
    assert error.code == "E3644"
    assert message in error.message
    assert error.where is not None


def test_the_page_tells_every_key() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for table in (Made, MeasuredFile, Parameters, Quality, Figures, Spread):
        for name, field in table.model_fields.items():
            assert re.search(
                rf"^\| `{name}` \| [a-z ]+ \| {re.escape(str(field.description))} \|$", page, re.M
            )
    assert f"`{SCHEMA}`" in page
    assert f"`{BEYOND_PLAYS}`" in page


def test_the_hash_of_the_page_is_that_of_the_file(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    monkeypatch.chdir(saved.parent)
    saved.rename("calibration.toml")
    exec(compile(example, "calibration-file.md", "exec"), {})
