"""What people and scripts see: diagnostics, tables, progress and the JSON object."""
