"""The reference circuits of docs/build-the-machine.md, calculated."""

from __future__ import annotations

from tools.generate.circuits.actuator import actuator_drive, displacement, monitor
from tools.generate.circuits.break_chain import hardware_break
from tools.generate.circuits.charge_pump import high_voltage_enable
from tools.generate.circuits.common import Circuit, Needs
from tools.generate.circuits.gap_current import current_sense
from tools.generate.circuits.gap_voltage import gap_divider
from tools.generate.circuits.generator import gate_driver, pulse_generator, set_points
from tools.generate.circuits.outputs import output_pulls
from tools.generate.circuits.references import thresholds
from tools.generate.circuits.stages import stages
from tools.generate.circuits.touching import contact, mode_switch

CIRCUITS = (
    output_pulls,
    gap_divider,
    current_sense,
    thresholds,
    hardware_break,
    gate_driver,
    pulse_generator,
    high_voltage_enable,
    set_points,
    actuator_drive,
    monitor,
    displacement,
    contact,
    mode_switch,
    stages,
)


def circuits(needs: Needs | None = None) -> list[Circuit]:
    """Return every reference circuit, judged by what the firmware needs."""
    return [circuit(needs or Needs()) for circuit in CIRCUITS]
