"""A short job whose controller lies, and what became of it."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass
from random import Random

from edmctl.errors import EdmError
from edmctl.jobs.truth import channel_truth
from edmctl.link.session import Session
from edmctl.machine.controller import LinkMachine
from edmctl.results.job import JobResult, ObjectiveMissed
from tests.machine.lying import ALL, VALUES, WHOLE, Lie, LyingLine, fields_of
from tests.procedures.conftest import Shop

SHORT = (
    'target={kind="depth",depth_um=3.0,tolerance_um=5.0}',
    "measure.touches=2",
    "measure.dwell_s=0.1",
    "measure.fast_um_s=50.0",
    "measure.site_dx_um=400.0",
    "approach.speed_um_s=5.0",
    "pulse.current_a=1.0",
    "wear.max_cuts=1",
)
KINDS = {
    "plain": (),
    "every pulse": ('log.pulses="full"',),
    "stopped": (),
    "jumps": ('jump={mode="fixed",period_s=0.3,height_um=10.0}', "pulse.current_a=0.5"),
    "channel": (
        'path={kind="circle",x_um=700.0,y_um=0.0,radius_um=170.0,speed_um_s=400.0,layer_um=2.0}',
        'target={kind="depth",depth_um=2.0,tolerance_um=5.0}',
        'jump={mode="off"}',
        "pulse.current_a=0.36",
    ),
}
"""Jobs that bring most kinds of message: one whose emergency stop is pressed reads what is kept about a fault.

No reply comes to ADVANCE, CLEAR_FAULT, GET_PARAM, GET_SCHEMA, REBOOT, SERVO_STOP and STAGE_STOP, no LOG, no BOOT.
"""


@dataclass(frozen=True, slots=True)
class Fate:
    """How a job ended.

    code : of its error; empty without one, the name of the exception where it was none that is expected
    lied : messages that came changed
    machine_s, cpu_s : how long it took, by the controller and of the processor's time, for nothing sleeps here
    after_s : time of the controller from the first lie to the end
    depth_um, u95_um, true_um : of a hole or channel that was made; NaN without
    safe : whether the machine came to rest by itself
    """

    code: str
    lied: int
    machine_s: float
    cpu_s: float
    after_s: float
    depth_um: float
    u95_um: float
    true_um: float
    safe: bool
    frames: Counter[int]
    said: str

    @property
    def is_inside(self) -> bool:
        """Whether what was stated of the depth is so; a job without a hole states nothing."""
        stated = self.depth_um == self.depth_um
        return not stated or abs(self.depth_um - self.true_um) <= self.u95_um


def short_job(seed: int, lie: Lie | None = None, draw: int = 0, kind: str = "plain") -> Fate:
    shop = Shop((*SHORT, *KINDS[kind]), seed)
    bench = shop.bench
    if kind == "stopped":
        shop.inject("ESTOP@sparks+1")
    line = LyingLine(bench.transport, lie, Random(draw))
    begun_s, cpu_s = bench.transport.now_s(), time.process_time()
    code = said = ""
    result: JobResult | None = None
    try:
        shop.session = Session(line, Random(seed))
        shop.session.open()
        shop.machine = LinkMachine(shop.session, shop.stop)
        result = shop.run_job()
    except ObjectiveMissed as missed:
        code, said, result = missed.code, missed.message, missed.result
    except EdmError as error:
        code, said = error.code, error.message
        result = shop.tally.result() if shop.tally.sites or shop.tally.channel else None
    except Exception as error:  # what a job must not end with is what is looked for
        code, said = type(error).__name__, repr(error)
    end_s = bench.transport.now_s()
    cpu_s = time.process_time() - cpu_s
    for _ in range(100):
        if bench.is_safe:
            break
        bench.controller.advance(50)
    made = next((made for made in (*result.sites, result.channel) if made), None) if result else None
    depth_um, u95_um = (made.depth_um, made.depth_u95_um) if made else (float("nan"), 0.0)
    return Fate(
        code=code,
        lied=line.told,
        machine_s=end_s - begun_s,
        cpu_s=cpu_s,
        after_s=0.0 if line.told_s is None else end_s - line.told_s,
        depth_um=depth_um,
        u95_um=u95_um,
        true_um=_true_um(shop),
        safe=bench.is_safe,
        frames=line.counts,
        said=said,
    )


def _true_um(shop: Shop) -> float:
    if shop.job.profile.path is not None:
        truth = channel_truth(shop.job.profile, shop.bench, shop.bench.tool_wear_um)
        return truth.depth_um if truth else 0.0
    return next((hole.depth_um for hole in shop.bench.truth()), 0.0)


def a_lie(type_id: int, field: str, frames: int, random: Random) -> Lie:
    """Draw when a field is changed, how often and to what."""
    value = "" if field in WHOLE else random.choice(VALUES)
    first = random.randrange(frames)
    return Lie(type_id, field, value, first, random.choice((1, 1, 1, 3, 10, ALL)))


def every_field(frames: Counter[int]) -> list[tuple[int, str]]:
    """Each field of each type of frame that a job has brought."""
    return [(type_id, field) for type_id in sorted(frames) for field in fields_of(type_id)]


def is_expected(code: str) -> bool:
    """Whether a job may end so: without an error, or with one of its own that is no bug."""
    return not code or (code.startswith("E") and code[1:].isdigit() and code != EdmError.default_code)
