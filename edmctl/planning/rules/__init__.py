"""Cross-field rules of a profile, and loading one checked by them."""
