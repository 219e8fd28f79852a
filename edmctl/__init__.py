"""Controller for a micro-EDM machine whose tool hangs on an amplified piezo actuator."""

__version__ = "0.1.0"
