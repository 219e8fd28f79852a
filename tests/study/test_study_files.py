"""Study files: their mistakes with code and place, and their plans."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from edmctl.errors import ProfileError, UsageError
from edmctl.profile.folders import find_study, shipped_studies
from edmctl.study.planning import plan_study
from edmctl.study.results import RunKind, StudyPlan
from edmctl.study.study_file import read_study
from tests.study.studies import FULL, HEAD, RESPONSES, SMALL, THREE_FACTORS, TWO_FACTORS, written
from tests.tiers import tiers

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
    (
        SMALL.replace('name = "ra_um"', 'name = "state"'),
        "E3013",
        'name = "state"',
        "a column is called state",
    ),
    (SMALL.replace('response = "machining', 'response = "depth'), "E3013", "response =", "none of the"),
    (SMALL.replace('kind = "full"', 'kind = "bbd"'), "E3013", 'kind = "bbd"', "3 to 7"),
    (SMALL.replace('kind = "full"', 'kind = "full"\nruns = 9'), "E3013", "runs = 9", "runs has no effect"),
    (SMALL.replace(FULL, "[design]\nkind = 'full'\nblocks = 4\n"), "E3013", "blocks", "would hide"),
    (SMALL.replace('kind = "full"', 'kind = "ful"'), "E3006", 'kind = "ful"', "not one of the choices"),
    (SMALL.replace("[design]", "[plan]"), "E3002", "", "design is missing"),
    (SMALL.replace("levels = [0.7", 'levels = "0.7" # ['), "E3004", "levels", "wrong type"),
    (SMALL.replace('key = "servo.reference"\n', ""), "E3002", "[[factors]]", "key is missing"),
    (SMALL.replace('name = "machining_time_s"', 'name = "machining time"'), "E3005", "name", "out of range"),
    (SMALL + "\n[[machine]]\nrows = 3\n", "E3004", "machine", "machine"),
    (SMALL.replace("duty", "dutty"), "E3003", 'key = "pulse.dutty"', "unknown key"),
    (SMALL.replace("0.2, 0.4", "0.2, 0.95"), "E3", 'key = "pulse.duty"', "at reference = "),
    (SMALL.replace("log.pulses='off'", "log.pulse='off'"), "E3003", "log.pulse", "unknown key"),
    (with_levels("levels = [0.7, 0.8]\nstep = 0.1"), "E3013", "step = 0.1", "step has no effect"),
    (with_levels("low = 0.7\nhigh = 0.8\nstep = 0.3"), "E3013", "step = 0.3", "fewer than two multiples"),
    (on_machine("holes_per_tool = 2"), "E3013", "holes_per_tool", "leave none"),
    (on_machine("columns = 2\nrows = 1"), "E3013", "columns", "2 places for 6 runs"),
    (on_machine("pitch_x_um = 200.0"), "E3013", "pitch_x_um", "run into each other"),
    (on_machine("first_x_um = 100.0"), "E3013", "first_x_um", "is on the reference pad"),
    (f"{WORN}\n[machine]\nholes_per_tool = 12\n", "E3013", "holes_per_tool", "tool 1 would lose"),
    (SMALL.replace('lin"', 'lin"\nlow = 0.0'), "E3013", "low = 0.0", "low has no effect"),
    (SMALL.replace('"µm"', '"µm"\nlow = 6.0\nhigh = 5.0'), "E3013", "low = 6.0", "is not below high"),
    (ARCS + "at_most = 4\n", "E3013", "at_most = 4", "arc_share is between 0 and 1; write 0.04"),
    (ARCS + "at_least = -0.1\n", "E3013", "at_least = -0.1", "is between 0 and 1; correct it"),
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


@pytest.mark.parametrize(("text", "code", "line", "message"), REFUSED)
def test_a_mistake_has_its_code_and_place(
    tmp_path: Path, text: str, code: str, line: str, message: str
) -> None:
    message, _, hint = message.partition("; ")
    with pytest.raises(ProfileError) as refused:
        planned(tmp_path, text)
    assert any(
        one.code.startswith(code)
        and message in one.message
        and hint in one.hint
        and (one.where is None or line in one.where.source_line)
        for one in refused.value.diagnostics
    ), refused.value.diagnostics


def test_unknown_keys_and_wrong_values_come_together_and_in_order(tmp_path: Path) -> None:
    text = SMALL.replace('name = "reference"', 'title = "reference"') + "\n[optimise]\nruns = 3\n"
    text = text.replace("[[objectives]]", "[[objectives]]\nweight = -1")
    with pytest.raises(ProfileError) as refused:
        planned(tmp_path, text)
    found = refused.value.diagnostics
    assert [one.code for one in found] == ["E3003", "E3005", "E3003"]
    lines = [one.where.line for one in found if one.where is not None]
    assert lines == sorted(lines)


@pytest.mark.parametrize(
    "text",
    [
        on_machine("holes_per_tool = 6\nfirst_x_um = 600.0"),
        on_machine("holes_per_tool = 2\ncenter_runs = false"),
        *(f"{ARCS}{bound}\n" for bound in ("at_most = 0.04", "at_most = 1.0", "at_least = 0")),
    ],
)
def test_a_possible_study_is_planned(tmp_path: Path, text: str) -> None:
    assert planned(tmp_path, text).runs


@pytest.mark.parametrize(
    ("profile", "kind", "name"),
    [("foil-through", "through", "depth_um"), ("channel-rectangle", "channel", "wear_ratio_lin")],
)
def test_a_response_that_a_target_never_has_is_refused(
    tmp_path: Path, profile: str, kind: str, name: str
) -> None:
    factor = "[[factors]]\nkey = 'pulse.frequency_hz'\nlevels = [2000.0, 2300.0]\n"
    text = f"[study]\nname = 'A kind'\nprofile = '{profile}'\n{factor}[[responses]]\nname = '{{}}'\n{FULL}"
    with pytest.raises(ProfileError, match=f"a job of the kind {kind} has no {name}"):
        planned(tmp_path, text.format(name))
    assert planned(tmp_path, text.format("wear_um")).runs


def test_a_profile_is_no_study_and_a_misspelt_study_is_guessed(tmp_path: Path) -> None:
    file = tmp_path / "profile.toml"
    file.write_text('[target]\nkind = "depth"\n', encoding="utf-8")
    with pytest.raises(ProfileError, match="is a profile"):
        read_study(file)
    for name, is_guessed in ((str(tmp_path / "quite-another.toml"), False), ("taguchi-l8", True)):
        with pytest.raises(UsageError) as absent:
            find_study(name)
        assert absent.value.code == "E2100"
        assert ("Did you mean taguchi-l9?" in absent.value.hint) is is_guessed


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


def test_blocks_of_two_levels_hide_the_longest_product(tmp_path: Path) -> None:
    plan = planned(tmp_path, f"{HEAD}{THREE_FACTORS}\n[design]\nkind = 'full'\nblocks = 2\n{RESPONSES}")
    product: dict[int, set[int]] = {}
    for run in plan.runs:
        signs = [run.settings[one.key] == one.values[1] for one in plan.factors]
        product.setdefault(run.block, set()).add(sum(signs) % 2)
    assert sorted(map(len, product.values())) == [1, 1]
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


def test_an_optimisation_without_runs_is_noted(tmp_path: Path) -> None:
    plan = planned(tmp_path, SMALL + "\n[optimize]\nruns = 4\n")
    assert any("leaves 0 suggestions after the 4 runs" in note for note in plan.notes)


def test_values_in_steps_are_multiples_within_the_bounds(tmp_path: Path) -> None:
    text = f"{HEAD}{RANGES}\n[design]\nkind = 'lhs'\nruns = 12\n{RESPONSES}"
    plan = planned(tmp_path, text.replace("high = 0.4", "high = 0.4\nstep = 0.07"))
    assert {run.settings["pulse.duty"] for run in plan.runs} == {0.21, 0.28, 0.35}
