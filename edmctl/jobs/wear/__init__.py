"""`measure-wear`: what the ledger knows before it, and the procedure."""
