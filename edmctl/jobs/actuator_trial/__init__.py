"""`simulate actuator`: waveforms through a virtual actuator and the models of it."""
