"""A channel: its layers, passes and touches, its result, and channels taken up again."""
