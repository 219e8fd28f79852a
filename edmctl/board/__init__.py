"""Images of boards, flashing them, and the first start of a new machine."""
