"""Fuzz target: the frame decoder on any bytes, in any pieces.

`python tests/fuzz/fuzz_decoder.py -runs=1000000` (needs atheris, in the extra `fuzz`; libFuzzer's options work).
"""

from __future__ import annotations

import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.fuzz.driver import coverage_guided, fuzz, recorded_frames

with coverage_guided(__name__ == "__main__"):
    from edmctl.link.frame import Frame, FrameDecoder, encode_frame

PROBE = Frame(0x02, 1, 2, 0, b"still there")


def one_input(data: bytes) -> None:
    """Feed `data` whole and in pieces that it chooses itself, and hold the two against each other."""
    whole = FrameDecoder()
    frames = whole.feed(data)
    pieces = FrameDecoder()
    found: list[Frame] = []
    at = 0
    while at < len(data):
        size = 1 + data[at] % 23
        found += pieces.feed(data[at : at + size])
        at += size
    assert found == frames, "the pieces matter"
    assert (pieces.bad, pieces.abort_seen) == (whole.bad, whole.abort_seen), "the pieces matter"
    assert whole.abort_seen == (bytes(8) in data), "an abort missed or invented"
    assert len(frames) + whole.bad == sum(1 for part in data.split(b"\0")[:-1] if part), (
        "a part is not counted"
    )
    for frame in frames:
        encoded = encode_frame(*frame)
        assert encoded in b"\0" + data, "a frame that nobody sent"
        assert FrameDecoder().feed(encoded) == [frame]
    # Its first zero may complete a frame that the input left open.
    assert whole.feed(encode_frame(*PROBE))[-1:] == [PROBE], "a clean frame lost"


if __name__ == "__main__":
    fuzz(one_input, recorded_frames(), sys.argv)
