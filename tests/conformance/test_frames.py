"""L1 to L5 and L24: frames, damage, garbage."""

from __future__ import annotations

from random import Random

import pytest

from tests.conformance import layouts, wire
from tests.conformance.acts import lead
from tests.conformance.peer import STATUS, STATUS_NAMES, Peer

NAMES = layouts.golden_names()
GOLDEN_SESSION = 0x5A
COMMANDS = sorted(layouts.COMMANDS)
# What a controller in IDLE may say to the recorded commands; None: the frame changes the session itself.
IDLE_STATUS = {
    "HELLO": {"OK", "VERSION"},
    "HEARTBEAT": {"OK"},
    "GET_SCHEMA": {"OK"},
    "ADVANCE": {"OK", "UNKNOWN_TYPE"},
    "GET_STATUS": {"OK"},
    "ARM": {"PROFILE_MISMATCH"},
    "COMMIT_PROFILE": {"PROFILE_MISMATCH"},
    "SET_PARAM": {"OK", "OUT_OF_RANGE"},
    "GET_PARAM": {"OK", "OUT_OF_RANGE"},
    "PULSE_CONFIG": {"OK", "OUT_OF_RANGE"},
    "PULSE_ENABLE": {"OK", "BAD_STATE"},
    "TLM_START": {"OK", "OUT_OF_RANGE", "RATE_TOO_HIGH"},
    "TLM_STOP": {"OK"},
    "BLACKBOX_READ": {"OK"},
    "WAVEFORM_READ": {"OK"},
    "REBOOT": {"OK"},
}
AT_STRINGS = [
    b"AT\r",
    b"ATE0\r\n",
    b"AT+GCAP\r\n",
    b"ATI\rAT+CGMI\rAT+CGMM\r",
    b"+++ATH0\r",
    bytes.fromhex("7e0078f07e"),
    b"\x00\x00\x00AT+CPIN?\r\x00",
]


def bad_frames(peer: Peer) -> int:
    count: int = peer.fresh_beat()["rx_bad"]
    return count


def session_of_the_recordings(peer: Peer, seq: int) -> None:
    """Open the recorded session so that `seq` is the next number."""
    peer.hello()
    peer.seq = (seq - 1) % 256
    peer.hello(session=GOLDEN_SESSION)


@pytest.mark.parametrize("name", NAMES)
def test_l1_the_tables_and_the_recordings_agree(name: str) -> None:
    recorded = layouts.golden(name)
    type_id = int(recorded["type"], 16)
    layout = (layouts.REQUESTS | layouts.ANSWERS)[type_id]
    (piece,) = wire.pieces(layouts.golden_frame(name))
    frame = wire.decode(piece)
    assert frame is not None
    assert frame[:4] == (type_id, recorded["seq"], GOLDEN_SESSION, 0)
    values = layout.unpack(frame.payload)
    assert values is not None
    records = values.pop("records", [])
    assert values == recorded["fields"]
    assert [layout.read_record(r) for r in records] == [pytest.approx(r) for r in recorded.get("records", [])]
    payload = layout.pack(recorded["fields"]) + b"".join(records)
    assert wire.encode(type_id, recorded["seq"], GOLDEN_SESSION, payload) == layouts.golden_frame(name)


@pytest.mark.parametrize("name", COMMANDS)
def test_l1_every_recorded_command_is_answered(peer: Peer, name: str) -> None:
    recorded = layouts.golden(name)
    session_of_the_recordings(peer, recorded["seq"])
    if name == "HEARTBEAT":
        peer.beating, peer.beat = False, None
        peer.write(layouts.golden_frame(name))
        assert peer.wait(lambda: peer.beat, 0.5), peer.story("HEARTBEAT was not answered", "delivery")
        assert peer.beat is not None
        assert peer.beat["t_host_us"] == recorded["fields"]["t_host_us"]
        return
    if name == "ADVANCE":
        peer.driven, peer.beating = False, False
    peer.write(layouts.golden_frame(name))
    reply = peer.reply_to(layouts.NAMES[name], recorded["seq"])
    assert reply is not None, peer.story(f"the recorded {name} was not answered", "delivery")
    status = STATUS_NAMES[reply.status]
    assert status in IDLE_STATUS.get(name, {"BAD_STATE"}), peer.story(f"{name} in IDLE: {status}", "states")
    if name == "HELLO":
        assert reply.host_nonce == recorded["fields"]["host_nonce"]
    if name == "REBOOT":
        assert peer.wait(lambda: peer.boots, 5.0), peer.story("no BOOT after REBOOT", "session")


@pytest.mark.parametrize("name", NAMES)
def test_l2_every_truncation_and_every_flipped_bit_is_dropped_and_counted(peer: Peer, name: str) -> None:
    data = layouts.golden_frame(name)
    session_of_the_recordings(peer, 0)
    damaged = [data[:size] for size in range(1, len(data) - 1)]
    damaged += [data[start:] for start in range(2, len(data))]
    for bit in range(8 * len(data)):
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << (bit % 8)
        damaged.append(bytes(flipped))
    # A zero closes each, so that no two damaged ones can join into a good one.
    stream = [d + b"\0" for d in damaged]
    assert not any(wire.decode(piece) for piece in wire.pieces(b"".join(stream)))
    before = bad_frames(peer)
    lump = b""
    for part in stream:
        lump += part
        if len(lump) > 2000:
            peer.write(lump)
            lump = b""
            peer.fresh_beat()
    peer.write(lump)
    counted = (bad_frames(peer) - before) % 65536
    expected = len(wire.pieces(b"".join(stream)))
    assert not peer.frames, peer.story(f"a damaged {name} was answered: {peer.frames[:1]}", "frame")
    assert counted == expected, peer.story(f"rx_bad rose by {counted} on {expected} damaged frames", "frame")
    assert peer.state() == "IDLE"


