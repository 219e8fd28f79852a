"""The machine as a procedure sees it: one port in µm, V and s, and its implementation over a link."""
