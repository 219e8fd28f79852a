"""The recipe of a job and the machine's own settings: models, reading with positions, calibration files."""
