"""`measure-drift` on a connected machine, and the file that it leaves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from edmctl.dataclasses import asdict, dataclass
from edmctl.jobs.calibration.request import check_writable
from edmctl.jobs.job_preparation import ledger_of
from edmctl.jobs.ledger.elapsed import with_home
from edmctl.jobs.ledger.tool import (
    account_of,
    last_run_of,
    refuse_other_setup,
    refuse_unknown_length,
    tool_identity,
    with_recipe_of,
)
from edmctl.jobs.plan import Plan
from edmctl.jobs.run_header import RunName
from edmctl.jobs.session import MachineSession
from edmctl.jobs.surroundings import Warn
from edmctl.procedures.job import Job, job_of
from edmctl.procedures.measure_drift import DriftPlan, drift_result, drift_time_s, measure_drift, plan_drift
from edmctl.procedures.run import JobRun
from edmctl.process.rest_drift import DriftModel, model_of
from edmctl.profile.drift_file import MadeBy, drift_file, save_drift
from edmctl.profile.folders import default_drift_path, fresh_drift_path
from edmctl.record.ledger import Ledger
from edmctl.record.ledger_entries import RunEnded, WearMeasured
from edmctl.record.tool_account import ToolAccount, history_of
from edmctl.results.measurements import DriftResult
from edmctl.version import __version__


def drift_forecast(plan: Plan, duration_s: float | None) -> dict[str, Any]:
    """Return what is touched and held, and how long it takes. Raises what `plan_drift` raises."""
    profile, setup = plan.loaded.profile, plan.setup
    planned = plan_drift(profile, setup, duration_s)
    return {
        "touches": planned.touches,
        "interval_s": planned.interval_s,
        "hold_um": planned.hold_um,
        "hold_s": planned.hold_s,
        "time_s": drift_time_s(planned, profile, setup),
    }


@dataclass(slots=True, eq=False)
class DriftRun:
    """One measurement of drift; `output` names its file, else it is the machine's own."""

    plan: Plan
    duration_s: float | None = None
    output: Path | None = None
    name: str = "measure-drift"
    kind: str = "measure-drift"
    pulses: bool = False
    found: DriftResult | None = None
    path: Path | None = None
    replaced: bool = False
    _planned: DriftPlan | None = None
    _session: MachineSession | None = None
    _ledger: Ledger | None = None
    _account: ToolAccount | None = None
    _run_file: str = ""
    _model: DriftModel | None = None
    _pad_um: float = math.nan
    _home_um: float = math.nan

    def __post_init__(self) -> None:
        """Raise what `plan_drift` raises, before anything is connected."""
        self._planned = plan_drift(self.plan.loaded.profile, self.plan.setup, self.duration_s)

    def job(self, session: MachineSession, name: RunName, warn: Warn) -> Job:
        """Return what is measured, by the recipe of the tool's last run if no profile was named.

        Raises PreconditionError: E8048 a tool whose job was killed, E8059 a reference under another setup, E8063 a
        run whose recipe is unknown.
        """
        serial = session.bench.machine.identity.serial
        self._session, self._run_file = session, name.path.name
        place = default_drift_path if self.plan.where.lasting else fresh_drift_path
        self.path = self.output or place(serial, self.plan.surroundings.environ)
        check_writable(self.path)
        self._ledger = ledger_of(self.plan, name)
        history = history_of(self._ledger.lines if self._ledger else (), serial)
        self._account = account_of(self.plan, tool_identity(session), history)
        if self._ledger is not None:
            folder = self._ledger.path.parent
            refuse_other_setup(self._account, history, self.plan, folder)
            refuse_unknown_length(self._account, folder, self.plan)
            self.plan = with_recipe_of(self.plan, folder, last_run_of(self._account))
        self._planned = plan_drift(self.plan.loaded.profile, self.plan.setup, self.duration_s)
        job = job_of(self.plan.loaded.profile, self.plan.setup, (), session.actuator)
        return with_home(job, history, session.bench.now)

    def act(self, run: JobRun) -> None:
        """Touch, hold and rest."""
        account, planned = self._account, self._planned
        assert account is not None
        assert planned is not None
        known = not math.isnan(account.pad_um)
        offset_um = account.pad_um if known else run.profile.approach.offset_um
        record = measure_drift(run, planned, run.tally.home_um + offset_um)
        self._pad_um, self._home_um = record.touches[-1].reading.mean_um, run.tally.home_um
        fit, self.found = drift_result(run, planned, record)
        self._model = model_of(fit)

    def close(self, time_s: float) -> None:
        """Write the file, and into the ledger where the pad is by now."""
        session, account = self._session, self._account
        assert session is not None
        assert account is not None
        self._save(session)
        if self._ledger is None:
            return
        worn_um, u95_um = account.worn_um, account.worn_u95_um
        seen = WearMeasured(account.label, self._run_file, self._pad_um, worn_um, u95_um, self._home_um)
        session.write_down(self._ledger, seen, RunEnded(self._run_file, "done", time_s))

    def result(self) -> Mapping[str, object] | None:
        """What was measured, and where it is kept."""
        if self._session is None or self._account is None or self.found is None:
            return None
        return {
            "machine": self._session.bench.machine.identity.serial,
            "tool": self._account.label,
            **asdict(self.found),
            "drift_file": str(self.path),
            "truth": self.truth,
        }

    @property
    def use(self) -> str:
        """Which jobs go by the file, a sentence without its end."""
        assert self._session is not None
        bench, where = self._session.bench, self.plan.where
        if self.output is None and where.lasting:
            return f"jobs on {bench.machine.identity.serial} go by it from now on"
        on = f"--port {where.selector}" if where.lasting else f"--seed {bench.seed}"
        job = f"edmctl machine --profile PROFILE {on}"
        return f"`EDMCTL_DRIFT={self.path} {job}` goes by it, as does a setup that names it (drift.file)"

    @property
    def truth(self) -> dict[str, float] | None:
        """The steady drifts of a virtual bench; None on any other machine."""
        virtual = self._session.bench.virtual if self._session else None
        return virtual.true_drifts_um_per_s if virtual else None

    def _save(self, session: MachineSession) -> None:
        assert self.found is not None
        assert self._model is not None
        assert self.path is not None
        identity = session.bench.machine.identity
        made = MadeBy(
            utc=datetime.now(UTC).isoformat(timespec="seconds"),
            edmctl=__version__,
            serial=identity.serial,
            simulated=identity.simulated,
            run_file=self._run_file,
        )
        self.replaced = self.path.exists()
        self.plan.surroundings.settled()
        save_drift(self.path, drift_file(made, self.found, self._model))
