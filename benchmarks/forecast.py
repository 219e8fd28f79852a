"""Print what `machine --dry-run` says of the shipped profiles, and what the virtual machine then takes.

    python benchmarks/forecast.py [--runs 3] [--seed 1] [--profiles cu150 array-3x3 ...]

Bars: whole time within 10 %, feed (of a channel: depth and wear) within 5 %.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from typing import Any

from edmctl.profile.folders import shipped_profiles

TIME, FEED = 0.10, 0.05


def machine(profile: str, *options: str) -> dict[str, Any]:
    """Return the `result` of one command line; raises RuntimeError with its message where it failed."""
    command = [sys.executable, "-m", "edmctl", "machine", "--profile", profile, "--json", *options]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=False)
    document: dict[str, Any] = json.loads(done.stdout)
    if not document["ok"]:
        raise RuntimeError(f"{profile} {' '.join(options)}: {document['error']['message']}")
    result: dict[str, Any] = document["result"]
    return result


def feed_um(result: dict[str, Any]) -> float:
    """Feed of the deepest hole, or depth and wear of a channel."""
    if channel := result.get("channel"):
        return float(channel["depth_um"] + channel["wear_um"])
    return float(max(result["sites"], key=lambda site: site["depth_um"])["feed_um"])


def row(profile: str, runs: int, seed: int) -> tuple[str, bool]:
    """One line of the table, and whether it meets the bars."""
    expected = machine(profile, "--dry-run")["forecast"]
    with tempfile.TemporaryDirectory() as folder:
        options = ("--out", folder, "--set", 'log.pulses="off"')
        found = [machine(profile, "--seed", str(seed + i), *options) for i in range(runs)]
    time_s, fed_um = statistics.fmean(r["time_s"] for r in found), statistics.fmean(map(feed_um, found))
    time_off, feed_off = expected["time_s"] / time_s - 1.0, expected["feed_um"] / fed_um - 1.0
    met = abs(time_off) <= TIME and abs(feed_off) <= FEED
    text = (
        f"{profile:<18} time {expected['time_s']:6.0f} s, took {time_s:6.0f} s ({100 * time_off:+5.1f} %)   "
        f"feed {expected['feed_um']:6.1f} µm, was {fed_um:6.1f} µm ({100 * feed_off:+5.1f} %)   "
        f"{'ok' if met else 'MISSED'}"
    )
    return text, met


def main() -> None:
    """Run everything, print the table, and exit with 1 when a bar was missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--profiles", nargs="+", default=list(shipped_profiles()))
    args = parser.parse_args()
    all_met = True
    for profile in args.profiles:
        text, met = row(profile, args.runs, args.seed)
        print(text, flush=True)
        all_met &= met
    sys.exit(0 if all_met else 1)


if __name__ == "__main__":
    main()
