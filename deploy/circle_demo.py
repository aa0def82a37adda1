"""Drives the robots of `zensim up` in circles, each until something else commands it.

One order is enough, without states of the world: those of 10,000 robots are 45 MB a second. Nor
is numpy imported, which takes 15 MB.
"""

import struct
import time
import uuid
from collections.abc import Iterable, Sequence

from zensim.api.local_deployment import OPERATOR, LocalDeployment
from zensim.deploy.demo_patterns import RADIUS, SPEED
from zensim.deploy.other_commands import OtherCommands
from zensim.deploy.up_driver import UpDriver
from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.agent_messages import TwistCommands, split_orders
from zensim.proto.topic_catalog import TWISTS
from zensim.spawner.client.sim_client import SimClient

CIRCLE = struct.pack("<3d", SPEED, 0.0, SPEED / RADIUS)
PLAY_POLL_S = 0.2
"""Time between two questions whether a world that was started paused plays."""
RELEASED = struct.pack("<3d", *[float("nan")] * 3)


class CircleDemo(UpDriver):
    """Orders circles once the world plays; `update` has to be called often.

    A robot that gets a `cmd_vel`, or an order of another client, is left to that for good.
    """

    def __init__(self, bus: Bus, endpoint: str, world: str, names: Sequence[str]) -> None:
        self._ours = dict.fromkeys(names)
        self._has_ordered = False
        self._sim = SimClient(bus, world)
        self._next_s = 0.0
        self._client = f"client_{uuid.uuid4().hex[:12]}"
        self._others = OtherCommands(bus, world, self._client)
        # A session of its own, which ends with the demo; so do its orders.
        self._session = open_bus(BusConfig(connect=(endpoint,)))
        self._token = self._session.token(keys.alive_client(world, self._client))
        self._orders = self._session.advertise(TWISTS.key(world), TWISTS.encoding)

    @property
    def is_over(self) -> bool:
        """Whether no robot is left to command."""
        return not self._ours

    def update(self) -> None:
        """Leave robots that others command; order the rest once."""
        taken = [name for name in self._others.take() if name in self._ours]
        for name in taken:
            del self._ours[name]
        if self._has_ordered:
            self._order(taken, RELEASED)
        elif self._is_playing():
            self._has_ordered = True
            self._order(self._ours, CIRCLE)

    def close(self) -> None:
        """End; the robots stop."""
        self._others.close()
        self._session.close()

    def _is_playing(self) -> bool:
        """Whether the world plays; False between two questions."""
        if time.monotonic() < self._next_s:
            return False
        self._next_s = time.monotonic() + PLAY_POLL_S
        try:
            return self._sim.info().state == "playing"
        except (NoServer, TimeoutError):
            return False

    def _order(self, names: Iterable[str], twist: bytes) -> None:
        entities = tuple(names)
        if not entities:
            return
        orders = TwistCommands(self._client, entities, twist * len(entities))
        for part in split_orders(orders):
            self._orders.send(encode(part, Format.MSGPACK))


def make_circle_demo(deployment: LocalDeployment) -> CircleDemo:
    """Make the demo of the robots of a deployment."""
    config = deployment.config
    names = [one.name for one in config.placements]
    return CircleDemo(deployment.bus, config.address_of(OPERATOR), config.network.world_name, names)
