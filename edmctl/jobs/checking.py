"""From an order to a plan: everything that it names is loaded and checked."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.errors import UsageError
from edmctl.jobs.calibration.selection import look_at_named, refuse_unasked
from edmctl.jobs.plan import Plan, where_is
from edmctl.jobs.surroundings import NONE, Surroundings

if TYPE_CHECKING:
    from edmctl.jobs.plan import Order


def check(order: Order, surroundings: Surroundings = NONE) -> Plan:
    """Load and check everything the order names, for the program in `surroundings`.

    Raises ProfileError, RecordError, UsageError, LinkLost, PreconditionError.
    """
    if order.profile is None:
        raise UsageError(
            "No profile was named.",
            hint="Say --profile NAME|FILE or set EDMCTL_PROFILE; `--profile cu270` takes a shipped one.",
            code="E2002",
        )
    from edmctl.forecasts.forecast import forecast
    from edmctl.profile.read import read_source
    from edmctl.profile.setup import load_setup
    from edmctl.rules.load import load_profile

    setup = load_setup(order.setup)
    where = where_is(order.port, setup, order.wait_s)
    loaded = load_profile(order.profile, order.overrides, setup=setup)
    refuse_unasked(setup, allow_model=order.allow_model)
    look_at_named(order.calibration, surroundings.environ, setup, loaded.profile)
    return Plan(
        order=order,
        where=where,
        simulated=True if where.in_process else None,
        loaded=loaded,
        setup=setup,
        setup_text=read_source(order.setup).text if order.setup else "",
        forecast=forecast(loaded.profile, setup, loaded.places),
        calibration=order.calibration,
        new_tool=order.new_tool,
        surroundings=surroundings,
    )
