"""The main job over a pty: `python -m benchmarks.served [--seconds 60] [--seed 1]`.

First the whole job at the speed that both sides can, against the same job in process. Then at the speed of a real
machine for a minute of machining with 1 kHz telemetry, every sample recorded: samples missing, processor time of the
host, round trips. Exit code 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from benchmarks.serving import cpu_s, result, served, start

SAME_UM, CORE_SHARE, RTT_MS = 0.5, 0.10, 10.0
QUICK_START = "[actuator]\nconditioning_cycles = 0\n[stage]\npark_x_um = -2500.0\nspeed_um_s = 5000.0\n"


def same_job(home: Path, seed: int) -> bool:
    """Compare the job over the pty with the job in process."""
    runs: list[dict[str, Any]] = []
    with served(home, "--profile", "cu270", "--seed", str(seed), "--speed", "max") as link:
        for port in ("sim:", str(link)):
            seeded = ("--seed", str(seed)) if port == "sim:" else ()
            begin_s = time.perf_counter()
            code, document, err = result(
                start(home, "machine", "-p", "cu270", "--port", port, "--json", "--quiet", *seeded)
            )
            if code:
                print(err)
                return False
            runs.append(document["result"]["sites"][0] | {"wall_s": time.perf_counter() - begin_s})
    alone, pty = runs
    depth_um = abs(alone["depth_um"] - pty["depth_um"])
    wear_um = abs(alone["wear_um"] - pty["wear_um"])
    print(
        f"whole job, seed {seed}: depth {alone['depth_um']:.3f} µm in process, {pty['depth_um']:.3f} over the pty; "
        f"wear {alone['wear_um']:.3f} and {pty['wear_um']:.3f} µm\n"
        f"  difference {depth_um:.3f} and {wear_um:.3f} µm (bar {SAME_UM}); "
        f"{alone['wall_s']:.1f} s and {pty['wall_s']:.1f} s"
    )
    return bool(depth_um <= SAME_UM and wear_um <= SAME_UM)


def one_minute(home: Path, seed: int, seconds: float) -> bool:
    """Machine for a while at 1x and account for every sample."""
    (home / "setup.toml").write_text(QUICK_START, encoding="utf-8")
    with served(home, "--profile", "cu270", "--seed", str(seed), "--speed", "1") as link:
        options = ("--setup", "setup.toml", "--run-id", "minute", "--set", "log.servo_hz=1000")
        process = start(home, "machine", "-p", "cu270", "--port", str(link), "--json", "--events", *options)
        assert process.stderr is not None
        for line in process.stderr:
            if '"machining"' in line or "touch" in line:
                break
        used_s, begin_s = cpu_s(process.pid), time.monotonic()
        time.sleep(seconds)
        share = (cpu_s(process.pid) - used_s) / (time.monotonic() - begin_s)
        process.send_signal(signal.SIGINT)
        code, document, err = result(process)
    link_report = document["result"]["link"]
    with h5py.File(home / "runs/minute.h5") as file:
        time_s = file["/entry/servo/time"][:]
    steps = np.round(np.diff(time_s) * 1000).astype(int)
    missing = int((steps - 1).sum())
    print(
        f"{seconds:.0f} s at 1x: {time_s.size} samples of 1 kHz over {time_s[-1] - time_s[0]:.3f} s, "
        f"{missing} missing, {link_report['lost_frames']} frames lost, {link_report['bad_frames']} bad (bar: none)\n"
        f"  host: {100 * share:.1f} % of a core (bar {100 * CORE_SHARE:.0f} %)\n"
        f"  round trip: median {link_report['rtt_p50_ms']:.2f} ms, "
        f"p99 {link_report['rtt_p99_ms']:.2f} ms (bar {RTT_MS:.0f} ms); "
        f"clock {link_report['clock_rate_ppm']:+.1f} ppm, residual {link_report['clock_residual_us']:.0f} µs"
    )
    if code != -signal.SIGINT:
        print(err)
    enough = time_s.size >= 1000 * seconds
    clean = missing == 0 and link_report["lost_frames"] == 0
    return (
        code == -signal.SIGINT
        and enough
        and clean
        and share <= CORE_SHARE
        and link_report["rtt_p99_ms"] <= RTT_MS
    )


def main() -> int:
    """Run both and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        same = same_job(Path(folder), arguments.seed)
    with tempfile.TemporaryDirectory() as folder:  # the other knows of a tool that has lost its length
        minute = one_minute(Path(folder), arguments.seed, arguments.seconds)
    return 0 if same and minute else 1


if __name__ == "__main__":
    sys.exit(main())
