"""Many simulated runs: seeds, sweeps and their statistics."""
