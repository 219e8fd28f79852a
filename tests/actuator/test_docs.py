"""docs/actuator.md is true."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "actuator.md"


@pytest.mark.slow
def test_the_python_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(example, "actuator.md", "exec"), {})
    held_out, voltage, rms = capsys.readouterr().out.splitlines()
    assert held_out.endswith("accepted: True")
    assert voltage == f"{(200.0 - 12.0) / 3.0:.1f} V, out of reach: False"
    assert rms == "rms 0.00 % of the range"
