"""What is missing skips a test, and fails it where the firmware is required."""

from __future__ import annotations

import pytest

from edmctl.errors import PreconditionError
from tests.firmware_tools import NO_COMPILER, VARIABLE, built_here, need_board_compiler, need_package, program


def _without_compiler() -> None:
    raise PreconditionError("There is no C compiler.", hint="Install one.", code=NO_COMPILER)


def _broken() -> None:
    raise PreconditionError("It cannot be built.", hint="Mend it.", code="E8094")


@pytest.mark.parametrize(
    ("required", "outcome"),
    [("", pytest.skip.Exception), ("0", pytest.skip.Exception), ("1", pytest.fail.Exception)],
)
def test_a_required_firmware_is_never_skipped(
    required: str, outcome: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, required)
    with pytest.raises(outcome, match="no C compiler"):
        built_here(_without_compiler)
    with pytest.raises(outcome, match="no_such_package"):
        need_package("no_such_package")
    with pytest.raises(outcome, match="no-such-program"):
        program("no-such-program")
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(outcome, match="ziglang"):
        need_board_compiler("zig")
    monkeypatch.setattr("shutil.which", lambda _: None)
    with pytest.raises(pytest.skip.Exception, match="arm-none-eabi-gcc"):
        need_board_compiler("gcc")


def test_what_cannot_be_built_is_no_skip() -> None:
    with pytest.raises(PreconditionError, match="cannot be built"):
        built_here(_broken)
