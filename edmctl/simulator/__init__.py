"""The virtual machine: a controller with firmware semantics over a plant that is richer than any model of it."""

from edmctl.simulator.bench import HoleTruth, MemoryTransport, VirtualBench, open_bench, run_many
from edmctl.simulator.config import BenchConfig, DischargeConstants, SensorConstants

__all__ = [
    "BenchConfig",
    "DischargeConstants",
    "HoleTruth",
    "MemoryTransport",
    "SensorConstants",
    "VirtualBench",
    "open_bench",
    "run_many",
]
