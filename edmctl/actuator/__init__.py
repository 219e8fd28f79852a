"""The piezo actuator: hysteresis and creep between applied voltage and tool displacement.

    identification = identify([Record(t_s, u_v, y_um)])
    y_um = identification.model.predict(t_s, u_v)
    estimator = identification.model.estimator()     # estimator.tick(u_v, dt_s) -> µm
    inverse = identification.model.inverse()         # inverse.tick(y_um, dt_s) -> V

Names are loaded when they are first asked for: a run needs the estimator, not the identification.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edmctl.actuator.estimator import Estimator
    from edmctl.actuator.identification import Identification, identify
    from edmctl.actuator.inverse import Inverse, Solution
    from edmctl.actuator.model import ActuatorModel
    from edmctl.actuator.record import Record
    from edmctl.actuator.state import ActuatorState
    from edmctl.actuator.validation import ErrorFigures, Validation, validate

_PLACES = {
    "ActuatorModel": "model",
    "ActuatorState": "state",
    "ErrorFigures": "validation",
    "Estimator": "estimator",
    "Identification": "identification",
    "Inverse": "inverse",
    "Record": "record",
    "Solution": "inverse",
    "Validation": "validation",
    "identify": "identification",
    "validate": "validation",
}

__all__ = [
    "ActuatorModel",
    "ActuatorState",
    "ErrorFigures",
    "Estimator",
    "Identification",
    "Inverse",
    "Record",
    "Solution",
    "Validation",
    "identify",
    "validate",
]


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
