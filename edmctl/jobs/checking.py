"""From a request to a plan: everything that it names is loaded and checked."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.errors import UsageError
from edmctl.jobs.calibration.selection import look_at_named, refuse_unasked
from edmctl.jobs.plan import Plan, where_is
from edmctl.jobs.surroundings import NONE, Surroundings

if TYPE_CHECKING:
    from edmctl.jobs.plan import JobRequest


def check(request: JobRequest, surroundings: Surroundings = NONE) -> Plan:
    """Load and check everything the request names, for the program in `surroundings`.

    Raises ProfileError, RecordError, UsageError, LinkLost, PreconditionError.
    """
    if request.profile is None:
        raise UsageError(
            "No profile was named.",
            hint="Say --profile NAME|FILE or set EDMCTL_PROFILE; `--profile cu270` takes a shipped one.",
            code="E2002",
        )
    from edmctl.forecasts.forecast import forecast
    from edmctl.profile.read import read_source
    from edmctl.profile.setup import load_setup
    from edmctl.rules.load import load_profile

    setup = load_setup(request.setup)
    where = where_is(request.port, setup, request.wait_s)
    loaded = load_profile(request.profile, request.overrides, setup=setup)
    refuse_unasked(setup, allow_model=request.allow_model)
    look_at_named(request.calibration, surroundings.environ, setup, loaded.profile)
    return Plan(
        request=request,
        where=where,
        simulated=True if where.in_process else None,
        loaded=loaded,
        setup=setup,
        setup_text=read_source(request.setup).text if request.setup else "",
        forecast=forecast(loaded.profile, setup, loaded.places),
        calibration=request.calibration,
        new_tool=request.new_tool,
        surroundings=surroundings,
    )
