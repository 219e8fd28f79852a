"""The piezo actuator: hysteresis and creep between applied voltage and tool displacement.

    identification = identify([Record(t_s, u_v, y_um)])
    y_um = identification.model.predict(t_s, u_v)
    estimator = Estimator(identification.model)      # estimator.tick(u_v, dt_s) -> µm
    inverse = Inverse(identification.model)          # inverse.tick(y_um, dt_s) -> V

Names are loaded when they are first asked for: a run needs the estimator, not the identification.
"""

from importlib import import_module

_PLACES = {
    "Estimator": "model",
    "Inverse": "inverse",
    "Record": "record",
    "identify": "identification",
    "validate": "validation",
}


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
