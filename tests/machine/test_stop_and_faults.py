"""Stop requests and faults as errors."""

from __future__ import annotations

import signal

import pytest

from edmctl.errors import Interrupted
from edmctl.link.faults import FAULTS
from edmctl.link.messages import PARAMS
from edmctl.machine.faults import fault_error
from edmctl.machine.stop import StopRequest

DEFAULTS = {name: param.default for name, param in PARAMS.items()}


def test_the_first_stop_request_wins() -> None:
    stop = StopRequest()
    stop.check()
    stop.request(signal.SIGINT)
    stop.request(signal.SIGTERM)
    with pytest.raises(Interrupted, match="SIGINT") as caught:
        stop.check()
    assert caught.value.signal_number == signal.SIGINT


@pytest.mark.parametrize("code", sorted(FAULTS))
def test_every_fault_has_a_message_with_its_figures_and_a_remedy(code: int) -> None:
    error = fault_error(code, DEFAULTS)
    assert error.exit_code == 6
    assert error.fault == code
    assert "{" not in error.message
    assert error.hint


def test_the_silent_host_is_told_for_how_long() -> None:
    assert "0.4 s" in fault_error(1001, {**DEFAULTS, "watchdog_s": 0.4}).message


def test_an_unknown_fault_is_still_named() -> None:
    assert "9999" in fault_error(9999, DEFAULTS).message
