"""Makes Python source and tables from the protocol's data files; needed by developers only."""
