"""WorldFollower: which entities a world has, who drives them, and whether a server has it."""

import math
import time
from collections.abc import Callable
from collections.abc import Set as AbstractSet
from typing import Final, TypeAlias

import msgspec

from zensim.proto import keys
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.telemetry_messages import Event, EventKind, GetModelsResponse
from zensim.proto.network_protocols import FollowingNetwork
from zensim.proto.topic_catalog import EVENTS
from zensim.spawner.client.service_client import ServiceClient
from zensim.spawner.client.topic_reader import read_topic

TIMEOUT_S: Final = 2.0
"""Longest wait for the models of a world."""
SETTLE_S: Final = 0.1
"""More events are awaited for so long: robots are spawned, claimed and deleted in groups."""
PERIOD_S: Final = 0.3
"""Least time between two calls."""
SHARE: Final = 0.2
"""Largest part of the time in which calls wait: the models of a large fleet take longer."""
EVENTS_DEPTH: Final = 1024
"""One event of a group is enough, so those beyond may be lost."""
ENTITY_EVENTS: Final[AbstractSet[EventKind]] = frozenset(
    {"spawned", "deleted", "reset", "loaded", "unloaded"}
)
"""Events that change which entities there are."""
AGENT_EVENTS: Final[AbstractSet[EventKind]] = ENTITY_EVENTS | {"claimed", "released"}
"""Events that change entities or their agents."""
FAILURES: Final = (BusError, ServiceError, TimeoutError, MalformedPayload)
"""What a call raises where no server replies, or it replies something else."""

Fetch: TypeAlias = Callable[[], GetModelsResponse | None]
"""Requests the models; None if that failed."""


class WorldChanges(msgspec.Struct, frozen=True):
    """What was heard of a world since the last look."""

    servers: tuple[bool, ...] = ()
    """Changes of servers, oldest first: true = it appeared, false = it went."""
    events: tuple[Event, ...] = ()


class WorldFollower:
    """Requests the models of a world at first, and when something says that they have changed.

    That is a server that appears, an event, or a snapshot with another roster. A call that fails
    is repeated. The last models stay until a server gives others.
    """

    def __init__(
        self,
        network: FollowingNetwork,
        world: str,
        *,
        kinds: AbstractSet[EventKind] = AGENT_EVENTS,
        period_s: float = PERIOD_S,
        timeout_s: float = TIMEOUT_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Subscribe.

        Args:
            network: Open session, which stays open.
            world: Name of the world.
            kinds: Events after which models are requested.
            period_s: Least time between two calls [s]; 0 = each other roster is requested at once.
            timeout_s: Longest wait of a call [s].
            clock: Wall time from any origin [s].
        """
        self._client = ServiceClient(network, world, timeout_s)
        self._kinds, self._period_s, self._clock = kinds, period_s, clock
        self._servers = network.watch_tokens(keys.alive_server(world))
        self._events = read_topic(network, EVENTS.key(world), Event, EVENTS_DEPTH)
        self._due_s = self._free_s = -math.inf
        self._is_fetching = False
        self.models: GetModelsResponse | None = None
        """The newest ones; None before the first reply."""
        self.is_current = False
        """Whether no server has appeared since they were requested."""
        self.problem = ""
        """Why the last call failed; empty if it did not."""

    def close(self) -> None:
        """Undeclare the subscriptions."""
        self._servers.close()
        self._events.close()

    def take(self) -> WorldChanges:
        """Take what was heard since the last call, and note whether models are due."""
        servers = tuple(is_alive for _, is_alive in self._servers.take())
        events = tuple(self._events.take())
        if any(servers):
            self.is_current = False
            self._due_s = self._free_s = -math.inf
        if any(one.kind in self._kinds for one in events):
            self._due_s = min(self._due_s, self._clock() + SETTLE_S)
        return WorldChanges(servers, events)

    def note_roster(self, roster: int) -> None:
        """Note the roster of a snapshot: another one than that of the models makes them due."""
        if self.models is None or self.models.roster != roster:
            self.request_soon()

    def request_soon(self) -> None:
        """Make models due at once."""
        self._due_s = -math.inf

    def take_fetch(self) -> Fetch | None:
        """Take the call that is due; None if there is none.

        It blocks for the timeout at most, and may be called in another thread; `accept` takes what
        it returns.
        """
        if self._is_fetching or self._clock() < max(self._due_s, self._free_s):
            return None
        self._due_s, self._is_fetching = math.inf, True
        return self._fetch

    def accept(self, models: GetModelsResponse) -> None:
        """Replace the models."""
        self.models, self.is_current = models, True

    def poll(self) -> bool:
        """Make the call that is due; return whether there are new models."""
        fetch = self.take_fetch()
        models = fetch() if fetch is not None else None
        if models is not None:
            self.accept(models)
        return models is not None

    def _fetch(self) -> GetModelsResponse | None:
        began_s = self._clock()
        try:
            models = self._client.models()
            self.problem = ""
        except FAILURES as error:
            models, self.problem = None, str(error)
            self.request_soon()
        ended_s = self._clock()
        pause_s = max(self._period_s or PERIOD_S, (ended_s - began_s) * (1.0 / SHARE - 1.0))
        self._free_s = ended_s + (pause_s if self._period_s or models is None else 0.0)
        self._is_fetching = False
        return models
