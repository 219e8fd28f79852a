"""The piezo actuator: hysteresis and creep between applied voltage and tool displacement."""
