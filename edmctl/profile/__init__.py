"""The recipe and the machine's own settings: loading with positions, checking, forecasting."""

from edmctl.profile.load import LoadedProfile, load_profile, load_setup
from edmctl.profile.model import Profile
from edmctl.profile.setup import Setup

__all__ = ["LoadedProfile", "Profile", "Setup", "load_profile", "load_setup"]
