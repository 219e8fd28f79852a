"""The machine as a procedure sees it: one interface in µm, V and s, and its implementation over a link."""
