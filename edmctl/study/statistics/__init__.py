"""Design of experiments: which runs to make, and what their responses say. Pure maths on arrays."""
