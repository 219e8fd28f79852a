"""What is done about the gap while a cut runs: supervision, limits, jumps, recoveries."""
