"""docs/faults.md is that of the table."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_page_is_up_to_date() -> None:
    check = [sys.executable, str(ROOT / "docs" / "generate_faults.py"), "--check"]
    done = subprocess.run(
        check, env={"PYTHONPATH": str(ROOT)}, capture_output=True, encoding="utf-8", check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
