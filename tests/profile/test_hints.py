"""Hints for values in other units and for characters that look like others: every key of every model."""

from __future__ import annotations

import math
import tomllib
from typing import TYPE_CHECKING, Any, get_args, get_origin

import pytest
from pydantic import BaseModel, ValidationError

from edmctl.errors import ProfileError
from edmctl.profile.diagnose import schema_diagnostics, schema_problems
from edmctl.profile.model import ProfileFile
from edmctl.profile.positions import Source, Sources
from edmctl.profile.read import Merged, apply_overrides, parse
from edmctl.profile.setup import Setup
from edmctl.profile.tables import accepts
from edmctl.profile.units import NO_UNIT, others, quantity, split, unit_of
from edmctl.study.study_file import StudyFile
from tests.planning.rules.documents import place_of

if TYPE_CHECKING:
    from collections.abc import Iterator

Path = tuple[str | int, ...]


def tables(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [table for argument in get_args(annotation) for table in tables(argument)]


def is_number(annotation: Any) -> bool:
    if get_origin(annotation) is list:
        return False
    return annotation in (float, int) or any(map(is_number, get_args(annotation)))


def numbers(
    model: type[BaseModel], root: type[BaseModel], path: Path = ()
) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Every key with a number, as path, and what states the kind of its table."""
    for name, info in model.model_fields.items():
        own = (*path, info.alias or name)
        inner = tables(info.annotation)
        if inner:
            many = "list" in str(info.annotation)
            for table in inner:
                yield from numbers(table, root, (*own, 0) if many else own)
        elif name != "schema_version" and is_number(info.annotation):
            kinds = model.model_fields.get("kind")
            kind = {"kind": get_args(kinds.annotation)[0]} if kinds else {}
            yield own, kind


KEYS = [
    pytest.param(root, path, kind, id=f"{'.'.join(map(str, path))}-{kind.get('kind', '')}")
    for root in (ProfileFile, Setup, StudyFile)
    for path, kind in numbers(root, root)
]


def document(path: Path, kind: dict[str, Any], key: str, value: object) -> dict[str, Any]:
    """A document with one key, in its table."""
    inner: Any = {**kind, key: value}
    for part in reversed(path[:-1]):
        inner = [inner] if isinstance(part, int) else {part: inner}
    return dict(inner)


def hint_for(root: type[BaseModel], path: Path, kind: dict[str, Any], key: str, value: object) -> str:
    """The hint for that key with that value in the table of `path`."""
    data = document(path, kind, key, value)
    with pytest.raises(ValidationError) as caught:
        root.model_validate(data)
    problems = schema_problems(caught.value, root, data)
    at = (*path[:-1], key)
    source = Source("x.toml", "")
    (found,) = schema_diagnostics({at: problems[at]}, root, data, Sources((source,), source))
    return found.hint


def sample(root: type[BaseModel], path: Path) -> float | None:
    """A value that the key accepts."""
    tried = (3.0, 0.3, 30.0, 300.0, 3000.0, 30_000.0, 0.03, 0.003, 0.0003, 1e5)
    return next((value for value in tried if accepts(root, path, value)), None)


@pytest.mark.parametrize(("root", "path", "kind"), KEYS)
def test_a_key_in_another_unit_is_converted(root: type[BaseModel], path: Path, kind: dict[str, Any]) -> None:
    key, value = str(path[-1]), sample(root, path)
    stem, unit = split(key)
    assert value is not None
    for other in others(unit):
        in_other = float(f"{value * unit.scale / other.scale:.12g}")
        right = f"write {key} = {value:g}"
        if unit != NO_UNIT:
            written = key.replace(unit.ending, other.ending)
            assert hint_for(root, path, kind, written, in_other) == right
        assert hint_for(root, path, kind, key, f"{in_other:.12g} {other.symbol}") == right
    # Without a unit: what would not be accepted, and is in another unit.
    for other in others(unit):
        number = float(f"{value * unit.scale / other.scale:.12g}")
        if unit == NO_UNIT or accepts(root, path, number) or stem == key:
            continue
        hint = hint_for(root, path, kind, stem, number)
        if hint.startswith(f"did you mean {key}?"):
            said = quantity(hint.partition("? ")[2].partition(" is ")[0])
            assert said is not None
            assert said[0] == pytest.approx(number)
            stated = float(hint.rpartition(" = ")[2])
            assert accepts(root, path, stated)


def test_every_number_with_a_unit_has_units_to_be_mistaken_for() -> None:
    with_unit = {str(param.values[1][-1]) for param in KEYS if split(str(param.values[1][-1]))[1] != NO_UNIT}  # type: ignore[index]
    assert len(with_unit) > 80
    alone = {key for key in with_unit if not others(split(key)[1])}
    assert {split(key)[1].ending for key in alone} <= {"c", "lpm"}
    assert split("duty_min") == ("duty_min", NO_UNIT)
    assert split("period_min_s")[1].ending == "s"
    assert split("stroke_v_max") == ("stroke_max", unit_of("v"))
    removal, speed = unit_of("um3_per_uj"), unit_of("mm_min")
    assert removal is not None
    assert removal.scale == pytest.approx(1e-12)
    assert speed is not None
    assert math.isclose(speed.scale, 1e-3 / 60.0)


@pytest.mark.parametrize(
    ("override", "hint"),
    [
        ("tool.diameter=0.27", "did you mean diameter_um? 0.27 mm is diameter_um = 270"),
        ("tool.diameter_mm=0.27", "write diameter_um = 270"),
        ("pulse.duty=55", "write a number from 0.05 to 0.85 (on-time over period); 55 % is duty = 0.55"),
        ("pulse.frequency=2.3", "did you mean frequency_hz? 2.3 kHz is frequency_hz = 2300"),
        ("target.depth=0.02", "did you mean depth_um? 0.02 mm is depth_um = 20"),
        ("target.depth=20", "did you mean depth_um?"),
        ("measure.touch=3", "did you mean touches?"),
    ],
)
def test_a_number_without_a_unit_is_recognised(override: str, hint: str) -> None:
    name, _, value = override.partition("=")
    table, _, key = name.partition(".")
    kind = {"kind": "depth"} if table == "target" else {}
    assert hint_for(ProfileFile, (table, key), kind, key, tomllib.loads(f"v = {value}")["v"]) == hint


@pytest.mark.parametrize(
    ("written", "hint"),
    [
        ("depth_um = 20um", "write depth_um = 20, without"),
        ("depth = 20 µm # deep", "write depth_um = 20, without"),
        ("depth_um = 0.02 mm", "write depth_um = 20, without"),
        ("duty = 55%", "write duty = 0.55, without"),
        ("depth_um = 2.3kHz", "write a number, without a unit"),
        ("depth_um = 5°", "write a number, without a unit"),
        ("depth_um = 5 %", "write a number, without a unit"),
        ("depth = 5°", "write a number, without a unit"),
        ("frequency = 2.3 kHz", "write frequency_hz = 2300, without"),
        ("forward_um_s = 0.3 mm/min", "write forward_um_s = 5, without"),
        ("depth_um = 2,5", "not a comma: 2.5"),
        ("material = “Cu”", 'U+201C (LEFT DOUBLE QUOTATION MARK) is not TOML here: write "'),
        ('material = "Cu”', 'U+201D (RIGHT DOUBLE QUOTATION MARK) is not TOML here: write "'),
        ("material = ″Cu″", 'U+2033 (DOUBLE PRIME) is not TOML here: write "'),
        ("depth_um = −20", "U+2212 (MINUS SIGN) is not TOML here: write -"),
        ("depth_um = –20", "U+2013 (EN DASH) is not TOML here: write -"),
        ("depth_um =\u00a020", "U+00A0 (NO-BREAK SPACE) is not TOML here: write a plain space"),
        ("depth_um = 20\u200b", "U+200B (ZERO WIDTH SPACE) is not TOML here: write a plain space"),
        ("material = Кu", "U+041A (CYRILLIC CAPITAL LETTER KA) is not TOML here: put texts in quotes"),
        ('name = = "3 × 3" # 0.7–0.9', "texts are in quotes"),
    ],
)
def test_a_usual_mistake_of_syntax_is_named_in_files_and_in_overrides(written: str, hint: str) -> None:
    with pytest.raises(ProfileError) as in_file:
        parse(Source("x.toml", f"[target]\n{written}\n"))
    assert hint in in_file.value.hint
    assert place_of(in_file.value)[1] == 2
    if "#" not in written:
        source = Source("x.toml", "")
        with pytest.raises(ProfileError) as in_override:
            apply_overrides(Merged((source,), {}, ()), [f"target.{written}"])
        assert hint in in_override.value.hint
