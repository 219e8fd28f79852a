"""The nets of a machine as its builder knows them: their names, and the pins of the NUCLEO-F429ZI."""

ESTOP, DOOR = "e-stop (PG0)", "door (PG1)"
LEVEL, SUPPLY_OK = "dielectric level (PG3)", "high voltage ok (PG2)"
FLOW, TEMPERATURE, LIMITS = "flow (PF4)", "temperature (PF10)", "limit switches (PG4)"
CONTACT, GAP, CURRENT = "contact (PF13)", "gap voltage (PC0)", "gap current (PC3)"
MONITOR, DISPLACEMENT = "actuator monitor (PF3)", "displacement (PF5)"
DAC = "actuator DAC (PE2, PE6, PE4)"
GATE_SENSE = "gate sense (PA3)"
GATE, BREAK, MODE, ALIVE = "gate (PE9)", "break chain (PE15)", "mode switch (PF14)", "alive (PF15)"
OPEN_VOLTAGE, IGNITION = "open voltage set (PA4)", "ignition (PA0, PC6)"
STEPS = ("X step (PF6)", "Y step (PF7)", "theta step (PF8)")
DIRECTIONS = ("X direction (PF0)", "Y direction (PF1)", "theta direction (PF2)")
LINE = "line (PD8, PD9)"
