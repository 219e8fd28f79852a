"""Touches: readings of a surface, the reference pad, the bottom, and the approach to the spark gap."""
