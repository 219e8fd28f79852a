"""Whether host and controller speak the same protocol, and which of them to update if not."""

from __future__ import annotations

import struct

from edmctl.errors import ProtocolMismatch
from edmctl.link.messages import PROTO_MAJOR, PROTO_MINOR, SCHEMA_HASH

# The first ten bytes of a HELLO reply mean the same in every version.
_FIXED_PART = struct.Struct("<BBII")


def check_hello(payload: bytes, name: str) -> None:
    """Raise ProtocolMismatch where the reply to HELLO tells of another major version or another schema."""
    if len(payload) < _FIXED_PART.size:
        raise ProtocolMismatch(
            f"What answers at {name} does not speak EDM Link.",
            hint="Check that this is the controller's port.",
        )
    major, minor, _, schema_hash = _FIXED_PART.unpack_from(payload)
    if major == PROTO_MAJOR and schema_hash == SCHEMA_HASH:
        return
    verdict, hint = _verdict((major, minor))
    raise ProtocolMismatch(
        f"The controller at {name} speaks EDM Link {major}.{minor} (schema {schema_hash:08X}), "
        f"this program {PROTO_MAJOR}.{PROTO_MINOR} (schema {SCHEMA_HASH:08X}): {verdict}.",
        hint=hint,
    )


def _verdict(controller: tuple[int, int]) -> tuple[str, str]:
    host = (PROTO_MAJOR, PROTO_MINOR)
    if controller < host:
        return "the controller is older", "Update the controller's firmware."
    if controller > host:
        return "this program is older", "Update edmctl."
    return (
        "both claim the same version but their messages differ, so one is an unreleased build",
        "Install a released edmctl and the firmware released with it.",
    )
