#!/bin/sh
# Two holes with two electrodes, and a look at the last one: each step is a process of its own.
# The virtual machine lives in bench.h5; with a port of hardware in EDMCTL_PORT the same lines drive that.
set -eu
export EDMCTL_PORT=sim:bench.h5

# Once for each machine: the actuator's model, which `machine` then finds by the serial number.
edmctl calibrate --json > calibration.json

# Where the tool that is in the machine meets the pad. Later touches are compared with it.
edmctl measure-wear --reference --profile cu150

# Each hole gets the next free place. A tool without a reference takes the first touch of its job for one.
for p in cu150 cu270; do edmctl machine --profile $p --out runs --json >> results.jsonl || exit; done

# What the tool has lost since its reference, and how deep its last hole is, by touching both again.
edmctl measure-wear --json
