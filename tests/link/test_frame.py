"""Frames survive any line: what is damaged is dropped, what follows is found, an abort is never missed."""

from __future__ import annotations

import random
import zlib
from itertools import pairwise

import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from edmctl.link.frame import ABORT, MAX_PAYLOAD, Frame, FrameDecoder, encode_frame
from tests.conformance import wire

byte = st.integers(0, 255)
frames = st.builds(Frame, byte, byte, byte, byte, st.binary(max_size=MAX_PAYLOAD))


def encoded(frame: Frame) -> bytes:
    return encode_frame(*frame)


def in_pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    places = sorted({0, len(data), *(cut % (len(data) + 1) for cut in cuts)})
    return [data[start:end] for start, end in pairwise(places)]


@given(st.lists(frames, max_size=5), st.lists(st.integers(0, 2000), max_size=8))
def test_frames_cut_anywhere_come_out_whole_and_are_never_an_abort(
    sent: list[Frame], cuts: list[int]
) -> None:
    decoder = FrameDecoder()
    stream = b"".join(map(encoded, sent))
    assert [f for piece in in_pieces(stream, cuts) for f in decoder.feed(piece)] == sent
    assert decoder.bad == 0
    assert not decoder.abort_seen


@given(st.binary(max_size=600), frames, st.lists(st.integers(0, 900), max_size=4))
def test_the_first_clean_frame_after_garbage_is_found(garbage: bytes, frame: Frame, cuts: list[int]) -> None:
    decoder = FrameDecoder()
    found = [f for piece in in_pieces(garbage + encoded(frame), cuts) for f in decoder.feed(piece)]
    assert found == [frame]


def test_a_payload_of_zeros_holds_no_zero_on_the_line() -> None:
    data = encode_frame(1, 0, 0, 0, bytes(MAX_PAYLOAD))
    assert data.count(0) == 2
    assert data[0] == data[-1] == 0
    assert len(data) == 4 + MAX_PAYLOAD + 4 + 1 + 2


def test_the_longest_frame_without_a_zero_passes() -> None:
    frame = Frame(255, 255, 255, 255, b"\xff" * MAX_PAYLOAD)
    assert FrameDecoder().feed(encoded(frame)) == [frame]


@pytest.mark.parametrize("header", [(256, 0, 0, 0), (0, -1, 0, 0)])
def test_header_bytes_beyond_a_byte_are_refused(header: tuple[int, int, int, int]) -> None:
    with pytest.raises(ValueError, match="byte"):
        encode_frame(*header, b"")


def test_a_payload_too_long_is_refused() -> None:
    with pytest.raises(ValueError, match="247 bytes, 246 fit"):
        encode_frame(1, 2, 3, 4, bytes(247))


def test_a_valid_check_does_not_save_a_frame_that_is_too_long_or_too_short() -> None:
    decoder = FrameDecoder()
    for size in (3, 251):
        body = bytes(range(1, 1 + size))
        data = cobs.encode(body + zlib.crc32(body).to_bytes(4, "little"))
        assert decoder.feed(b"\0" + data + b"\0") == []
    assert decoder.bad == 2


def test_an_endless_frame_is_one_bad_frame_and_costs_no_memory() -> None:
    decoder = FrameDecoder()
    for _ in range(100):
        decoder.feed(b"\x55" * 10_000)
    assert len(decoder._partial) <= 256
    good = Frame(1, 2, 3, 4, b"x")
    assert decoder.feed(encoded(good)) == [good]
    assert decoder.bad == 1


def test_megabytes_of_noise_yield_nothing() -> None:
    decoder = FrameDecoder()
    noise = random.Random(7)
    assert not any(decoder.feed(noise.randbytes(1 << 18)) for _ in range(12))
    assert decoder.bad > 5_000


def test_single_bytes_are_as_good_as_a_buffer() -> None:
    decoder = FrameDecoder()
    frame = Frame(0x41, 9, 8, 0, bytes(range(200)))
    found = [f for value in encoded(frame) for f in decoder.feed(bytes((value,)))]
    assert found == [frame]


@given(st.binary(max_size=300), st.lists(st.integers(0, 400), max_size=6))
def test_an_abort_is_seen_from_any_state_however_it_arrives(before: bytes, cuts: list[int]) -> None:
    decoder = FrameDecoder()
    for piece in in_pieces(before + ABORT, cuts):
        decoder.feed(piece)
    assert decoder.abort_seen


def test_an_abort_inside_a_frame_is_seen_and_the_next_frame_still_read() -> None:
    decoder = FrameDecoder()
    frame = Frame(0x10, 1, 2, 0, b"abcdef")
    whole = encoded(frame)
    assert decoder.feed(whole[:6] + ABORT) == []
    assert decoder.abort_seen
    assert decoder.feed(whole) == [frame]


@pytest.mark.parametrize(("zeros", "is_abort"), [(7, False), (8, True)])
def test_eight_zeros_are_an_abort_and_seven_are_not(zeros: int, is_abort: bool) -> None:
    for piece in (1, 3, 8):
        decoder = FrameDecoder()
        stream = b"\x07" + bytes(zeros) + b"\x07"
        for start in range(0, len(stream), piece):
            decoder.feed(stream[start : start + piece])
        assert decoder.abort_seen is is_abort


def test_an_abort_acted_on_does_not_come_back_by_itself() -> None:
    decoder = FrameDecoder()
    decoder.feed(ABORT)
    decoder.abort_seen = False
    decoder.feed(encode_frame(1, 2, 3, 4, b""))
    assert not decoder.abort_seen
    decoder.feed(ABORT)
    assert decoder.abort_seen


damages = st.tuples(st.integers(0, 3000), st.integers(0, 300), st.binary(max_size=60))


@given(st.lists(frames, min_size=1, max_size=8), damages)
def test_damage_takes_only_what_it_touches(sent: list[Frame], wound: tuple[int, int, bytes]) -> None:
    """A span is replaced by other bytes: what lies wholly before or behind it arrives, and nothing false does."""
    parts = list(map(encoded, sent))
    stream = b"".join(parts)
    start = wound[0] % (len(stream) + 1)
    end = min(len(stream), start + wound[1])
    found = FrameDecoder().feed(stream[:start] + wound[2] + stream[end:])
    ends = [sum(map(len, parts[: number + 1])) for number in range(len(parts))]
    whole = [
        frame
        for frame, part, last in zip(sent, parts, ends, strict=True)
        if last <= start or last - len(part) >= end
    ]
    remaining = list(found)
    for frame in whole:
        remaining.remove(frame)
    assert all(frame in sent for frame in remaining)


@given(st.lists(frames, max_size=4), st.binary(max_size=400), st.lists(st.integers(0, 2000), max_size=8))
def test_an_independent_decoder_finds_the_same(sent: list[Frame], noise: bytes, cuts: list[int]) -> None:
    stream = noise.join(map(encoded, sent)) + noise
    decoder, other = FrameDecoder(), wire.Receiver()
    found = [f for piece in in_pieces(stream, cuts) for f in decoder.feed(piece)]
    assert list(map(tuple, found)) == list(map(tuple, other.feed(stream)))
    assert decoder.bad == len(other.bad)


@given(frames)
def test_an_independent_encoder_sends_the_same_bytes(frame: Frame) -> None:
    assert encoded(frame) == wire.encode(*frame[:3], frame.payload, frame.flags)
