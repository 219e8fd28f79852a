"""EDM Link: frames, messages, sessions, and the transports that carry them."""
