"""Settings of all tests."""

from __future__ import annotations

import signal

from hypothesis import settings

# A busy machine is no failure, the same tree gives the same examples, and nothing is left in the tree.
settings.register_profile("edmctl", deadline=None, derandomize=True, database=None)
settings.load_profile("edmctl")

# Whoever starts the tests may ignore signals (nohup does); the processes that tests start would inherit that.
for _name in ("SIGINT", "SIGTERM", "SIGHUP"):
    _number = getattr(signal, _name, None)
    if _number is not None and signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.default_int_handler if _name == "SIGINT" else signal.SIG_DFL)
