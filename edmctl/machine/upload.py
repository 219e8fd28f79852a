"""Everything a controller is told before a job, onto the wire."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.errors import PreconditionError
from edmctl.link.messages import PARAMS, CommitProfile, PulseConfig, SetParam, param_crc

if TYPE_CHECKING:
    from collections.abc import Mapping

    from edmctl.link.session import Session
    from edmctl.machine.orders import PulseSettings


def default_settings() -> Mapping[str, float]:
    """Parameter name -> default of a controller that has just started."""
    return {name: param.default for name, param in PARAMS.items()}


def upload(session: Session, settings: Mapping[str, float]) -> None:
    """Set and commit every parameter. Raises PreconditionError E8011 where the wire cannot carry a value."""
    for name, value in settings.items():
        session.request(SetParam(PARAMS[name].id, _on_the_wire(name, value)))
    session.request(CommitProfile(param_crc(settings)))


def set_generator(session: Session, pulses: PulseSettings) -> None:
    """Tell the generator what pulses to make."""
    session.request(
        PulseConfig(
            on_time_us=pulses.on_time_us,
            off_time_us=pulses.off_time_us,
            open_voltage_v=pulses.open_voltage_v,
            peak_current_a=pulses.peak_current_a,
            mode=pulses.mode,
            discharge_us=pulses.discharge_us,
        )
    )


def _on_the_wire(name: str, value: float) -> int:
    try:
        return PARAMS[name].to_wire(value)
    except ValueError as error:
        raise PreconditionError(
            f"The controller cannot be set so: {error}.",
            hint="Change the value in the setup or in the profile.",
            code="E8011",
        ) from error