def test_l3_garbage_is_never_a_command(peer: Peer) -> None:
    noise = Random(3)
    megabytes = 3.0 if peer.line.virtual_time else 0.2
    dropped = peer.fresh_beat()["rx_drop"]
    for _ in range(round(megabytes * 1e6 / 8192)):
        peer.write(noise.randbytes(8192))
        if not peer.line.virtual_time:
            peer.fresh_beat()
    peer.write(b"\0")
    beat = peer.fresh_beat()
    assert not peer.frames, peer.story("garbage was answered", "frame")
    assert beat["rx_drop"] == dropped, peer.story("garbage passed the check", "frame")
    assert peer.state() == "IDLE"


def damages(noise: Random, clean: bytes) -> bytes:
    """Some damage, as lines do it: noise, a frame with a hole, a flipped bit, half a frame, one doubled byte."""
    kind = noise.randrange(5)
    if kind == 0:
        return noise.randbytes(noise.randrange(1, 400))
    at = noise.randrange(1, len(clean) - 1)
    if kind == 1:
        return clean[:at] + clean[at + 1 + noise.randrange(4) :]
    if kind == 2:
        return clean[:at] + bytes((clean[at] ^ 1 << noise.randrange(8),)) + clean[at + 1 :]
    if kind == 3:
        return clean[:at]
    return clean[: at + 1] + clean[at:]


def test_l4_the_first_clean_frame_after_any_damage_is_answered(peer: Peer) -> None:
    noise = Random(4)
    get_status = layouts.NAMES["GET_STATUS"]
    for _ in range(250 if peer.exact else 60):
        broken = damages(noise, wire.encode(get_status, noise.randrange(256), 0xEE))
        peer.write(broken)
        seq = peer.send("GET_STATUS")
        assert peer.reply_to(get_status, seq, 0.3), peer.story(f"lost after {broken.hex(' ')}", "frame")


def test_l5_frames_of_no_use_are_counted_and_not_fatal(peer: Peer) -> None:
    before = peer.fresh_beat()
    get_status = layouts.NAMES["GET_STATUS"]
    peer.write(b"\0" + b"\x55" * 2000 + b"\0")  # endless
    peer.write(b"\0" + wire.stuff(wire.checked(b"\x04\x01\x02" + bytes(248))) + b"\0")  # good check, too long
    peer.write(b"\0" + wire.stuff(wire.checked(b"\x04\x01\x02")) + b"\0")  # good check, no flags byte
    peer.write(bytes(6) + b"\x01\0")  # empty ones, seven zeros with the one before, and a shortest one
    bad = peer.fresh_beat()
    counted = (bad["rx_bad"] - before["rx_bad"]) % 65536
    assert counted == 4, peer.story(f"rx_bad rose by {counted} on 4 frames that are none", "frame")
    other = peer.session % 255 + 1
    for session in (other, 0):
        peer.send_payload(get_status, b"", session=session)
    peer.send("HELLO", session=0)
    after = peer.fresh_beat()
    dropped = (after["rx_drop"] - bad["rx_drop"]) % 65536
    assert dropped == 3, peer.story(f"rx_drop rose by {dropped} on 3 frames of other sessions", "session")
    assert not peer.frames, peer.story("a frame of no use was answered", "session")
    assert peer.state() == "IDLE"


def test_l5_a_payload_of_the_wrong_length_is_refused(peer: Peer) -> None:
    for name, type_id in layouts.COMMANDS.items():
        if name in ("HELLO", "HEARTBEAT", "ADVANCE"):
            continue
        right = layouts.REQUESTS[type_id].pack({})
        for wrong in (right + b"\0", right[:-1]) if right else (b"\0",):
            seq = peer.send_payload(type_id, wrong)
            reply = peer.reply_to(type_id, seq)
            assert reply is not None, peer.story(f"{name} of {len(wrong)} bytes was not answered", "delivery")
            assert reply.status == STATUS["BAD_LENGTH"], peer.story(f"{name}: {reply}", "status-of-a-reply")
            assert reply.frame.payload == b""
    assert peer.state() == "IDLE"


@pytest.mark.parametrize("type_id", [0x06, 0x2F, 0x3E, 0x3D])
def test_l5_an_unknown_command_is_refused(peer: Peer, type_id: int) -> None:
    seq = peer.send_payload(type_id, b"\x01\x02")
    reply = peer.reply_to(type_id, seq)
    assert reply is not None, peer.story("an unknown command was not answered", "delivery")
    assert reply.status == STATUS["UNKNOWN_TYPE"]


@pytest.mark.parametrize("type_id", [0x00, 0x41, 0x42, 0x7F, 0x80, 0x81, 0xBF, 0xC0, 0xFF])
def test_l5_frames_that_are_no_commands_are_dropped(peer: Peer, type_id: int) -> None:
    """An echoing line sends a controller its own frames; they must neither be answered nor feed the watchdog."""
    before = peer.fresh_beat()["rx_drop"]
    peer.send_payload(type_id, b"\x01\x02")
    dropped = (peer.fresh_beat()["rx_drop"] - before) % 65536
    assert not peer.frames, peer.story(f"a frame of type {type_id:02x} was answered", "frame")
    assert dropped == 1, peer.story(f"rx_drop rose by {dropped} on a frame that is no command", "frame")


def test_l24_what_modem_probes_send_at_open_has_no_effect(peer: Peer) -> None:
    lead(peer, "armed")
    for text in AT_STRINGS:
        peer.write(text)
    peer.fresh_beat()
    assert not peer.frames, peer.story("a modem string was answered", "line")
    assert not peer.faults
    assert peer.state() == "ARMED"
