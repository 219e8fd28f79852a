"""Study files: what is refused, where it is blamed, and what is planned."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import pytest

from edmctl.errors import ProfileError, UsageError
from edmctl.profile.folders import find_study, shipped_studies
from edmctl.study.planning import plan_study
from edmctl.study.report import file_stem
from edmctl.study.results import RunKind
from edmctl.study.study_file import read_study
from tests.study.studies import FULL, HEAD, RESPONSES, SMALL, TWO_FACTORS, written
from tests.tiers import tiers

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.study.results import StudyPlan

RANGES = """
[[factors]]
key = "servo.reference"
name = "reference"
low = 0.70
high = 0.86

[[factors]]
key = "pulse.duty"
name = "duty"
low = 0.2
high = 0.4

[[factors]]
key = "pulse.current_a"
name = "current"
low = 0.06
high = 0.12
scale = "log"
"""


def planned(folder: Path, text: str) -> StudyPlan:
    return plan_study(read_study(written(folder, text))).plan


def with_levels(text: str) -> str:
    """SMALL with other values of its first factor."""
    return SMALL.replace("levels = [0.7, 0.8]", text)


def on_machine(text: str) -> str:
    """SMALL on a machine that lasts."""
    return f"{SMALL}\n[machine]\n{text}\n"


ARCS = SMALL + "\n[[responses]]\nname = 'arc_share'\n\n[[constraints]]\nresponse = 'arc_share'\n"
WORN = SMALL.replace('"target.depth_um=5"', '"target.depth_um=5", "tool.max_wear_um=8"')
REFUSED = [
    (with_levels("levels = [0.7, 0.8]\nlow = 0.7"), "E3013", "[[factors]]", "either"),
    (with_levels("levels = [0.8]"), "E3013", "levels = [0.8]", "two or more"),
    (with_levels("low = 0.8\nhigh = 0.7"), "E3013", "low = 0.8", "not below"),
    (SMALL.replace("[0.2, 0.4]", "[0.2, 0.20]"), "E3013", "levels", "two or more different"),
    *(
        (SMALL.replace('"duty"', f'"{name}"'), "E3013", f'name = "{name}"', "cannot be called")
        for name in ("block", "mean", "error", "total")
    ),
    (SMALL.replace("pulse.duty", "servo.reference"), "E3013", 'key = "servo.reference"', "twice"),
    (SMALL.replace("wear_ratio_lin", "wear_ratio"), "E3013", 'name = "wear_ratio"', "no job answers"),
    (SMALL.replace('name = "ra_um"', 'name = "state"'), "E3013", 'name = "state"', "has that name already"),
    (SMALL.replace('response = "machining', 'response = "depth'), "E3013", "response =", "none of the"),
    (SMALL.replace('kind = "full"', 'kind = "bbd"'), "E3013", 'kind = "bbd"', "3 to 7"),
    (SMALL.replace('kind = "full"', 'kind = "full"\nruns = 9'), "E3013", "runs = 9", "runs says nothing"),
    (SMALL.replace(FULL, "[design]\nkind = 'full'\nblocks = 4\n"), "E3013", "blocks", "would hide"),
    (SMALL.replace('kind = "full"', 'kind = "ful"'), "E3006", 'kind = "ful"', "not one of the choices"),
    (SMALL.replace("[design]", "[plan]"), "E3002", "", "design is missing"),
    (SMALL.replace("duty", "dutty"), "E3003", 'key = "pulse.dutty"', "unknown key"),
    (SMALL.replace("0.2, 0.4", "0.2, 0.95"), "E3", 'key = "pulse.duty"', "at reference = "),
    (SMALL.replace("log.pulses='off'", "log.pulse='off'"), "E3003", "log.pulse", "unknown key"),
    (with_levels("levels = [0.7, 0.8]\nstep = 0.1"), "E3013", "step = 0.1", "step says nothing"),
    (with_levels("low = 0.7\nhigh = 0.8\nstep = 0.3"), "E3013", "step = 0.3", "fewer than two multiples"),
    (on_machine("holes_per_tool = 2"), "E3013", "holes_per_tool", "leave none"),
    (on_machine("columns = 2\nrows = 1"), "E3013", "columns", "2 places for 6 runs"),
    (on_machine("pitch_x_um = 200.0"), "E3013", "pitch_x_um", "run into each other"),
    (on_machine("first_x_um = 100.0"), "E3013", "first_x_um", "lies on the reference pad"),
    (f"{WORN}\n[machine]\nholes_per_tool = 12\n", "E3013", "holes_per_tool", "tool 1 would lose"),
    (SMALL.replace('lin"', 'lin"\nlow = 0.0'), "E3013", "low = 0.0", "no hand tells"),
    (SMALL.replace('"µm"', '"µm"\nlow = 6.0\nhigh = 5.0'), "E3013", "low = 6.0", "is not below high"),
    (ARCS + "at_most = 4\n", "E3013", "at_most = 4", "arc_share lies between 0 and 1; write 0.04"),
    (ARCS + "at_least = -0.1\n", "E3013", "at_least = -0.1", "lies between 0 and 1; correct it"),
    (
        ARCS.replace("response = 'arc_share'", "response = 'machining_time_s'") + "at_most = -1\n",
        "E3013",
        "at_most = -1",
        "machining_time_s is never below 0; correct it",
    ),
    (
        SMALL.replace("log = true", "better = 'nominal'\ntarget = -3.0"),
        "E3013",
        "target = -3.0",
        "is never below 0; correct it",
    ),
]


@pytest.mark.parametrize(("text", "code", "line", "says"), REFUSED)
def test_what_is_wrong_is_blamed_on_its_place(
    tmp_path: Path, text: str, code: str, line: str, says: str
) -> None:
    says, _, hint = says.partition("; ")
    with pytest.raises(ProfileError) as refused:
        planned(tmp_path, text)
    assert any(
        one.code.startswith(code)
        and says in one.message
        and hint in one.hint
        and (one.where is None or line in one.where.source_line)
        for one in refused.value.diagnostics
    ), refused.value.diagnostics


@pytest.mark.parametrize(
    "text",
    [
        on_machine("holes_per_tool = 6\nfirst_x_um = 600.0"),
        on_machine("holes_per_tool = 2\ncenter_runs = false"),
        *(f"{ARCS}{bound}\n" for bound in ("at_most = 0.04", "at_most = 1.0", "at_least = 0")),
    ],
)
def test_what_can_be_is_planned(tmp_path: Path, text: str) -> None:
    assert planned(tmp_path, text).runs


@pytest.mark.parametrize(
    ("profile", "kind", "name"),
    [("foil-through", "through", "depth_um"), ("channel-rectangle", "channel", "wear_ratio_lin")],
)
def test_a_response_that_a_target_never_has_is_refused(
    tmp_path: Path, profile: str, kind: str, name: str
) -> None:
    text = f"""
