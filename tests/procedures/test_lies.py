"""A controller that lies in any field of any message: the job ends with a result or with a fault that says so."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from random import Random

import pytest

from edmctl.link.messages import Event, GetStatus, Heartbeat, PathMove, Tlm
from edmctl.link.session import Session
from edmctl.machine.controller import LinkMachine
from tests.machine.lying import ALL, Lie, LyingTouches, name_of
from tests.tiers import tiers

from .conftest import Shop, refused
from .lies import KINDS, a_lie, every_field, is_expected, short_job

undisturbed = cache(partial(short_job, 3))
"""The fate of a job of a kind whose controller tells no lie."""
REPLY = 0x40
LONGEST_WAIT_S = 60.0
IN_A_TEST = ("TLM", "EVENT", "PULSE_BLOCKS", "HEARTBEAT reply", "GET_STATUS reply", "HELLO reply")


@pytest.mark.parametrize("count", tiers(slow=(8,), full=(32,)))
def test_every_field_of_what_is_heard_all_the_time_may_lie(count: int) -> None:
    """The whole of it, every message and thousands of lies, is `python -m benchmarks.mutations`."""
    random = Random(20261122)
    clean = undisturbed()
    assert (clean.code, clean.is_inside) == ("", True)
    fields = [
        (type_id, field) for type_id, field in every_field(clean.frames) if name_of(type_id) in IN_A_TEST
    ]
    assert len(fields) > 100
    for draw, (type_id, field) in enumerate(random.sample(fields, count)):
        lie = a_lie(type_id, field, clean.frames[type_id], random)
        fate = short_job(3, lie, draw)
        assert is_expected(fate.code), (lie, fate.code, fate.said)
        assert fate.safe, lie
        assert fate.is_inside, (lie, fate)
        assert fate.machine_s < clean.machine_s + LONGEST_WAIT_S, lie


@pytest.mark.parametrize(
    ("type_id", "field", "value"),
    tiers(
        (Tlm.ID, "record displacement_um", "greatest"),
        (Tlm.ID, "t0_us", "a bit"),
        (Tlm.ID, "counter", "one more"),
        (Event.ID, "code", "greatest"),
        (Event.ID, "displacement_um", "least"),
        (Heartbeat.ID | REPLY, "t_dev_us", "greatest"),
        (GetStatus.ID | REPLY, "state", "greatest"),
        slow=(
            (Tlm.ID, "record state", "greatest"),
            (Tlm.ID, "period_us", "one more"),
            (Tlm.ID, "t0_us", "zero"),
            (Tlm.ID, "n", "zero"),
            (Tlm.ID, "random payload", ""),
            (Event.ID, "code", "zero"),
            (Event.ID, "random payload", ""),
            (Heartbeat.ID | REPLY, "t_dev_us", "zero"),
            (Heartbeat.ID | REPLY, "t_host_us", "random"),
            (GetStatus.ID | REPLY, "interlocks", "greatest"),
            (GetStatus.ID | REPLY, "x_um", "greatest"),
        ),
    ),
)
@pytest.mark.parametrize("frames", tiers(1, slow=(ALL,)))
def test_what_cannot_be_is_told_as_such_at_once(type_id: int, field: str, value: str, frames: int) -> None:
    first = {Tlm.ID: 300, Event.ID: 6, Heartbeat.ID | REPLY: 400, GetStatus.ID | REPLY: 4}[type_id]
    fate = short_job(3, Lie(type_id, field, value, first, frames))
    assert fate.lied >= 1
    assert fate.code == "E67009", fate.said
    assert fate.after_s < 2.0
    assert fate.safe


def test_doubled_and_late_samples_harm_nothing() -> None:
    clean = undisturbed()
    for field, frames in (("twice", ALL), ("twice", 3), ("late", 1)):
        fate = short_job(3, Lie(Tlm.ID, field, "", 200, frames))
        assert fate.lied >= 1
        assert (fate.code, fate.is_inside) == ("", True), fate
        assert fate.depth_um == pytest.approx(clean.depth_um, abs=0.2)


@pytest.mark.parametrize(
    "lie",
    tiers(
        lambda z_um: z_um - 0.5,
        lambda z_um: 1.25 * z_um,
        lambda _: 50.0,
        slow=(lambda z_um: z_um - 20.0, lambda z_um: z_um + 0.5, lambda z_um: z_um + 8.0),
    ),
)
def test_a_touch_that_its_samples_do_not_show_is_refused(lie: Callable[[float], float]) -> None:
    s = Shop()
    s.session = Session(LyingTouches(s.bench.transport, lie), Random(1))
    s.session.open()
    s.machine = LinkMachine(s.session, s.stop)
    with refused("E67009", "the samples of it at"):
        s.run_job()
    assert s.bench.is_safe


@pytest.mark.parametrize("kind", tiers("stopped", slow=[kind for kind in KINDS if kind != "stopped"]))
def test_a_line_that_only_passes_on_changes_nothing(kind: str) -> None:
    fate = undisturbed(kind=kind)
    assert fate.lied == 0
    assert fate.code == ("E64001" if kind == "stopped" else "")


@pytest.mark.parametrize(
    ("status", "first", "codes"),
    tiers(
        ("zero", 4, ("E7010",)),  # a controller that says OK to lines for which its queue has no room
        ("one more", 5, ("E7010", "E8100")),  # one that refuses them
        slow=(("zero", 1, ("E7010",)), ("zero", 12, ("E7010",)), ("one more", 0, ("E7010", "E8100"))),
    ),
)
def test_stages_that_stand_without_their_lines_end_the_channel_soon(
    status: str, first: int, codes: tuple[str, ...]
) -> None:
    plain = undisturbed(kind="channel")
    fate = short_job(3, Lie(PathMove.ID | REPLY, "status", status, first, ALL), kind="channel")
    assert fate.code in codes, fate.said
    assert status != "zero" or "stood still" in fate.said
    assert fate.machine_s < plain.machine_s + 30.0
    assert fate.is_inside, (fate.depth_um, fate.u95_um, fate.true_um)
