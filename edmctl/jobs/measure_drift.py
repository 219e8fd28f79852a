"""`measure-drift` on a connected machine, and the file that it leaves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from edmctl.dataclasses import asdict, dataclass
from edmctl.jobs.connected_machine import with_home
from edmctl.jobs.ledger.tool import (
    account_of,
    last_run_of,
    refuse_other_setup,
    refuse_unknown_length,
    tool_identity,
    with_recipe_of,
)
from edmctl.jobs.output_files import check_writable
from edmctl.jobs.plan import Plan
from edmctl.jobs.run_context import RunContext
from edmctl.procedures.job import Job, job_of
from edmctl.procedures.measure_drift import DriftPlan, drift_result, drift_time_s, measure_drift, plan_drift
from edmctl.procedures.run import JobRun
from edmctl.process.rest_drift import DriftModel, model_of
from edmctl.profile.drift_file import MadeBy, drift_file, save_drift
from edmctl.profile.folders import default_drift_path, fresh_drift_path
from edmctl.record.ledger import RunEnded, WearMeasured
from edmctl.record.tool_account import ToolAccount
from edmctl.results.measurements import DriftResult
from edmctl.version import __version__


def drift_forecast(plan: Plan, duration_s: float | None) -> dict[str, Any]:
    """Return touches, hold and duration. Raises as `plan_drift`."""
    profile, setup = plan.loaded.profile, plan.setup
    planned = plan_drift(profile, setup, duration_s)
    return {
        "touches": planned.touches,
        "interval_s": planned.interval_s,
        "hold_um": planned.hold_um,
        "hold_s": planned.hold_s,
        "time_s": drift_time_s(planned, profile, setup),
    }


@dataclass(slots=True)
class DriftRun:
    """A request to measure drift; `output` names the file, else it is the machine's own."""

    plan: Plan
    duration_s: float | None = None
    output: Path | None = None
    name: str = "measure-drift"
    kind: str = "measure-drift"
    pulses: bool = False

    def __post_init__(self) -> None:
        """Raise as `plan_drift`, before anything is connected."""
        plan_drift(self.plan.loaded.profile, self.plan.setup, self.duration_s)

    def prepare(self, run: RunContext) -> DriftStage:
        """Return what is measured, by the recipe of the tool's last run if no profile was named.

        Raises PreconditionError: E8048 a tool whose job was killed, E8059 a reference under another setup, E8063 a
        run whose recipe is unknown; RunFileError E9012 if the file cannot be written.
        """
        serial, where, history = run.bench.serial, run.plan.where, run.history
        place = default_drift_path if where.lasting else fresh_drift_path
        path = self.output or place(serial, run.plan.surroundings.environ)
        check_writable(path)
        account = account_of(run.plan, tool_identity(run.bench), history)
        if run.ledger is not None:
            folder = run.ledger.path.parent
            refuse_other_setup(account, history, run.plan, folder)
            refuse_unknown_length(account, folder, run.plan)
            run.plan = with_recipe_of(run.plan, folder, last_run_of(account))
        profile, setup = run.plan.loaded.profile, run.plan.setup
        planned = plan_drift(profile, setup, self.duration_s)
        job = with_home(job_of(profile, setup, (), run.actuator), history, run.bench.now)
        is_own = self.output is None and where.lasting
        return DriftStage(run, job, planned, account, path, is_own)


@dataclass(slots=True, eq=False)
class DriftStage:
    """A measurement of drift on the machine; `found` is its result, saved at `path`.

    `is_own` if jobs on the machine use the file without naming it; `replaced` if there was one before.
    """

    run: RunContext
    job: Job
    planned: DriftPlan
    account: ToolAccount
    path: Path
    is_own: bool
    replaced: bool = False
    found: DriftResult | None = None
    _model: DriftModel | None = None
    _pad_um: float = math.nan

    def act(self, run: JobRun) -> None:
        """Touch, hold and rest."""
        known = not math.isnan(self.account.pad_um)
        offset_um = self.account.pad_um if known else run.profile.approach.offset_um
        record = measure_drift(run, self.planned, run.tally.home_um + offset_um)
        self._pad_um = record.touches[-1].reading.mean_um
        fit, self.found = drift_result(run, self.planned, record)
        self._model = model_of(fit)

    def close(self, time_s: float) -> None:
        """Write the file, and the present place of the pad into the ledger."""
        file = self.run.file_name
        self._save(file)
        account, home_um = self.account, self.run.tally.home_um
        seen = WearMeasured(account.label, file, self._pad_um, account.worn_um, account.worn_u95_um, home_um)
        self.run.write_down(seen, RunEnded(file, "done", time_s))

    def result(self) -> Mapping[str, object] | None:
        """Return the measured values and the path of the file."""
        if self.found is None:
            return None
        return {
            "machine": self.run.bench.serial,
            "tool": self.account.label,
            **asdict(self.found),
            "drift_file": str(self.path),
            "truth": self.truth,
        }

    @property
    def use(self) -> str:
        """Which jobs use the file, as a sentence without its end."""
        bench, where = self.run.bench, self.run.plan.where
        if self.is_own:
            return f"jobs on {bench.serial} go by it from now on"
        on = f"--port {where.selector}" if where.lasting else f"--seed {bench.seed}"
        job = f"edmctl machine --profile PROFILE {on}"
        return f"`EDMCTL_DRIFT={self.path} {job}` goes by it, as does a setup that names it (drift.file)"

    @property
    def truth(self) -> dict[str, float] | None:
        """The steady drifts of a virtual bench; None on any other machine."""
        virtual = self.run.bench.virtual
        return virtual.true_drifts_um_per_s if virtual else None

    def _save(self, run_file: str) -> None:
        assert self.found is not None
        assert self._model is not None
        identity = self.run.bench.machine.identity
        made = MadeBy(
            utc=datetime.now(UTC).isoformat(timespec="seconds"),
            edmctl=__version__,
            serial=identity.serial,
            simulated=identity.simulated,
            run_file=run_file,
        )
        self.replaced = self.path.exists()
        self.run.plan.surroundings.settled()
        save_drift(self.path, drift_file(made, self.found, self._model))