[study]
name = "A kind of job"
profile = "{profile}"

[[factors]]
key = "pulse.frequency_hz"
name = "frequency"
levels = [2000.0, 2300.0]

[[responses]]
name = "RESPONSE"
{FULL}"""
    with pytest.raises(ProfileError, match=f"a job of the kind {kind} has no {name}") as refused:
        planned(tmp_path, text.replace("RESPONSE", name))
    assert "such as wear_um or time_s" in refused.value.hint
    assert planned(tmp_path, text.replace("RESPONSE", "wear_um")).runs


def test_a_profile_is_no_study(tmp_path: Path) -> None:
    file = tmp_path / "profile.toml"
    file.write_text('[target]\nkind = "depth"\n', encoding="utf-8")
    with pytest.raises(ProfileError, match="is a profile"):
        read_study(file)
    with pytest.raises(UsageError) as absent:
        find_study(str(tmp_path / "none.toml"))
    assert absent.value.code == "E2100"


@pytest.mark.parametrize(
    ("design", "factors", "points"),
    [
        ('kind = "full"', TWO_FACTORS, 4),
        ('kind = "fractional"\nresolution = 3', TWO_FACTORS + RANGES.split("\n\n")[-1], 4),
        ('kind = "fractional"\ngenerators = ["C = AB"]', TWO_FACTORS + RANGES.split("\n\n")[-1], 4),
        ('kind = "taguchi"', TWO_FACTORS, 4),
        ('kind = "bbd"', RANGES, 12),
        ('kind = "ccd"', RANGES, 14),
        ('kind = "lhs"\nruns = 7', RANGES, 7),
        ('kind = "sobol"\nruns = 6', RANGES, 6),
        ('kind = "sensitivity"\nbase = 2', RANGES, 10),
    ],
)
def test_a_design_has_its_points(tmp_path: Path, design: str, factors: str, points: int) -> None:
    plan = planned(tmp_path, f"{HEAD}{factors}\n[design]\n{design}\n{RESPONSES}")
    assert len({run.point for run in plan.runs}) == len(plan.runs) == points
    bounds = {one.key: (min(one.values), max(one.values)) for one in plan.factors}
    for run in plan.runs:
        for key, value in run.settings.items():
            low, high = bounds[key]
            assert low <= value <= high  # type: ignore[operator]


def test_replicates_blocks_and_centre_points_have_their_machines(tmp_path: Path) -> None:
    design = "kind = 'lhs'\nruns = 6\nreplicates = 2\nblocks = 2\ncenter_points = 3"
    text = f"{HEAD}{RANGES}\n[design]\n{design}\n{RESPONSES}"
    plan = planned(tmp_path, text + "\n[analysis]\nmodel = 'main'\n")
    assert len(plan.runs) == 2 * (6 + 2)
    assert Counter(run.seed for run in plan.runs) == {1: 4, 2: 4, 3: 4, 4: 4}
    assert [run.block for run in plan.runs] == [run.seed for run in plan.runs]
    assert sum(run.kind is RunKind.CENTER for run in plan.runs) == 4
    of_points = Counter(run.point for run in plan.runs)
    assert sorted(of_points.values()) == [2] * 6 + [4]
    (center,) = {tuple(run.settings.values()) for run in plan.runs if run.kind is RunKind.CENTER}
    assert center == (0.78, 0.3, 0.08485)
    again = planned(tmp_path, text + "\n[analysis]\nmodel = 'main'\n")
    assert again == plan


def test_blocks_of_two_levels_hide_the_longest_product(tmp_path: Path) -> None:
    factors = "\n".join(
        f"[[factors]]\nkey = '{key}'\nlevels = {levels}"
        for key, levels in (
            ("servo.reference", [0.7, 0.8]),
            ("pulse.duty", [0.2, 0.3]),
            ("pulse.current_a", [0.08, 0.12]),
        )
    )
    plan = planned(tmp_path, f"{HEAD}{factors}\n[design]\nkind = 'full'\nblocks = 2\n{RESPONSES}")
    product: dict[int, set[int]] = {}
    for run in plan.runs:
        signs = [run.settings[one.key] == one.values[1] for one in plan.factors]
        product.setdefault(run.block, set()).add(sum(signs) % 2)
    assert all(len(found) == 1 for found in product.values())
    assert len(product) == 2
    assert any("ABC" in note for note in plan.notes)


def test_a_machine_has_tools_as_blocks_with_centre_runs_at_their_ends(tmp_path: Path) -> None:
    text = SMALL.replace(FULL, FULL + "replicates = 2\n") + "\n[machine]\nholes_per_tool = 6\n"
    plan = planned(tmp_path, text)
    assert [run.tool for run in plan.runs] == [1] * 6 + [2] * 6
    assert [run.block for run in plan.runs] == [run.tool for run in plan.runs]
    for tool in (1, 2):
        own = [run.kind for run in plan.runs if run.tool == tool]
        assert own[0] is own[-1] is RunKind.CENTER
        assert RunKind.CENTER not in own[1:-1]
    assert plan.costs is not None
    assert len(plan.costs.tool_wear_um) == 2


@pytest.mark.parametrize("file", tiers(*shipped_studies()))
def test_shipped_studies_can_be_planned(file: str) -> None:
    path = shipped_studies()[file]
    assert plan_study(read_study(path)).plan.runs


def test_equal_settings_are_one_point_that_a_virtual_machine_makes_once(tmp_path: Path) -> None:
    three = TWO_FACTORS.replace("[0.2, 0.4]", "[0.2, 0.3, 0.4]")
    text = f"{HEAD}{three}\n[design]\nkind = 'taguchi'\narray = 'L18 (2^1 3^7)'\n{{more}}{RESPONSES}"
    plan = planned(tmp_path, text.format(more=""))
    assert len(plan.runs) == plan.points == 6
    assert any("18 points have 6 different settings" in note for note in plan.notes)
    own = planned(tmp_path, text.format(more="seeds = 'run'\n"))
    assert (len(own.runs), own.points) == (18, 6)
    assert len({run.seed for run in own.runs}) == 18
    lasting = planned(tmp_path, text.format(more="") + "\n[machine]\n")
    assert (len(lasting.runs) - 2, lasting.points) == (18, 7)
    steps = RANGES.replace("high = 0.4", "high = 0.4\nstep = 0.1").split("\n\n")[:2]
    coarse = planned(tmp_path, f"{HEAD}{steps[1]}\n[design]\nkind = 'lhs'\nruns = 9\n{RESPONSES}")
    assert len(coarse.runs) == coarse.points == 3


def test_a_fraction_of_resolution_five_tells_products_where_the_error_is_left(tmp_path: Path) -> None:
    keys = ("servo.reference", "pulse.duty", "pulse.current_a", "jump.height_um", "measure.dwell_s")
    bounds = ((0.7, 0.8), (0.2, 0.3), (0.08, 0.12), (50.0, 60.0), (0.1, 0.2))
    factors = "".join(
        f"[[factors]]\nkey = '{key}'\nlow = {low}\nhigh = {high}\n"
        for key, (low, high) in zip(keys, bounds, strict=True)
    )
    text = f"{HEAD}{factors}[design]\nkind = 'fractional'\nresolution = 5\n{RESPONSES}"
    assert planned(tmp_path, text).model == "main"  # ten products would leave nothing for the error
    twice = planned(tmp_path, text.replace("resolution = 5", "resolution = 5\nreplicates = 2"))
    assert (twice.model, twice.dof["error"]) == ("interactions", 15)


def test_an_optimisation_without_runs_is_told(tmp_path: Path) -> None:
    plan = planned(tmp_path, SMALL + "\n[optimize]\nruns = 4\n")
    assert any("leaves 0 suggestions after the 4 runs" in note for note in plan.notes)


def test_values_in_steps_are_multiples_within_the_bounds(tmp_path: Path) -> None:
    text = f"{HEAD}{RANGES}\n[design]\nkind = 'lhs'\nruns = 12\n{RESPONSES}"
    plan = planned(tmp_path, text.replace("high = 0.4", "high = 0.4\nstep = 0.07"))
    assert {run.settings["pulse.duty"] for run in plan.runs} == {0.21, 0.28, 0.35}


def test_a_misspelt_study_is_guessed(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as absent:
        find_study("taguchi-l8")
    assert "Did you mean taguchi-l9?" in absent.value.hint
    with pytest.raises(UsageError) as absent:
        find_study(str(tmp_path / "quite-another.toml"))
    assert "Did you mean" not in absent.value.hint


def test_all_mistakes_come_at_once(tmp_path: Path) -> None:
    text = (
        SMALL.replace('name = "reference"', 'title = "reference"')
        .replace('key = "pulse.duty"', 'key = "pulse.dutty"')
        .replace('name = "wear_ratio_lin"', 'name = "wear_ratio"')
        .replace("[[objectives]]", "[[objectives]]\nweight = -1")
        .replace('kind = "full"', 'kind = "full"\nruns = 9')
        + "\n[[factors]]\nkey = 'pulse.current_a'\nlow = 0.1\nhigh = 50.0\n"
        + "\n[[constraints]]\nresponse = 'arc_share'\nat_most = 4\n"
        + "\n[optimise]\nruns = 3\n"
    )
    with pytest.raises(ProfileError) as refused:
        planned(tmp_path, text)
    found = [(one.code, one.message) for one in refused.value.diagnostics]
    for code, says in (
        ("E3003", "unknown key factors[0].title"),
        ("E3003", "unknown key pulse.dutty"),
        ("E3003", "unknown key optimise"),
        ("E3005", "objectives[0].weight"),
        ("E3005", "pulse.current_a = 50"),
        ("E3013", "no job answers wear_ratio"),
        ("E3013", "runs says nothing"),
        ("E3013", "arc_share is none of the responses"),
        ("E3013", "arc_share lies between"),
    ):
        assert any(one == code and says in message for one, message in found), (says, found)
    assert len(found) == 9
    lines = [one.where.line for one in refused.value.diagnostics if one.where is not None]
    assert lines == sorted(lines)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (SMALL.replace("levels = [0.7, 0.8]", "levles = [0.7, 0.8]"), "E3003"),
        (SMALL.replace("levels = [0.7, 0.8]", 'levels = "0.7"'), "E3004"),
        (SMALL.replace('key = "servo.reference"\n', ""), "E3002"),
        (SMALL.replace('name = "machining_time_s"', 'name = "machining time"'), "E3005"),
        (SMALL.replace('response = "machining_time_s"', "response = 3"), "E3004"),
        (SMALL.replace('kind = "full"', 'kind = "ful"'), "E3006"),
        (SMALL.replace('kind = "full"', ""), "E3002"),
        (
            SMALL.replace('profile = "cu270"', 'profil = "cu270"').replace("[design]", "[design]\nseed = 3"),
            "E300",
        ),
        (SMALL.replace(FULL, ""), "E3002"),
        (SMALL + "\n[[machine]]\nrows = 3\n", "E3004"),
    ],
)
def test_what_is_wrong_is_said_once(tmp_path: Path, text: str, code: str) -> None:
    """A key that is misspelt is not also told as one that is missing."""
    with pytest.raises(ProfileError) as refused:
        planned(tmp_path, text)
    places = [one.where for one in refused.value.diagnostics]
    assert all(one.code.startswith(code) for one in refused.value.diagnostics)
    assert len(places) <= 2


@pytest.mark.parametrize(("holes", "is_noted"), [(3, True), (6, False)])
def test_a_plan_of_many_centre_runs_says_so(tmp_path: Path, holes: int, is_noted: bool) -> None:
    plan = planned(tmp_path, f"{SMALL}\n[machine]\nholes_per_tool = {holes}\n")
    centers = sum(run.kind is RunKind.CENTER for run in plan.runs)
    assert (f"{centers} of {len(plan.runs)} holes are centre runs" in " ".join(plan.notes)) is is_noted


def test_a_technology_table_has_plain_names() -> None:
    assert file_stem("Sheet: smooth – quick, 3 Faktoren!") == "sheet-smooth-quick-3-faktoren"
