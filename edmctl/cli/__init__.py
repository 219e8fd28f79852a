"""The command line: parse, call one procedure, render, exit code."""
