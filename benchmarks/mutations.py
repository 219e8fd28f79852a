"""Jobs whose controller lies: `python -m benchmarks.mutations [--jobs 6000] [--seed 1] [--processes 2]`.

Each job is a short hole or channel on the virtual machine; from one moment on some of its controller's messages come
with one field changed and the right check, or doubled, late, cut or filled with anything. Every field of every
message that these jobs bring has its turn: holes with all pulses, jumps or an emergency stop, and a channel. Counted
are jobs that ended with anything but a result or an error with a code, jobs that hung, machines that did not come to
rest, and depths stated wrongly where the same seed without a lie states them rightly.
Exit code 1 where there is one, or fewer than 5 000 jobs had a message changed.
"""

from __future__ import annotations

import sys
from collections import Counter, defaultdict
from multiprocessing import Pool, TimeoutError
from random import Random

from benchmarks.common import options
from tests.machine.lying import Lie, name_of
from tests.procedures.lies import KINDS, Fate, a_lie, every_field, is_expected, short_job

LEAST_LIES = 5000
PATIENCE_S = 120.0
"""A job that has not ended after so long hangs."""
HANG_S = 5.0
"""Of the processor's time beyond that of the job without a lie: time is virtual, nothing sleeps."""
LONGEST_WAIT_S = 60.0
"""Of the controller's time beyond that of the job without a lie: the longest wait for the end of a motion."""
SEEDS = 5
Order = tuple[int, Lie, int, str]


def run(order: Order) -> tuple[Order, Fate]:
    """One job."""
    seed, lie, draw, kind = order
    return order, short_job(seed, lie, draw, kind)


def orders(jobs: int, first_seed: int) -> tuple[list[Order], dict[tuple[int, str], Fate]]:
    """Draw the lies, every field of every message in turn, and run the jobs without."""
    random = Random(first_seed)
    plain = {
        (seed, kind): short_job(seed, kind=kind)
        for seed in range(first_seed, first_seed + SEEDS)
        for kind in KINDS
    }
    fields = {kind: every_field(plain[first_seed, kind].frames) for kind in KINDS}
    seen = {field for field in fields["plain"]}
    turns = [("plain", field) for field in fields["plain"]]
    for kind in KINDS:
        turns += [(kind, field) for field in fields[kind] if field not in seen]
        seen |= set(fields[kind])
    found: list[Order] = []
    while len(found) < jobs:
        random.shuffle(turns)
        for kind, (type_id, field) in turns[: jobs - len(found)]:
            seed = random.randrange(first_seed, first_seed + SEEDS)
            if not plain[seed, kind].frames[type_id]:
                seed = first_seed
            lie = a_lie(type_id, field, plain[seed, kind].frames[type_id], random)
            found.append((seed, lie, len(found), kind))
    return found, plain


def main() -> int:
    """Run and judge; return the exit code."""
    asked = options(__doc__, jobs=6000, seed=1, processes=2)
    todo, plain = orders(asked.jobs, asked.seed)
    bad: defaultdict[str, list[str]] = defaultdict(list)
    codes: Counter[str] = Counter()
    silent: Counter[str] = Counter()
    told: Counter[str] = Counter()
    messages = lies = 0
    with Pool(asked.processes) as pool:
        fates = pool.imap_unordered(run, todo)
        for _ in todo:
            try:
                (seed, lie, draw, kind), fate = fates.next(PATIENCE_S)
            except TimeoutError:
                bad["hangs"].append(f"a job did not end within {PATIENCE_S:g} s; no other was waited for")
                break
            clean = plain[seed, kind]
            line = f"seed {seed}, {kind}, draw {draw}: {lie}: {fate.code} {fate.said}"
            messages += fate.lied
            lies += fate.lied > 0
            codes[fate.code or "none"] += 1
            field = f"{name_of(lie.type_id)}.{lie.field}"
            if fate.lied:
                told[field] += 1
                silent[field] += fate.code == clean.code
            if not is_expected(fate.code):
                bad["internal errors"].append(line)
            if fate.cpu_s > clean.cpu_s + HANG_S or fate.machine_s > clean.machine_s + LONGEST_WAIT_S:
                bad["hangs"].append(f"{line} ({fate.cpu_s:.1f} s, {fate.machine_s:.0f} s of the machine's)")
            if not fate.safe:
                bad["not at rest"].append(line)
            if clean.is_inside and not fate.is_inside:
                bad["wrong depths"].append(
                    f"{line} {fate.depth_um:.2f} ± {fate.u95_um:.2f} µm, true {fate.true_um:.2f} µm"
                )
    print(f"{len(todo)} jobs, {lies} of them with {messages} messages changed")
    for code, number in codes.most_common():
        print(f"  {number:5} {code}")
    unseen = [f"{field} ({number} of {told[field]})" for field, number in sorted(silent.items()) if number]
    print(f"changed without an effect on the outcome: {', '.join(unseen)}")
    for what in ("internal errors", "hangs", "not at rest", "wrong depths"):
        print(f"{what}: {len(bad[what])}")
        for line in bad[what]:
            print(f"  {line}")
    return int(any(bad.values()) or lies < LEAST_LIES)


if __name__ == "__main__":
    sys.exit(main())
