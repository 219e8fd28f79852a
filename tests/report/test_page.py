"""The page of a run: whole in itself, sound HTML, with the numbers of the file."""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import ClassVar
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest

from edmctl.errors import EdmError
from edmctl.jobs.runs.opening import reading_unless_killed
from edmctl.record.reader import open_run
from edmctl.report.html import Picture
from edmctl.report.kinds import KINDS, kind_called
from edmctl.report.page import pictures_of, render_page
from edmctl.results.run_file import Sentence

SENTENCES = [
    Sentence(0.0, "Wanted was a hole.", "EVENT"),
    Sentence(61.0, "It jumped <once> & stopped.", "EVENT"),
    Sentence(62.0, "The run came to its end.", "EVENT"),
]
MOST_BYTES = 5_000_000
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def page_of(path: Path, trouble: str = "") -> str:
    """The page of a run with a few sentences and no figures."""
    with open_run(path) as run:
        return render_page(run, [], SENTENCES, trouble)


@pytest.fixture(scope="module")
def page(run_file: Path, pictures: list[Picture]) -> str:
    with open_run(run_file) as run:
        return render_page(run, pictures, SENTENCES)


class Elements(HTMLParser):
    """Every element, with what is wrong about their order."""

    VOID: ClassVar = {"meta", "link", "img", "br"}

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.wrong: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)

    def values(self, name: str) -> list[str]:
        """The values of an attribute."""
        return [str(attrs[name]) for _, attrs in self.found if name in attrs]


def test_every_element_is_closed_in_order_and_every_name_is_one(page: str) -> None:
    elements = Elements(page)
    assert (elements.wrong, elements.open) == ([], [])
    ids = elements.values("id")
    assert len(ids) == len(set(ids))
    assert {link for link in elements.values("href") if link.startswith("#")} <= {f"#{name}" for name in ids}


def test_the_page_needs_nothing_but_itself(page: str) -> None:
    elements = Elements(page)
    assert not {tag for tag, _ in elements.found} & {"script", "iframe", "object", "base"}
    assert all(address.startswith("data:") for address in elements.values("src"))
    assert all(link.startswith(("#", "data:")) for link in elements.values("href"))
    assert not re.search(r"url\(|@import|https?:", page)
    assert len(page.encode()) < MOST_BYTES


def test_every_figure_is_a_picture_with_words_for_it(page: str) -> None:
    pictures = [attrs for tag, attrs in Elements(page).found if tag == "img"]
    assert len(pictures) >= 5
    for picture in pictures:
        media_type, _, encoded = str(picture["src"]).removeprefix("data:").partition(";base64,")
        content = base64.b64decode(encoded, validate=True)
        if media_type == "image/svg+xml":
            assert ElementTree.fromstring(content).tag.endswith("svg")
        else:
            assert (media_type, content[:8]) == ("image/png", b"\x89PNG\r\n\x1a\n")
        assert picture["alt"]
        assert int(str(picture["width"])) > 0
    assert page.count("<figcaption>") == len(pictures)


def test_a_figure_is_drawn_or_the_reason_is_told(page: str) -> None:
    names = set(Elements(page).values("id"))
    absent = page.partition("Not drawn<")[2].partition("</details>")[0]
    assert all(kind.name in names or f"{kind.title}:" in absent for kind in KINDS)
    assert "channel" not in names


def test_the_numbers_are_those_of_the_file(run_file: Path, page: str) -> None:
    with open_run(run_file) as run:
        (row,) = run.table("/entry/results")
        summary = run.summary() or {}
        recipe = run.text("/entry/profile/recipe_sha256")
    assert f"{row['depth']:.2f} ± {row['depth_u95']:.2f} µm" in page
    assert f"{row['wear']:.2f} ± {row['wear_u95']:.2f} µm" in page
    sites = summary["sites"]
    assert isinstance(sites, list)
    truth_um = sites[0]["truth"]["depth_um"]
    assert 'truth (simulated)</th></tr></thead><tbody>\n<tr><th scope="row">depth, Z2 − Z3</th>' in page
    assert f"<td>{truth_um:.2f}</td></tr>" in page
    assert "target 8 ± " in page
    assert recipe in page
    assert "yes, seed 3" in page
    assert "It jumped &lt;once&gt; &amp; stopped." in page


def test_several_sites_make_a_table(array_run_file: Path) -> None:
    page = page_of(array_run_file)
    assert all(f'<th scope="row">hole-{number}</th>' in page for number in range(1, 10))
    assert "mean of 9 sites" in page
    assert "true depth (simulated)" in page
    # Eleven columns fit where their names may take two lines.
    assert ".numbers thead th { white-space: normal;" in page
    assert "its ± is at most the sum of theirs" in page


def test_a_page_of_a_run_that_failed_begins_with_the_fault_and_has_the_estimate_of_its_hole(
    faulted_run_file: Path, page: str
) -> None:
    without = page_of(faulted_run_file)
    header = without.partition("</header>")[0]
    assert '<span class="status other">machine fault · simulated</span>' in header
    assert f'<p class="trouble">{SENTENCES[-1].text}</p>\n<nav>' in header
    told = page_of(faulted_run_file, "The <tool> is stuck. Pull it.")
    assert '<p class="trouble">The &lt;tool&gt; is stuck. Pull it.</p>\n<nav>' in told
    assert 'class="trouble"' not in page
    numbers = without.partition('id="story"')[0].partition('id="numbers"')[2]
    assert ">estimated<" in numbers
    assert re.search(r"<dt>depth</dt><dd>~?\d+\.\d\d ± \d+\.\d\d µm<", numbers)
    assert "missed" not in numbers


def test_a_figure_with_too_much_in_it_is_png(run_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edmctl.report.page.KINDS", (kind_called("gap"),))
    monkeypatch.setattr("edmctl.report.html.MOST_SVG_BYTES", 1000)
    with open_run(run_file) as run:
        (picture,) = pictures_of(run)
    assert picture.address().startswith("data:image/png;base64,")


def test_a_damaged_run_file_is_refused_before_any_figure_is_rendered(
    run_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    damaged = tmp_path / "damaged.h5"
    shutil.copyfile(run_file, damaged)
    with h5py.File(damaged, "r+") as file:
        del file["/entry/machine/host"]
        file["/entry/machine/host"] = np.zeros((3, 0))
    rendered: list[str] = []

    def draw(_: object, suffix: str) -> bytes:
        rendered.append(suffix)
        return b""

    monkeypatch.setattr("edmctl.report.html.rendered", draw)
    with pytest.raises(EdmError), reading_unless_killed(damaged) as run:
        render_page(run, pictures_of(run), SENTENCES)
    assert rendered == []


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="chromium is not installed")
def test_a_browser_complains_about_a_page_with_a_fault_alone(page: str, tmp_path: Path) -> None:
    flags = (
        "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-sync"
    )
    flags += (
        f" --disable-component-update --enable-logging=stderr --v=0 --user-data-dir={tmp_path / 'browser'}"
    )
    file = tmp_path / "page.html"
    faulty = page.replace("</body>", '<script src="data:,x("></script></body>')
    for content, complaints in ((page, 0), (faulty, 1)):
        file.write_text(content, encoding="utf-8")
        command = [str(BROWSER), *flags.split(), "--dump-dom", file.as_uri()]
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, encoding="utf-8", timeout=100, check=True
        )
        assert sum("CONSOLE" in line for line in done.stderr.splitlines()) == complaints
        assert done.stdout.count("<figure ") == page.count("<figure ")
