"""The services of a replay, below `sim/WORLD/replay/`."""

from typing import Final

import msgspec

from zensim.proto.messages.replay_messages import (
    ReplayPlayNextRequest,
    ReplayReport,
    ReplayRequest,
    ReplaySeekRequest,
    ReplaySetRateRequest,
)
from zensim.proto.service_catalog import Service

REPLAY_PREFIX: Final = "replay"

GET_STATE = Service(f"{REPLAY_PREFIX}/get_state", ReplayRequest, ReplayReport)
PAUSE = Service(f"{REPLAY_PREFIX}/pause", ReplayRequest, ReplayReport, is_mutating=True)
RESUME = Service(f"{REPLAY_PREFIX}/resume", ReplayRequest, ReplayReport, is_mutating=True)
TOGGLE = Service(f"{REPLAY_PREFIX}/toggle", ReplayRequest, ReplayReport, is_mutating=True)
SEEK = Service(f"{REPLAY_PREFIX}/seek", ReplaySeekRequest, ReplayReport, is_mutating=True)
SET_RATE = Service(
    f"{REPLAY_PREFIX}/set_rate", ReplaySetRateRequest, ReplayReport, is_mutating=True
)
PLAY_NEXT = Service(
    f"{REPLAY_PREFIX}/play_next", ReplayPlayNextRequest, ReplayReport, is_mutating=True
)

REPLAY_SERVICES: dict[str, Service[msgspec.Struct, msgspec.Struct]] = {
    one.name: one for one in tuple(vars().values()) if isinstance(one, Service)
}
"""Every service of a replay, by name."""
