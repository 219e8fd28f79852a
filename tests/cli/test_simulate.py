"""`edmctl simulate`: many seeds through the whole stack."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from edmctl import failures
from edmctl.errors import UsageError
from edmctl.jobs.batch import summarize
from edmctl.jobs.sweep import sweep_overrides
from edmctl.labels import Basis, Verdict
from edmctl.results.job import SimulatedRun, SimulatedSite, SiteTruth
from tests.cli.commands import SHALLOW, Here, in_process_of_its_own


def run(seed: int, depth_um: float, true_um: float, *, ok: bool = True) -> SimulatedRun:
    return SimulatedRun(
        seed=seed,
        ok=ok,
        exit_code=0 if ok else 7,
        error=None if ok else "missed",
        machining_time_s=900.0 + seed,
        time_s=1000.0 + seed,
        sites=(site("hole", depth_um, true_um),),
    )


def site(name: str, depth_um: float, true_um: float, basis: Basis = Basis.TOUCHED) -> SimulatedSite:
    return SimulatedSite(
        name=name,
        depth_um=depth_um,
        depth_u95_um=1.0,
        wear_um=70.0,
        wear_u95_um=2.0,
        measuring_stops=2,
        depth_basis=basis,
        wear_basis=basis,
        verdict=Verdict.SHOWN,
        truth=SiteTruth(true_um, 70.5),
    )


def test_a_case_sums_up_the_holes_of_its_runs() -> None:
    case = summarize("cu270", (), [run(1, 180.0, 179.5), run(2, 181.0, 179.5), run(3, 179.0, 179.5)])
    depth, error = case.spreads["depth_um"], case.spreads["depth_error_um"]
    assert (depth.mean, depth.sd, depth.minimum, depth.maximum) == (180.0, 1.0, 179.0, 181.0)
    assert error.mean == pytest.approx(0.5)
    assert (case.coverage, case.failed) == ({"depth": pytest.approx(2 / 3), "wear": 1.0}, 0)
    both = replace(run(1, 20.0, 20.2), sites=(site("a", 20.0, 20.2), site("b", 21.0, 19.5)))
    array = summarize("array", (), [both])
    assert (array.spreads["depth_um"].mean, array.truth["depth_um"].minimum) == (20.5, 19.5)
    assert array.coverage["depth"] == 0.5


def test_runs_without_a_hole_only_count_as_failed() -> None:
    failed = SimulatedRun(2, ok=False, exit_code=6, error="fault")
    case = summarize("cu270", (), [run(1, 180.0, 180.0), failed])
    assert (case.failed, case.spreads["depth_um"].mean) == (1, 180.0)
    assert math.isnan(case.spreads["depth_um"].sd)  # one value has none
    none = summarize("cu270", (), [failed])
    assert (none.spreads, none.truth) == ({}, {})


def test_a_spread_is_over_values_of_one_basis() -> None:
    holes = (
        site("a", 20.1, 20.2),
        site("b", 19.7, 19.5),
        *(site(name, 20.0, 20.4, Basis.ESTIMATED) for name in "cd"),
        site("e", 21.0, 20.4, Basis.MODEL),
    )
    case = summarize("array", (), [replace(run(1, 20.0, 20.0), sites=holes)])
    assert (case.spreads["depth_um"].minimum, case.spreads["depth_um"].maximum) == (19.7, 20.1)
    assert case.spreads["depth_error_um"].mean == pytest.approx(0.05)
    assert (case.estimated["depth_um"].mean, case.estimated["depth_um"].sd) == (20.0, 0.0)
    assert case.estimated["depth_error_um"].mean == pytest.approx(-0.4)
    assert case.by_model["depth_um"].mean == 21.0
    assert "depth_um" not in summarize("cu270", (), []).estimated


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("servo.reference=0.7:0.9:3", ("0.7", "0.8", "0.9")),
        ("measure.touches=1:5:3", ("1", "3", "5")),
        ("jump.period_s=10:5:2", ("10", "5")),
        ("jump.period_s=10:5:3", ("10.0", "7.5", "5.0")),
        ("servo.hysteresis=1e-3:3e-3:2", ("0.001", "0.003")),
    ],
)
def test_a_sweep_has_equal_steps_and_both_ends(text: str, values: tuple[str, ...]) -> None:
    assert [one.partition("=")[2] for one in sweep_overrides(text)] == list(values)


@pytest.mark.parametrize(
    "text",
    [
        "servo.reference",
        "a=1:2",
        "a=1:2:1",
        "a=x:2:3",
        "a=1:2:3.5",
        "a=nan:2:3",
        "a=1:inf:3",
        "a=1:2:9999",
        "a=2:2:2",
    ],
)
def test_a_bad_sweep_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="--sweep"):
        sweep_overrides(text)


@pytest.mark.slow
def test_many_seeds_are_the_same_whether_side_by_side_or_alone(here: Here, tmp_path: Path) -> None:
    many = in_process_of_its_own(
        "simulate", *SHALLOW, "--runs", "2", "--seed", "4", "--out", "runs", "--json", cwd=tmp_path
    )
    assert many.exit_code == 0
    (case,) = many.document["result"]["cases"]
    assert [r["seed"] for r in case["runs"]] == [4, 5]
    assert set(case["spreads"]["depth_um"]) == {"mean", "sd", "minimum", "maximum"}
    assert set(case["truth"]) == {"depth_um", "wear_um"}
    assert set(case["truth"]["depth_um"]) == {"mean", "sd", "minimum", "maximum"}
    for row in case["runs"]:
        assert row["truth"]["depth_um"] == pytest.approx(row["depth_um"], abs=3.0)
    assert not [key for holder in (case["spreads"], *case["runs"]) for key in holder if "true" in key]
    assert set(case["coverage"]) == {"depth", "wear"}
    assert {p.name for p in (tmp_path / "runs").glob("*.h5*")} == {"cu270-seed4.h5", "cu270-seed5.h5"}

    alone = here("simulate", *SHALLOW, "--runs", "1", "--seed", "5", "--json").document
    assert alone["result"]["cases"][0]["runs"][0] == case["runs"][1]
    assert not Path("runs").exists()


def test_dry_run_forecasts_every_value_and_runs_nothing(here: Here) -> None:
    arguments = ("simulate", "--profile", "cu270", "--dry-run", "--sweep", "target.depth_um=100:120:2")
    said = here(*arguments, "--runs", "1", "--seed", "3")
    assert said.exit_code == 0
    header, *rows = said.out.splitlines()
    assert "whole job" in header
    assert [row.split()[:2] for row in rows] == [
        ["target.depth_um=100", "100.00"],
        ["target.depth_um=120", "120.00"],
    ]
    assert "W2003" in said.err
    assert "seed 3" in said.err  # all values run on one machine
    several = here(*arguments, "--sweep", "servo.reference=0.7:0.8:2", "--out", "runs", "--json").document
    assert several["warnings"] == []
    cases = several["result"]["cases"]
    assert [(case["label"], case["forecast"]["depth_um"]) for case in cases] == [
        ("target.depth_um=100 servo.reference=0.7", 100.0),
        ("target.depth_um=100 servo.reference=0.8", 100.0),
        ("target.depth_um=120 servo.reference=0.7", 120.0),
        ("target.depth_um=120 servo.reference=0.8", 120.0),
    ]
    assert cases[1]["overrides"] == ["target.depth_um=100", "servo.reference=0.8"]
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize(
    ("words", "exit_code", "told"),
    [
        ("--sweep servo.reference=0.5:0.9:3", 3, "servo.reference=0.5"),
        (
            "--sweep target.depth_um=100:120:2 --sweep pulse.current_a=-0.5:1:2",
            3,
            "--> --sweep:1:17\n1 | pulse.current_a=-0.5:1:2",
        ),
        ("--sweep servo.referenc=0.7:0.8:2", 3, "--> --sweep:1:7\n1 | servo.referenc=0.7:0.8:2"),
        ("--set servo.gain=1 --sweep target.depth_um=8:9:2", 3, "--> --set:1:"),
        ("--sweep jump.period_s=1:2:2 --sweep jump.period_s=3:4:2", 2, "Two sweeps go over jump.period_s."),
        ("--sweep jump.period_s=1:2:100 --sweep jump.dwell_ms=1:9:99 --runs 100", 2, "are 990000 runs"),
        (
            "--sweep jump.period_s=1:2:100 --sweep jump.dwell_ms=1:9:99 --runs 100",
            2,
            "Take --runs 10 or fewer",
        ),
        ("--sweep jump.period_s=1:2:900 --sweep jump.dwell_ms=1:9:999", 2, "= help: Take fewer values."),
        ("--runs 1 --seed 4 --out .", 9, "E9001"),
    ],
)
def test_what_cannot_be_simulated_is_refused_before_the_first_run(
    here: Here, words: str, exit_code: int, told: str
) -> None:
    Path("cu270-seed4.h5").write_bytes(b"precious")
    said = here("simulate", *SHALLOW, *words.split())
    assert said.exit_code == exit_code
    assert told in said.err
    assert [path.name for path in Path().iterdir()] == ["cu270-seed4.h5"]


def test_without_a_compiler_no_run_is_counted(here: Here, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise failures.no_compiler(install="pip")

    monkeypatch.setattr("edmctl.core.library.library", refuse)
    said = here("simulate", *SHALLOW, "--runs", "2", "--seed", "1")
    assert (said.exit_code, said.out) == (8, "")


def test_failing_runs_are_counted_and_told(here: Here) -> None:
    said = here("simulate", *SHALLOW, "--set", "limits.max_time_s=100", "--runs", "1", "--seed", "2")
    assert said.exit_code == 7
    assert "1 of 1 run failed" in said.err
    assert "1 of 1 run failed." in said.out
    assert "`edmctl machine --seed 2 --profile " in said.err
    assert "--set limits.max_time_s=100`." in said.err


@pytest.mark.slow
def test_channels_are_summed_up_like_holes(here: Here) -> None:
    quick = ("--set", "target.depth_um=4", "--set", "path.radius_um=150")
    said = here("simulate", "--profile", "channel-circle", *quick, "--runs", "2", "--seed", "9200", "--json")
    case = said.document["result"]["cases"][0]
    assert set(case["spreads"]) >= {"depth_um", "wear_um", "machining_time_s"}
    assert case["coverage"]["depth"] == 1.0
    for made in case["runs"]:
        assert abs(made["depth_um"] - made["truth"]["depth_um"]) <= made["depth_u95_um"]
        assert made["cuts"] > 2
        assert [one["name"] for one in made["sites"]] == ["channel-circle"]


@pytest.mark.slow
def test_a_series_has_run_files_a_table_and_a_figure(here: Here, tmp_path: Path) -> None:
    out, table, figure = tmp_path / "series", tmp_path / "cases.csv", tmp_path / "cases.svg"
    swept = ("--sweep", "servo.reference=0.7,0.8", "--runs", "2", "--seed", "3", "--out", str(out))
    whole = here("simulate", *SHALLOW, *swept, "--table", str(table), "--figure", str(figure), "--json", "-q")
    assert whole.exit_code == 0, whole.err
    rows = table.read_text(encoding="utf-8").splitlines()
    assert len(rows) == 3
    assert rows[0].startswith("case,")
    assert {"mrr_mm3_min", "mrr_mm3_min_sd", "wear_ratio_lin", "truth.depth_um"} <= set(rows[0].split(","))
    drawn = figure.read_text(encoding="utf-8")
    assert drawn.startswith("<?xml")
    assert "means of 2 runs a case; bars ± one standard deviation of a run" in drawn
    assert len(list(out.glob("*.h5"))) == 4
    assert here("simulate", *SHALLOW, "--table", str(table)).exit_code == 9
