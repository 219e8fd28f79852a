"""Faults through a real tty: told, latched from one command to the next, and cleared at the port."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from edmctl.link.faults import FAULTS, FaultCode
from edmctl.simulator import BenchConfig, open_bench
from edmctl.simulator.injection import parse_injection
from tests.cli.commands import CU270
from tests.faults.test_rows import QUICK, UNCONDITIONED
from tests.serving import serving

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.commands import Here


@pytest.mark.parametrize(
    "code",
    [FaultCode.ESTOP, FaultCode.PIEZO_TRACK, FaultCode.RESET, FaultCode.POWER_LOSS],
    ids=lambda c: c.name,
)
def test_a_fault_at_a_port_is_cleared_at_that_port(code: FaultCode, here: Here, tmp_path: Path) -> None:
    row, setup = FAULTS[code], tmp_path / "setup.toml"
    setup.write_text(UNCONDITIONED)
    bench = open_bench(BenchConfig(), 1)
    bench.inject(parse_injection(row.inject))
    options = [word for value in QUICK for word in ("--set", value)]
    with serving(bench) as port:
        machine = ("machine", "--profile", CU270, *options, "--setup", str(setup), "--port", port, "--json")
        said = here(*machine)
        error = said.document["error"]
        assert (said.exit_code, error["code"]) == (row.exit_code, row.error), error
        if row.exit_code == 6:
            assert f"`edmctl reset --ack {row.code} --port {port}`" in error["hint"]
        bench.clear_injections()
        if row.latched:
            refused = here(*machine)
            assert refused.document["error"]["code"] == "E8010"
            assert here("doctor", "--port", port).exit_code == 8
            cleared = here("reset", "--ack", str(row.code), "--port", port)
            assert cleared.exit_code == 0, cleared.err
        again = here(*machine)
        assert again.exit_code == 0, again.err
