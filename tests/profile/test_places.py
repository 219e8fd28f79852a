"""Places of holes: what points, grids, circles and files stand for, and what is refused of them."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from edmctl.errors import ProfileError
from edmctl.failures import Code
from edmctl.planning.rules.load import load_profile
from edmctl.profile.places import MOST_PLACES, Place
from tests.planning.rules.documents import marked, place_of, problems, written

GRID = 'sites=[{kind="grid",x_um=500,columns=3,rows=2,dx_um=300,dy_um=400}]'
SHALLOW = ("target.depth_um=20", "jump.height_um=60", "limits.max_time_s=1e5")


def placed(*overrides: str) -> tuple[Place, ...]:
    return load_profile("cu150", (*SHALLOW, *overrides)).places


def where(found: tuple[Place, ...]) -> list[tuple[str, float, float]]:
    return [(place.name, round(place.x_um, 6), round(place.y_um, 6)) for place in found]


def sheet(folder: Path, text: str) -> Path:
    """A profile whose places are in a CSV file beside it."""
    (folder / "places.csv").write_text(text, encoding="utf-8")
    profile = folder / "p.toml"
    profile.write_text(
        'extends = "cu150"\n[meta]\nname = "p"\n[target]\nkind = "depth"\ndepth_um = 20.0\n'
        '[jump]\nheight_um = 60.0\n[[sites]]\nkind = "file"\npath = "places.csv"\n',
        encoding="utf-8",
    )
    return profile


def codes(*overrides: str) -> list[str]:
    return [d.code for d in problems("cu150", *SHALLOW, *overrides)]


def test_a_site_is_a_point_unless_it_says_otherwise() -> None:
    assert placed() == ()
    (first, second) = placed(
        'sites=[{x_um=500},{kind="point",name="b",x_um=900,y_um=-3,theta_deg=30,depth_um=12}]'
    )
    assert (first.name, first.x_um, first.y_um, first.theta_deg) == ("site-1", 500.0, 0.0, 0.0)
    assert math.isnan(first.depth_um)
    assert second == Place("b", 900.0, -3.0, 30.0, 12.0, 1)


def test_a_grid_goes_row_by_row_each_in_the_same_direction() -> None:
    rows = [(x_um, y_um) for y_um in (0.0, 400.0) for x_um in (500.0, 800.0, 1100.0)]
    assert where(placed(GRID)) == [(f"grid-{n}", *row) for n, row in enumerate(rows, 1)]


def test_a_circle_begins_at_its_first_direction_and_goes_from_x_to_y() -> None:
    circle = 'sites=[{kind="circle",name="c",x_um=1000,radius_um=400,count=4,start_deg=90}]'
    points = [(1000.0, 400.0), (600.0, 0.0), (1000.0, -400.0), (1400.0, 0.0)]
    assert where(placed(circle)) == [(f"c-{n}", *point) for n, point in enumerate(points, 1)]


def test_a_file_holds_places_in_columns_of_any_order(tmp_path: Path) -> None:
    text = "\ufeffy_um, x_um,depth_um,name\n0,500,,a\n\n-400.5,900,15,\n"
    found = load_profile(str(sheet(tmp_path, text))).places
    assert where(found) == [("a", 500.0, 0.0), ("site-2", 900.0, -400.5)]
    assert math.isnan(found[0].depth_um)
    assert found[1].depth_um == 15.0


def test_a_file_is_beside_the_profile_that_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    sheet(inner, "x_um,y_um\n500,0\n")
    (tmp_path / "child.toml").write_text('extends = "inner/p.toml"\n', encoding="utf-8")
    monkeypatch.chdir("/")
    assert len(load_profile(str(tmp_path / "child.toml")).places) == 1


@pytest.mark.parametrize(
    ("text", "line", "column", "message", "hint"),
    [
        ("x_um,y_um\n500,0\n9oo,0\n", 3, 1, "x_um = 9oo is no number", "-1e+06 to 1e+06"),
        ("x_um,y_um\n500, nan\n", 2, 6, "y_um = nan is out of range", "a number"),
        ("x_um,y_um\n500,2e6\n", 2, 5, "y_um = 2e6 is out of range", "1e+06"),
        ("x_um,y_um,depth_um\n500,0,-1\n", 2, 7, "depth_um = -1 is out of range", "above 0"),
        ("x_um,y_um\n,0\n", 2, 1, "x_um is missing", "a number"),
        ("x_um,y_um\n500\n", 2, 1, "y_um is missing", "a number"),
        ("x_um;y_um\n500;0\n", 1, 1, "not separated by commas", "x_um,y_um"),
        ("x_um,yum\n500,0\n", 1, 6, "unknown column yum", "did you mean y_um?"),
        ("x_um,y\n500,0\n", 1, 6, "unknown column y", "did you mean y_um?"),
        ("x_um,z_um\n500,0\n", 1, 6, "unknown column z_um", "the columns are name, x_um"),
        ("name,x_um\na,500\n", 1, 1, "the column y_um is missing", "names the columns"),
        ("x_um,y_um,x_um\n1,2,3\n", 1, 11, "two columns x_um", "remove one"),
        ("x_um,y_um\n500,0,3\n", 2, 1, "3 cells under 2 columns", "comma"),
        ('x_um,y_um\n500,"0\n', 2, 1, "no CSV", "names the columns"),
        ("x_um,y_um\n500,\x000\n", 2, 5, "y_um = \x000 is no number", "a number"),
        ("x_um,y_um\n", 1, 1, "holds no places", "each further line"),
        ("", 1, 1, "holds no places", "x_um,y_um"),
    ],
)
def test_a_wrong_line_is_pointed_at(
    tmp_path: Path, text: str, line: int, column: int, message: str, hint: str
) -> None:
    (found,) = problems(sheet(tmp_path, text))
    assert found.code == Code.PLACES_FILE
    assert message in found.message
    assert hint in found.hint
    assert place_of(found) == ("places.csv", line, column)


@pytest.mark.parametrize(
    ("text", "code", "line"),
    [
        ("x_um,y_um\n500,0\n\n900,0\n510,0\n", Code.OVERLAP, 5),
        ("x_um,y_um\n500,0\n10,0\n", Code.OVERLAP, 3),
        ("name,x_um,y_um\na,500,0\nb,900,0\na,1300,0\n", Code.SITES, 4),
        ("x_um,y_um,depth_um\n500,0,\n900,0,205\n", Code.ARRAY_STROKE, 3),
    ],
)
def test_a_rule_about_a_place_points_at_its_line(tmp_path: Path, text: str, code: Code, line: int) -> None:
    (place,) = (place_of(d) for d in problems(sheet(tmp_path, text)) if d.code == code)
    assert place[:2] == ("places.csv", line)


def test_one_table_of_sites_is_told_to_be_a_list(tmp_path: Path) -> None:
    (found,) = problems(written(tmp_path, 'extends = "cu150"\n[sites]\nx_um = 500\n'))
    assert found.hint == "write [[sites]]"
    assert place_of(found)[1] == 2


def test_all_wrong_lines_are_reported_at_once(tmp_path: Path) -> None:
    found = problems(sheet(tmp_path, "x_um,y_um\na,0\n500,b\n"))
    assert [d.code for d in found] == [Code.PLACES_FILE, Code.PLACES_FILE]


@pytest.mark.parametrize(
    ("name", "message"), [("gone.csv", "no file"), (".", "no file"), ("bytes.csv", "not UTF-8")]
)
def test_an_unreadable_file_is_located(tmp_path: Path, name: str, message: str) -> None:
    profile = sheet(tmp_path, "x_um,y_um\n500,0\n")
    profile.write_text(profile.read_text(encoding="utf-8").replace("places.csv", name), encoding="utf-8")
    (tmp_path / "bytes.csv").write_bytes(b"x_um,y_um\n\xff,1\n")
    (found,) = problems(profile)
    assert found.code == Code.PLACES_FILE
    assert message in found.message
    assert place_of(found)[0] == "p.toml"


def test_the_hash_knows_the_places_of_a_file(tmp_path: Path) -> None:
    first = load_profile(str(sheet(tmp_path, "x_um,y_um\n500,0\n")))
    again = load_profile(str(sheet(tmp_path, "y_um,x_um\n0,500.0\n")))
    other = load_profile(str(sheet(tmp_path, "x_um,y_um\n501,0\n")))
    assert first.sha256 == again.sha256
    assert first.sha256 != other.sha256


DEEP = ("target.depth_um=100", "jump.height_um=80", "array.order=given", GRID)


@pytest.mark.parametrize(
    ("overrides", "code", "words", "hint"),
    [
        (
            ('sites=[{name="a",x_um=500},{x_um=900},{name="a",x_um=1300}]',),
            Code.SITES,
            ["called a: (500, 0) and (1300, 0)"],
            "",
        ),
        (
            ("sites=[{x_um=500},{x_um=900},{x_um=685}]",),
            Code.OVERLAP,
            ["site-1 and site-3 are 185 µm apart"],
            "186 µm",
        ),
        # Each hole wears 8.54 µm.
        ((GRID, "tool.max_wear_um=40"), Code.ARRAY_WEAR, ["hole 5 of 6, grid-", "with 4 done"], "51.3 µm"),
        ((GRID, "tool.max_wear_um=8"), Code.TOOL_WEAR, [], ""),
        # Offset 50 and reserve 15 leave 291 µm; the first hole needs 142.7, wear is 42.7 each.
        (
            DEEP,
            Code.ARRAY_STROKE,
            ["hole 5 of 6, grid-5, is out of reach", "wear so far 171 + feed 143"],
            "4 fit",
        ),
        ((*DEEP, "target.depth_um=210"), Code.STROKE, [], ""),
    ],
)
def test_places_that_cannot_all_be_machined_are_named(
    overrides: tuple[str, ...], code: Code, words: list[str], hint: str
) -> None:
    (found,) = problems("cu150", *SHALLOW, *overrides)
    assert found.code == code
    assert found.is_warning == code.startswith("W")
    assert all(word in found.message for word in words)
    assert hint in found.hint
    if code == Code.OVERLAP:
        assert marked(found) == "{x_um=685}"


def test_more_places_than_a_tool_lasts_for_are_refused() -> None:
    assert codes('sites=[{kind="grid",x_um=500,columns=1000,rows=1000,dx_um=300,dy_um=300}]') == [Code.SITES]
    with pytest.raises(ProfileError, match=str(MOST_PLACES)):
        load_profile(
            "cu150", [*SHALLOW, 'sites=[{kind="circle",x_um=0,radius_um=9e5,count=999},{x_um=3},{x_um=4}]']
        )


@pytest.mark.parametrize(
    ("sites", "others", "refused"),
    [
        ("[{x_um=500},{x_um=686}]", (), []),  # hole 150 + 2 x 8 and a wall of 20
        ("[{x_um=500},{x_um=685}]", (), [Code.OVERLAP]),
        ("[{x_um=500},{x_um=500,theta_deg=30}]", (), []),
        ("[{x_um=500},{x_um=500,theta_deg=360}]", (), [Code.OVERLAP]),
        ("[{x_um=500},{x_um=500,theta_deg=0.001}]", (), [Code.OVERLAP]),
        ("[{x_um=500},{x_um=500,theta_deg=359.5}]", (), [Code.OVERLAP]),
        ("[{x_um=0,y_um=208}]", (), []),
        ("[{x_um=0,y_um=207}]", (), [Code.OVERLAP]),
        ("[{x_um=500,depth_um=30}]", (), []),
        ("[{x_um=500,depth_um=30}]", ('target={kind="feed",feed_um=60}',), [Code.TARGET_KIND]),
        ("[{x_um=500,depth_um=203}]", (), []),
        ("[{x_um=500,depth_um=205}]", (), [Code.STROKE]),
        ("[{x_um=500,depth_um=90}]", ("work.thickness_um=80",), [Code.BLIND_DEPTH]),
    ],
)
def test_places_keep_the_rules(sites: str, others: tuple[str, ...], refused: list[Code]) -> None:
    assert codes(f"sites={sites}", *others) == refused


@pytest.mark.parametrize("override", ["sites.x_um=3", "sites[0].x_um=3", "sites [1] = 3"])
def test_one_value_of_a_list_cannot_be_set(override: str) -> None:
    (found,) = problems("cu150", override)
    assert found.code == Code.OVERRIDE
    assert "only the whole of it" in found.message
    assert "sites=[{x_um=600}" in found.hint


@pytest.mark.parametrize(
    ("sites", "code", "blamed", "hint"),
    [
        ("[{x_um=500},{x_um='a'}]", Code.WRONG_TYPE, "'a'", "a number"),
        ("[{x_um=500},{xum=3}]", Code.UNKNOWN_KEY, "xum", "did you mean x_um?"),
        ("[{x_um=500,kind=3}]", Code.NOT_A_CHOICE, "3", '"point" or "grid" or "circle" or "file"'),
        ("[{x_um=500,kind='gird'}]", Code.NOT_A_CHOICE, "'gird'", '"grid"'),
        ("[{x_um=500},{}]", Code.MISSING_KEY, "{}", "add x_um to [[sites]]"),
        ("[{x=600}]", Code.UNKNOWN_KEY, "x", "did you mean x_um?"),
        ("[{x_um=500,z_um=3}]", Code.UNKNOWN_KEY, "z_um", "name, x_um, y_um, theta_deg, depth_um"),
        ("[{kind='circle',x_um=500,radius=3}]", Code.UNKNOWN_KEY, "radius", "did you mean radius_um?"),
        ("{x_um=500}", Code.WRONG_TYPE, "{x_um=500}", "write [[sites]]"),
        ("[{x_um=500,colums=3}]", Code.UNKNOWN_KEY, "colums", "did you mean columns?"),
        ("[{x_um=500,columns=3}]", Code.UNKNOWN_KEY, "columns", "change kind"),
        ("[3]", Code.WRONG_TYPE, "3", "a list of tables"),
        ("3", Code.WRONG_TYPE, "3", "a list of tables"),
    ],
)
def test_a_wrong_item_is_pointed_at(sites: str, code: Code, blamed: str, hint: str) -> None:
    found = next(d for d in problems("cu150", *SHALLOW, f"sites={sites}") if d.code == code)
    assert hint in found.hint
    assert marked(found) == blamed


def test_a_wrong_item_in_an_array_of_tables_has_its_line(tmp_path: Path) -> None:
    sites = '[[sites]]\nx_um = 500\n[[sites]]\nkind = "grid"\nx_um = 600\nrows = 0\ncolumns = 1\n'
    path = written(tmp_path, f'extends = "array-3x3"\n{sites}')
    found = {d.code: place_of(d)[1:] for d in problems(path)}
    assert (found[Code.MISSING_KEY], found[Code.OUT_OF_RANGE]) == ((4, 3), (7, 8))


def test_the_example_of_the_page_loads(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs/profile.md").read_text(encoding="utf-8")
    (sites,) = re.findall(r"```toml\n(\[\[sites\]\].*?)```", page, flags=re.DOTALL)
    (rows,) = re.findall(r"```\n(name,x_um.*?)```", page, flags=re.DOTALL)
    profile = sheet(tmp_path, rows)
    head = profile.read_text(encoding="utf-8").partition("[[sites]]")[0]
    profile.write_text(f"{head}{sites}[limits]\nmax_time_s = 1e5\n", encoding="utf-8")
    found = load_profile(str(profile))
    assert found.warnings == ()
    assert [place.name for place in found.places] == ["inlet", *(f"hole-{n}" for n in range(1, 7)), "a", "b"]
