"""Faults through a real tty: told, latched from one command to the next, and cleared at the port."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edmctl.link.faults import FAULTS, FaultCode
from edmctl.record.reader import open_run
from edmctl.simulator import BenchConfig, open_bench
from edmctl.simulator.injection import parse_injection
from tests.cli.commands import CU270, Here
from tests.faults.test_rows import QUICK, UNCONDITIONED
from tests.faults.workshop import Workshop
from tests.serving import serving
from tests.tiers import tiers


@pytest.mark.parametrize(
    "code",
    tiers(FaultCode.ESTOP, slow=(FaultCode.PIEZO_TRACK, FaultCode.RESET, FaultCode.POWER_LOSS)),
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


@pytest.mark.parametrize("served", tiers(False, slow=(True,)), ids=["memory", "served"])
def test_the_file_of_a_faulted_run_holds_the_gap_about_the_fault(
    served: bool, here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    setup = tmp_path / "setup.toml"
    setup.write_text(UNCONDITIONED)
    bench = open_bench(BenchConfig(), 1)
    bench.inject(parse_injection("CARBON@sparks+2"))
    options = [word for value in QUICK for word in ("--set", value)]
    machine = ("machine", "--profile", CU270, *options, "--setup", str(setup), "--json")
    if served:
        with serving(bench) as port:
            said = here(*machine, "--port", port)
    else:
        workshop = Workshop("CARBON@sparks+2")
        monkeypatch.setattr("edmctl.simulator.open_bench", workshop)
        said = here(*machine, "--seed", "1")
    assert said.document["error"]["code"] == "E63002"
    with open_run(Path(said.document["run_file"])) as run:
        time_s, gap_v, gap_a = (
            run.column("/entry/waveforms", name).astype(np.float64) for name in ("time", "v_gap", "i_gap")
        )
        fault_s = float(run.column("/entry/black_box", "time")[-1])
        link = run.columns("/entry/link", ("time", "frames_received"))
        end_s = float(run.column("/entry/servo", "time")[-1])
    # The tool came back to an arc already burning: fewer than 64 pulses struck before the fault.
    assert fault_s - 0.035 < time_s[0] < fault_s - 0.005
    assert fault_s + 0.005 < time_s[-1] < fault_s + 0.01
    assert np.diff(time_s) == pytest.approx(1e-6, abs=1e-9)
    # An arc that stays in one place: no open voltage, and 17 V whenever current flows.
    last = (time_s > fault_s - 0.005) & (time_s < fault_s)
    assert gap_v[last & (gap_a > 0.1)].mean() == pytest.approx(17.0, abs=1.0)
    assert gap_v[last].max() < 25.0
    assert np.abs(gap_a[time_s > fault_s + 1e-5]).max() < 0.01
    assert link["time"][-1] == pytest.approx(end_s, abs=0.2)
    assert np.all(np.diff(link["time"]) >= 0.0)
    assert np.all(np.diff(link["frames_received"].astype(int)) > 0)
    assert len(link["time"]) == int(end_s // 10) + 1
