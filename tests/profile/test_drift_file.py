"""The drift file: exact, hashed, checked; which one a job goes by."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from edmctl.errors import RecordError
from edmctl.jobs.corrections import choose_drift
from edmctl.process.rest_drift import TIME_CONSTANTS_S
from edmctl.profile.drift_file import (
    SCHEMA,
    DriftFile,
    MadeBy,
    Measured,
    Used,
)
from edmctl.profile.folders import kept_path
from edmctl.profile.hashed_file import HASH
from edmctl.profile.setup import Drift, Sensor, Setup, load_setup
from edmctl.profile.tables import content_hash

N = len(TIME_CONSTANTS_S)


def made(serial: str = "SIM-7", days: float = 0.0) -> DriftFile:
    """A file whose numbers have every digit that a float has."""
    covariance = np.diag(np.full(N, 1e-5 / 3.0))
    return DriftFile(
        schema=SCHEMA,
        made=MadeBy(
            utc=(datetime.now(UTC) - timedelta(days=days)).isoformat(timespec="seconds"),
            edmctl="0.1.0",
            serial=serial,
            simulated=True,
            run_file="drift.h5",
        ),
        measured=Measured(
            rest_um_per_s=0.001,
            rest_u_um_per_s=1e-4,
            touch_um_per_s=0.001 / 3.0,
            touch_u_um_per_s=1e-4,
            touches=11,
            rests=24,
            misfit=1.0,
        ),
        used=Used(
            share=1.0 / 3.0,
            share_u=0.1,
            apart_u_um_per_s=7e-4,
            walk_um_per_sqrt_s=0.01,
            time_constants_s=list(TIME_CONSTANTS_S),
            creep=[0.012 + 1e-4 / (k + 3.0) for k in range(N)],
            creep_covariance=covariance.tolist(),
        ),
    )


def test_a_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "own" / "drift.toml"
    made().save(path)
    found = DriftFile.load(path)
    assert found.table() == made().table() | {"made": found.made.model_dump()}
    assert found.model().share == 1.0 / 3.0
    np.testing.assert_array_equal(found.model().creep, made().model().creep)


def edited(path: Path, change: Callable[[dict[str, Any]], None], *, hashed: bool = True) -> str:
    """Change a saved file, with a hash that goes with it or not; the code of the refusal."""
    made().save(path)
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    stated = table.pop(HASH)
    change(table)
    path.write_text(
        tomli_w.dumps({HASH: content_hash(table) if hashed else stated, **table}), encoding="utf-8"
    )
    with pytest.raises(RecordError) as refused:
        DriftFile.load(path)
    assert refused.value.hint
    return refused.value.code


@pytest.mark.parametrize(
    ("table", "values"),
    [
        pytest.param("used", {"share": 1.5}, id="more than all"),
        pytest.param("used", {"share": float("nan")}, id="no number"),
        pytest.param("used", {"creep": [0.5] * N}, id="creep of no actuator"),
        pytest.param("used", {"creep": [0.01]}, id="arrays that do not fit"),
        pytest.param("used", {"creep_covariance": (-np.eye(N)).tolist()}, id="no covariance"),
        pytest.param("used", {"time_constants_s": [1.0]}, id="other constants"),
        pytest.param("used", {"creep_covariance": [[1e-5] * N * N]}, id="covariance in one row"),
        pytest.param("used", {"creep_covariance": [[0.0] * N] * N}, id="creep known exactly"),
        pytest.param("used", {"creep": [0.1, -0.1] * 4 + [0.01]}, id="creep to and fro"),
        pytest.param("used", {"share": 0.9}, id="a share that was not measured"),
        pytest.param("used", {"share": 1.0}, id="all of it, and known"),
        pytest.param("used", {"share_u": 0.0}, id="a share known exactly"),
        pytest.param("used", {"apart_u_um_per_s": 1e-4}, id="what drifted apart is left out"),
        pytest.param("measured", {"touches": 2}, id="two touches"),
        pytest.param("used", {"more": 1.0}, id="a value too many"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, table: str, values: dict[str, Any]) -> None:
    assert edited(tmp_path / "drift.toml", lambda t: t[table].update(values)) == "E3674"


@pytest.mark.parametrize(
    ("touch_um_per_s", "share"),
    [(0.0015, 1.0), (-0.0005, 0.0), (0.0, 0.0)],
    ids=["more", "the other way", "none"],
)
def test_shares_end_at_0_and_1(tmp_path: Path, touch_um_per_s: float, share: float) -> None:
    file = made()
    measured = file.measured.model_copy(update={"touch_um_per_s": touch_um_per_s})
    used = file.used.model_copy(update={"share": share, "apart_u_um_per_s": 0.002})
    file = file.model_copy(update={"measured": measured, "used": used})
    file.save(tmp_path / "d.toml")
    assert DriftFile.load(tmp_path / "d.toml").model().share == share


def test_a_file_that_is_edited_incomplete_no_drift_file_or_missing_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "d.toml"
    assert edited(path, lambda t: t["used"].update(share=0.9), hashed=False) == "E3673"
    assert edited(path, lambda t: t["used"].pop("share_u")) == "E3674"
    assert edited(path, lambda t: t.update(schema="edmctl-drift/2")) == "E3672"
    for text, code in (("share = ", "E3671"), ("", "E3672"), (None, "E3670")):
        path.unlink()
        if text is not None:
            path.write_text(text, encoding="utf-8")
        with pytest.raises(RecordError) as refused:
            DriftFile.load(path)
        assert refused.value.code == code


def test_a_machine_finds_its_own_file_and_a_fresh_one_only_what_is_named(tmp_path: Path) -> None:
    environ = {"EDMCTL_HOME": str(tmp_path)}
    assert choose_drift(environ, Setup(), "SIM-7").model is None
    made().save(kept_path("drift", "SIM-7", environ))
    made().save(kept_path("drift", "SIM-7", environ, lasting=False))
    own = choose_drift(environ, Setup(), "SIM-7")
    assert own.model is not None
    assert str(kept_path("drift", "SIM-7", environ)) in own.text
    assert choose_drift(environ, Setup(), "SIM-7", lasting=False).model is None
    named = environ | {"EDMCTL_DRIFT": str(kept_path("drift", "SIM-7", environ, lasting=False))}
    assert choose_drift(named, Setup(), "SIM-7", lasting=False).model is not None
    unused = Setup(drift=Drift(use=False))
    assert choose_drift(named, unused, "SIM-7").model is None
    assert choose_drift(named, Setup(sensor=Sensor(fitted=False)), "SIM-7").model is None


def test_a_setup_names_a_file_beside_it(tmp_path: Path) -> None:
    made().save(tmp_path / "drift.toml")
    setup = tmp_path / "setup.toml"
    setup.write_text('[drift]\nfile = "drift.toml"\n', encoding="utf-8")
    assert choose_drift({}, load_setup(setup), "SIM-7", lasting=False).model is not None


@pytest.mark.parametrize(
    ("serial", "days", "code"),
    [("SIM-8", 0.0, "W8106"), ("SIM-7", 31.0, "W8107"), ("SIM-7", -1.0, "W8107")],
)
def test_files_of_others_do_not_count(tmp_path: Path, serial: str, days: float, code: str) -> None:
    path = tmp_path / "drift.toml"
    made(serial, days).save(path)
    choice = choose_drift({"EDMCTL_DRIFT": str(path)}, Setup(), "SIM-7")
    assert choice.model is None
    (warning,) = choice.warnings
    assert warning.code == code
    assert "measure-drift" in warning.hint
