"""What each shipped profile makes, in a line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.errors import ProfileError
from edmctl.profile.forecast import forecast
from edmctl.profile.load import load_profile
from edmctl.profile.shipped import shipped_names

if TYPE_CHECKING:
    from edmctl.profile.setup import Setup


@dataclass(frozen=True, slots=True)
class Summary:
    """A profile and its forecast; `refused` says why the machine cannot run it, and the forecast is None then."""

    profile: str
    name: str
    description: str
    time_s: float | None
    depth_um: float | None
    holes: int | None
    channel_um: float | None
    tool_wear_um: float | None
    refused: str = ""


def summaries(setup: Setup) -> list[Summary]:
    """A summary of every shipped profile, for a machine."""
    return [_summary(name, setup) for name in shipped_names()]


def _summary(name: str, setup: Setup) -> Summary:
    try:
        loaded = load_profile(name, setup=setup)
    except ProfileError as error:
        return Summary(name, name, "", None, None, None, None, None, refused=error.message)
    expected, meta = forecast(loaded.profile, setup, loaded.places), loaded.profile.meta
    return Summary(
        profile=name,
        name=meta.name,
        description=meta.description,
        time_s=expected.time_s,
        depth_um=expected.depth_um,
        holes=expected.holes,
        channel_um=expected.channel_um,
        tool_wear_um=expected.tool_wear_um,
    )
