"""The actuator during a run: its estimator, a run without a sensor, the calibration record."""
