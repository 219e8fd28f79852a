"""The run file: what it holds, how it is written so that a crash loses nothing, how it is read."""
