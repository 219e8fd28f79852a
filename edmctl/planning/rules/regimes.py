"""Rules of regimes: what they are for, and what their pulses have to be."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from edmctl.planning.forecast import Job
from edmctl.planning.regimes import recipes_of, with_regimes
from edmctl.planning.rules import materials, motion, pulse
from edmctl.profile.findings import Code, Finding

OF_PULSES: tuple[Callable[[Job], Iterable[Finding]], ...] = (
    pulse.reference_window,
    motion.slope_against_feed,
    motion.limit_cycle,
    pulse.pulse_energy,
    *pulse.PULSE_TIMES,
    pulse.FILTER_CORNER,
    *pulse.DISCHARGE_TIME,
    materials.within_the_laws,
)
"""What holds for pulses and reference of every regime."""
SHARES = 1e-6
SUITS = "a depth of one blind hole that is measured"


def regimes(job: Job) -> Iterator[Finding]:
    """Rule 37: shares make up the whole depth of one blind hole, and every regime is a recipe that works."""
    profile = job.profile
    if not profile.regimes:
        return
    for is_wrong, what in (
        (profile.target.kind != "depth", f'target.kind = "{profile.target.kind}"'),
        (bool(profile.sites), "[[sites]]"),
        (profile.path is not None, "[path]"),
        (profile.wear.remeasure == "never", 'wear.remeasure = "never"'),
        (profile.pulse.mode == "isopulse", 'pulse.mode = "isopulse"'),
    ):
        if is_wrong:
            yield Finding(
                Code.REGIMES,
                ("regimes",),
                f"regimes are for {SUITS}, not for {what}",
                "leave one of the two out",
            )
            return
    whole = math.fsum(regime.share for regime in profile.regimes)
    if abs(whole - 1.0) > SHARES:
        yield Finding(
            Code.REGIMES,
            ("regimes",),
            f"the shares of all regimes are {whole:g} together, not 1",
            f"the last one could have {1.0 - whole + profile.regimes[-1].share:.3g}",
        )
        return
    twice = [name for name, n in Counter(regime.name for regime in profile.regimes).items() if n > 1]
    if twice:
        yield Finding(Code.REGIMES, ("regimes",), f"two regimes are called {twice[0]}", "give each a name")
        return
    for number, recipe in enumerate(recipes_of(with_regimes(profile))):
        if recipe.profile.pulse == profile.pulse and recipe.profile.servo == profile.servo:
            continue  # what is wrong with it has been said of the profile
        alone = recipe.profile.model_copy(update={"regimes": []})
        for rule in OF_PULSES:
            for found in rule(Job(alone, job.setup, job.places)):
                yield replace(
                    found, path=("regimes", number), message=f"regime {recipe.name}: {found.message}"
                )
