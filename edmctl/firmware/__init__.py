"""Images of boards: building, reading and flashing them."""
