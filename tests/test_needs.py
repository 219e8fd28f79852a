"""Without what it needs a test is skipped, or fails where extras are required."""

from __future__ import annotations

import pytest

from tests.needs import EXTRAS, VARIABLE, skip_without


@pytest.mark.parametrize(
    ("required", "outcome"), [("0", pytest.skip.Exception), ("1", pytest.fail.Exception)]
)
def test_a_required_extra_is_never_skipped(
    required: str, outcome: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, required)
    monkeypatch.setitem(EXTRAS, "no_such_package", "interop")
    with pytest.raises(outcome, match=r"needs no_such_package: pip install -e \"\.\[interop\]\""):
        skip_without(["pytest", "no_such_package"])
    with pytest.raises(pytest.skip.Exception, match="needs no-such-program"):
        skip_without(["no-such-program"])
