"""What procedures and jobs report: plain values that jobs keep, the console renders and scripts read."""
