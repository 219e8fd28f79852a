"""The firmware's core as a library in this process: how it is built, and how it is called."""
