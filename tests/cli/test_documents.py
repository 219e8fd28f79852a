"""What the documentation tells people to type is typed here, as it stands."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from edmctl.errors import MEANING
from tests.cli.commands import ROOT, Here, environment, in_a_shell

PAGES = [
    "README.md",
    "docs/actuator.md",
    "docs/build-the-machine.md",
    "docs/firmware.md",
    "docs/first-start.md",
    "docs/how-to.md",
    "docs/profile.md",
    "docs/serial-port.md",
    "docs/study.md",
    "docs/tutorial.md",
    "docs/virtual-machine.md",
]
JOB_ENDS = "kill %1"
ALL_PAGES = sorted(str(p.relative_to(ROOT)) for p in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


def text_of(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def commands_of(page: str) -> list[tuple[str, int]]:
    """Each `$ ` line of a console block with its exit code, 0 unless a comment says `exits N`."""
    found = []
    for block in re.findall(r"^```console\n(.*?)^```$", text_of(page), flags=re.DOTALL | re.MULTILINE):
        for line in block.splitlines():
            assert line.startswith("$ "), f"{page}: {line!r} is no command line"
            exits = re.search(r"# exits (\d+)$", line)
            found.append((line[2:], int(exits[1]) if exits else 0))
    return found


def files_of(page: str) -> dict[str, str]:
    """What a page says to write down: blocks behind a comment `file: NAME`, by their names."""
    form = r"^<!-- file: (\S+) -->\n```\w+\n(.*?)^```$"
    return dict(re.findall(form, text_of(page), flags=re.DOTALL | re.MULTILINE))


def newcomer(home: Path) -> tuple[Path, dict[str, str]]:
    """An empty folder, and an environment where `edmctl` and `python3` are those of the tests."""
    folder, tools = home / "work", home / "bin"
    folder.mkdir(parents=True)
    tools.mkdir()
    script = '#!/bin/sh\nexec {} "$@"\n'
    for name, command in (("edmctl", f"{sys.executable} -m edmctl"), ("python3", sys.executable)):
        tool = tools / name
        tool.write_text(script.format(command), encoding="utf-8")
        tool.chmod(0o755)
    return folder, environment(PATH=f"{tools}{os.pathsep}{os.environ['PATH']}")


def failures_of(page: str, folder: Path, env: dict[str, str]) -> list[str]:
    """Type the commands of a page in a folder one after the other; what did not end as the page says."""
    for name, text in files_of(page).items():
        (folder / name).write_text(text, encoding="utf-8")
    failures: list[str] = []
    jobs: list[subprocess.Popen[bytes]] = []
    for line, exit_code in commands_of(page):
        if line.endswith(" &"):
            jobs.append(_in_background(line, folder, env))
            continue
        if line == JOB_ENDS:
            jobs[-1].terminate()
            jobs.pop().wait(timeout=60)
            continue
        done = in_a_shell("bash", "-c", line, cwd=folder, env=env, timeout_s=120.0)
        if done.returncode != exit_code or "Traceback" in done.stderr:
            failures.append(f"$ {line}\nexit code {done.returncode}\n{done.stdout}\n{done.stderr}")
    assert not jobs, f"{page} leaves a job in the background"
    return failures


def _in_background(line: str, folder: Path, env: dict[str, str]) -> subprocess.Popen[bytes]:
    """Start what a page starts with `&`."""
    return subprocess.Popen(
        ["bash", "-c", f"exec {line.removesuffix(' &')}"],
        cwd=folder,
        env=env,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


@pytest.mark.slow
def test_every_command_of_the_pages_works(tmp_path: Path) -> None:
    """The pages are typed side by side. One test: workers that share several out would each type all."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        newcomers = [newcomer(tmp_path / str(number)) for number in range(len(PAGES))]
        failures = dict(zip(PAGES, pool.map(failures_of, PAGES, *zip(*newcomers, strict=True)), strict=True))
    assert {page: failed for page, failed in failures.items() if failed} == {}


