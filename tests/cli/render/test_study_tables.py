"""Studies on the terminal: commands to copy, numbers alike, and reasons where a figure is missing."""

from __future__ import annotations

import numpy as np

from edmctl.cli.render.terminal import wrapped
from edmctl.study.report import render_response
from edmctl.study.report.contents import fit_quality
from edmctl.study.results import ResponseInfo
from edmctl.study.statistics.linear_model import Settings
from edmctl.study.statistics.response_analysis import Runs, analyse
from edmctl.wording import settings_words


def test_a_command_is_not_broken() -> None:
    command = "`edmctl study import a/folder/of/some/length TABLE.csv`"
    lines = wrapped(f"ra_um of runs 1, 2, 3 and 4 more: {command}, or by hand.", 40, "  ")
    assert any(command in line for line in lines)
    assert all(len(line) <= 40 for line in lines if command not in line)


def test_numbers_of_a_factor_look_alike() -> None:
    assert settings_words({"a": 2200.0, "b": 3000, "c": 0.7, "d": True, "e": "Cu"}) == (
        "a = 2200, b = 3000, c = 0.7, d = true, e = Cu"
    )


def test_what_is_not_predicted_has_its_reason() -> None:
    """The only run of its block is needed by the model: it cannot be left out."""
    x = np.linspace(-1, 1, 13)
    blocks = [1] * 12 + [2]
    settings = Settings({"x": x}, {"block": blocks}, {"block": [1, 2]})
    runs = Runs(settings, {"x": x.tolist()}, list(range(13)), blocks)
    values = 10 + x + 0.1 * np.random.default_rng(3).normal(size=13)
    found = analyse("time_s", runs, values, [(), (("block", 1),), (("x", 1),)], "smaller")
    info = ResponseInfo("time_s", "s", "smaller")
    text = " ".join(render_response(info, found).split())
    assert "share of seq. SS, %" in text
    assert "R², predicted: – (the model cannot do without some runs)" in text
    assert f"held {found.held} of 12; the model needs the other 1 point" in text
    quality = fit_quality(found, "s")
    assert quality is not None
    rows = {str(row[0]): str(row[1]) for row in quality.rows}
    assert rows["R², predicted"].endswith("(the model cannot do without some runs)")
    assert rows["points left out one by one"].endswith("the model needs the other 1 point")
    balanced = analyse("time_s", runs.only(range(12)), values[:12], [(), (("x", 1),)], "smaller")
    assert "cannot do without" not in render_response(info, balanced)
