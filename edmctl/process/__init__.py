"""The discharge process as pure functions: voltage law, erosion, servo stability, jumps, wear arithmetic."""
