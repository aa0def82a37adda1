"""Settings of a server, which every program that starts one passes on whole."""

import msgspec

from zensim.proto.settings.engine_settings import EngineKeywords, EngineSettings
from zensim.proto.settings.lockstep_settings import LockstepSettings
from zensim.proto.settings.pace_settings import PaceKeywords, PaceSettings
from zensim.proto.settings.start_settings import StartKeywords, StartSettings


class ServerSettings(msgspec.Struct, frozen=True, kw_only=True):
    """How a server simulates its worlds."""

    start: StartSettings = StartSettings()
    physics: EngineSettings = EngineSettings()
    pace: PaceSettings = PaceSettings()
    lockstep: LockstepSettings = LockstepSettings()


class WorldKeywords(StartKeywords, EngineKeywords, PaceKeywords, total=False):
    """How a world is loaded and simulated, as keyword arguments."""
