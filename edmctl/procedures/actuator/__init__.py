"""The actuator during a run: conditioning, the estimator, a run without a sensor, the calibration record."""
