"""Settings of a server, which every program that starts one passes on whole."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec

from zensim.proto.settings.engine_settings import EngineKeywords, EngineSettings
from zensim.proto.settings.lockstep_settings import LockstepSettings
from zensim.proto.settings.pace_settings import PaceKeywords, PaceSettings


class ServerSettings(msgspec.Struct, frozen=True, kw_only=True):
    """How a server simulates its worlds."""

    physics: EngineSettings = EngineSettings()
    pace: PaceSettings = PaceSettings()
    lockstep: LockstepSettings = LockstepSettings()


USUAL_SERVER: Final = ServerSettings()
"""Settings of a server that is told nothing."""


class WorldKeywords(EngineKeywords, PaceKeywords, total=False):
    """How a world is loaded and simulated, as keyword arguments."""

    model_paths: Sequence[str | Path]
    """Folders with the models and meshes that the world file includes."""
    strict: bool
    """Refuse a world file with warnings."""
    allow_missing: bool
    """Leave out models and collisions whose file is missing."""
