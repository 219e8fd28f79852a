"""Run files of real jobs on the virtual machine, made once a session: short, and of every kind that is drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from edmctl.app import main
from edmctl.record.reader import open_run
from edmctl.report import panels
from edmctl.report.html import Picture
from tests.cli.commands import CU270, ROOT
from tests.faults.workshop import Workshop
from tests.golden import once


def _machined(
    factory: pytest.TempPathFactory,
    name: str,
    profile: str,
    *settings: str,
    exit_code: int = 0,
    inject: str = "",
) -> Path:
    """The run file of a golden run with seed 3, in this process and in folders of its own."""

    def make(folder: Path) -> None:
        options = [word for setting in settings for word in ("--set", setting)]
        place = ("--seed", "3", "--out", str(folder), "--run-id", "one", "--quiet")
        with pytest.MonkeyPatch.context() as patch:
            for variable in ("EDMCTL_PROFILE", "EDMCTL_PORT", "EDMCTL_CALIBRATION"):
                patch.delenv(variable, raising=False)
            patch.setenv("EDMCTL_HOME", str(folder / "home"))
            patch.chdir(folder)
            if inject:
                patch.setattr("edmctl.simulator.open_bench", Workshop(inject))
            assert main(("machine", "--profile", profile, *options, *place)) == exit_code

    return once(factory, name, make) / "one.h5"


@pytest.fixture(autouse=True)
def _coarse_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw at a third of the resolution: where things are does not depend on it, and it takes half the time."""
    monkeypatch.setattr(panels, "PNG_DPI", 100)


SLACK_INCH = 0.01
"""Hinting moves text by a quarter of a millimetre."""


@pytest.fixture(autouse=True)
def _text_within_the_canvas(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail a test that writes a figure, of whatever kind, with text that leaves its canvas."""
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    outside: dict[str, list[float]] = {}
    save, draw = Figure.savefig, Text.draw

    def watched_draw(self: Text, renderer: Any, *arguments: Any, **options: Any) -> None:
        if self.get_visible() and self.get_text().strip():
            left, lower, right, upper = self.get_window_extent(renderer).extents
            width, height = renderer.get_canvas_width_height()
            figure = self.get_figure(root=True)
            assert figure is not None
            slack = SLACK_INCH * figure.dpi
            if max(-left, -lower, right - width, upper - height) > slack:
                outside[self.get_text()] = [left, lower, right, upper, width, height]
        draw(self, renderer, *arguments, **options)

    def watched_save(self: Figure, *arguments: Any, **options: Any) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Text, "draw", watched_draw)
            save(self, *arguments, **options)
        assert not outside

    monkeypatch.setattr(Figure, "savefig", watched_save)


@pytest.fixture(scope="session")
def run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of one shallow hole in two cuts, sums over blocks of pulses, jumps every 10 s."""
    return _machined(tmp_path_factory, "run", CU270, "target.depth_um=8")


@pytest.fixture(scope="session")
def pictures(run_file: Path) -> list[Picture]:
    """Return all figures of that hole, as its page has them."""
    from edmctl.report.page import pictures_of

    with open_run(run_file) as run:
        return pictures_of(run)


@pytest.fixture(scope="session")
def full_run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of the same hole with every pulse, and the servo at 1 kHz."""
    settings = ("target.depth_um=8", 'log.pulses="full"', "log.servo_hz=1000.0")
    return _machined(tmp_path_factory, "full_run", CU270, *settings)


@pytest.fixture(scope="session")
def array_run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of nine shallow holes in three rows."""
    settings = ("target.depth_um=5", "jump.height_um=30", "measure.touches=2")
    return _machined(tmp_path_factory, "array_run", str(ROOT / "profiles" / "array-3x3.toml"), *settings)


@pytest.fixture(scope="session")
def faulted_run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of a hole that ended after 5 s of its first cut, when tool and work were connected."""
    inject = "WIRE_SHORT@sparks+5"
    return _machined(tmp_path_factory, "faulted_run", CU270, "target.depth_um=8", exit_code=6, inject=inject)


@pytest.fixture(scope="session")
def channel_run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of a small rectangular channel of two layers."""
    profile = str(ROOT / "profiles" / "channel-rectangle.toml")
    settings = ("target.depth_um=4", "path.width_um=250", "path.height_um=250")
    return _machined(tmp_path_factory, "channel_run", profile, *settings)
