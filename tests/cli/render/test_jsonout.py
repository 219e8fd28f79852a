"""The JSON object: order, rounding, and what has no number."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from enum import IntEnum, StrEnum

import pytest

from edmctl.jsonout import render_json, render_json_line, to_json_value


@dataclass(frozen=True, slots=True)
class Hole:
    name: str
    depth_um: float
    rate_um_s: float
    share: float


class Colour(StrEnum):
    RED = "red"


class Level(IntEnum):
    HIGH = 3


def test_keys_keep_the_order_of_the_fields() -> None:
    text = render_json({"b": 1, "a": Hole("h", 1.0, 2.0, 3.0)})
    assert list(json.loads(text)) == ["b", "a"]
    assert list(json.loads(text)["a"]) == ["name", "depth_um", "rate_um_s", "share"]


def test_a_run_file_has_exact_numbers() -> None:
    told = {"truth": [{"wear_um": 19.575123456789}], "none_um": math.nan}
    assert json.loads(render_json(told, is_exact=True)) == {
        "truth": [{"wear_um": 19.575123456789}],
        "none_um": None,
    }


def test_numbers_are_rounded_by_their_unit() -> None:
    hole = Hole("h", 179.98765432, 0.28765432, 0.123456789)
    assert to_json_value(hole) == {"name": "h", "depth_um": 179.988, "rate_um_s": 0.2877, "share": 0.123457}


def test_a_delay_keeps_microseconds() -> None:
    assert to_json_value({"lag_s": 0.00088}) == {"lag_s": 0.00088}
    assert to_json_value({"delay_s": 0.00123456, "time_s": 1.23456}) == {"delay_s": 0.001235, "time_s": 1.235}


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_null(value: float) -> None:
    assert to_json_value({"depth_um": value}) == {"depth_um": None}


def test_a_rounded_zero_has_no_sign() -> None:
    assert render_json_line({"x_um": -0.0001, "y": -0.0}) == '{"x_um": 0.0, "y": 0.0}\n'


def test_enums_are_their_values() -> None:
    assert render_json_line({"a": Colour.RED, "b": Level.HIGH, "c": True, "d": None, "e": (1, 2)}) == (
        '{"a": "red", "b": 3, "c": true, "d": null, "e": [1, 2]}\n'
    )


def test_what_has_no_json_form_is_refused() -> None:
    with pytest.raises(TypeError, match="set has no JSON form"):
        to_json_value({"a": {1}})


def test_micro_sign_stays_readable() -> None:
    assert render_json_line({"m": "5 µm"}) == '{"m": "5 µm"}\n'