def test_readme_and_tutorial_name_no_run_alike() -> None:
    """Newcomers type both in one folder."""
    readme, tutorial = (
        {word for line, _ in commands_of(page) for word in re.findall(r"--run-id (\S+)", line)}
        for page in ("README.md", "docs/tutorial.md")
    )
    assert readme
    assert tutorial
    assert not readme & tutorial


def test_no_page_with_commands_is_left_out() -> None:
    assert [page for page in ALL_PAGES if commands_of(page)] == sorted(PAGES)


def test_parts_of_the_conformance_suite_are_those_that_its_page_means() -> None:
    """`-k l1` would be a part of `l10` too."""
    page = text_of("docs/conformance.md")
    files = (ROOT / "tests/conformance").glob("test_*.py")
    tests = [
        name
        for f in files
        for name in re.findall(r"^def (test_l\w+)", f.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    parts = re.findall(r'-k "(l[^"]+)"', page)
    assert len(parts) >= 4
    for part in parts:
        terms = part.split(" or ")
        numbers = {re.match(r"l\d+", term)[0] for term in terms}  # type: ignore[index]
        found = {name for name in tests if any(term in name for term in terms)}
        assert {name.split("_")[1] for name in found} == numbers, part


def test_profile_and_studies_that_pages_write_down_are_sound(here: Here, tmp_path: Path) -> None:
    from edmctl.study.planning import plan_study
    from edmctl.study.study_file import read_study

    blocks = re.findall(r"^```toml\n(.*?)^```$", text_of("docs/profile.md"), flags=re.DOTALL | re.MULTILINE)
    (toml,) = (block for block in blocks if block.startswith("extends"))
    shutil.copy(ROOT / "profiles/cu270.toml", tmp_path)
    shallow = tmp_path / "shallow.toml"
    shallow.write_text(toml, encoding="utf-8")
    assert here("profile", "check", str(shallow)).exit_code == 0
    written = files_of("docs/study.md")
    assert written
    for name, text in written.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
        assert plan_study(read_study(tmp_path / name)).plan.runs


def test_links_lead_somewhere() -> None:
    for page in ALL_PAGES:
        text = text_of(page)
        for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", text):
            if not link.startswith("https://"):
                assert ((ROOT / page).parent / link).exists(), f"{page} links to {link}"


def test_the_page_of_exit_codes_says_what_the_program_says() -> None:
    rows = re.findall(r"^\| (\d+) \| (.+) \|$", text_of("docs/exit-codes.md"), flags=re.MULTILINE)
    assert rows == [(str(int(code)), meaning) for code, meaning in MEANING.items()]


def test_the_readme_holds_the_commands_that_the_ci_takes_from_it() -> None:
    readme = text_of("README.md")
    marked = dict(re.findall(r"^<!-- command: (\w+) -->\n```sh\n(.+)\n```$", readme, flags=re.MULTILINE))
    assert set(marked) == {"run", "test"}
    for command in marked.values():
        words = shlex.split(command)
        assert words[:3] == ["python3", "-m", "venv"]
        assert ".venv" in words[: words.index("&&")]
    assert marked["run"].endswith(".venv/bin/edmctl machine --profile profiles/cu270.toml")
    assert ".venv/bin/python -m pytest" in marked["test"]


def test_pictures_load_nothing_from_elsewhere() -> None:
    pictures = list((ROOT / "docs/images").glob("*.svg"))
    assert pictures
    for picture in pictures:
        addresses = re.findall(r"https?://[^\s\"')]+", picture.read_text(encoding="utf-8"))
        names = {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
        assert set(addresses) <= {*names, "https://www.textualize.io"}


@pytest.mark.slow
def test_the_sample_result_of_the_readme_is_what_its_seed_gives(here: Here) -> None:
    readme = text_of("README.md")
    (sample,) = re.findall(r"<!-- result -->\n```text\n(.*?)\n```", readme, flags=re.DOTALL)
    (seed,) = re.findall(r"Simulated, seed (\d+)\.", sample)
    (run_id,) = re.findall(r"runs/(.+)\.h5", sample)
    said = here("machine", "--profile", "cu270", "--seed", seed, "--run-id", run_id, "--quiet")
    assert said.out == sample + "\n"
