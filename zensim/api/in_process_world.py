"""World: a simulation in this process, without network, other clients or threads."""

import math
import os
from collections.abc import Sequence
from pathlib import Path

import msgspec

from zensim.api.api_errors import Closed, Timeout, Unsupported
from zensim.api.in_process_network import InProcessSubscription
from zensim.api.in_process_server import CLIENT, POOL, InProcessServer
from zensim.api.simulation import Simulation
from zensim.api.world_access import Message, TopicFeed, WorldAccess, api_errors
from zensim.api.world_state import WorldState, make_world_state
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.agent_messages import TwistCommands
from zensim.proto.messages.simulation_messages import SimulateStepsRequest
from zensim.proto.service_catalog import SIMULATE_STEPS, Request, Response, Service
from zensim.proto.topic_catalog import ROBOT_TOPICS, TOPICS, Participant
from zensim.sim_server.physics.engine_config import EngineOptions, parse_engine_name
from zensim.sim_server.server_config import CONTROL_HZ, ServerConfig

NO_CLOCK_HINT = "use run_for(), step() or steps(), or zensim.launch(rtf=1) for a world that runs"


class InProcessFeed(TopicFeed[Message]):
    """Messages of one topic of this process."""

    def __init__(self, subscription: InProcessSubscription, kind: type[Message]) -> None:
        self._subscription = subscription
        self._kind = kind

    def take(self, *, newest_only: bool = False) -> list[Message]:
        """See `TopicFeed`."""
        samples = self._subscription.take()
        wanted = samples[-1:] if newest_only else samples
        return [decode(self._kind, one.payload, one.encoding) for one in wanted]

    def close(self) -> None:
        """See `TopicFeed`."""
        self._subscription.close()


class InProcessAccess(WorldAccess):
    """Operations on a world of this process; nothing waits, so timeouts have no effect."""

    def __init__(self, server: InProcessServer) -> None:
        self.server = server
        self.world_name = server.world.name
        self._process_id = os.getpid()
        self._state: WorldState | None = None
        self._before: WorldState | None = None

    @property
    def client(self) -> str:
        """See `WorldAccess`."""
        return CLIENT

    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str = "",
        timeout_s: float = math.inf,
        request_id: str = "",
    ) -> Response:
        """See `WorldAccess`."""
        del world, timeout_s, request_id
        self._require_open()
        self._state = None
        return self.server.call(service, request)

    def advance(self, steps: int, twists: TwistCommands | None, timeout_s: float) -> WorldState:
        """See `WorldAccess`."""
        del timeout_s
        request = SimulateStepsRequest(steps, client=CLIENT, twists=twists)
        self.call(SIMULATE_STEPS, request)
        return self.newest()

    def newest(self) -> WorldState:
        """See `WorldAccess`."""
        if self._state is None:
            self._require_open()
            self._state = self._before = make_world_state(self.server.snapshot(), self._before)
        return self._state

    def refresh(self) -> WorldState:
        """See `WorldAccess`."""
        self._state = None
        return self.newest()

    def command(self, twists: TwistCommands) -> None:
        """Refuse: this world does not run by itself."""
        del twists
        raise Unsupported("a world in process does not run by itself", hint=NO_CLOCK_HINT)

    def subscribe(self, key: str, kind: type[Message], depth: int) -> TopicFeed[Message]:
        """See `WorldAccess`."""
        self._require_open()
        _require_published(key)
        return InProcessFeed(self.server.subscribe(key, depth), kind)

    def publish(self, key: str, message: msgspec.Struct) -> None:
        """See `WorldAccess`."""
        self._require_open()
        encoding = make_encoding(message, Format.CDR)
        self.server.network.advertise(key, encoding).send(encode(message, Format.CDR))

    def wait_until_driven(self, names: Sequence[str], timeout_s: float) -> None:
        """Check that the pool drives these robots: it claims them when they are spawned."""
        del timeout_s
        claims = self.server.world.claims
        if missing := [name for name in names if claims.agent_of(name) != POOL]:
            raise Timeout(f"robot '{missing[0]}' is not driven", slug="not_driven")

    def hold_bond(self) -> str:
        """Return no bond: the world ends with this process."""
        return ""

    def close(self) -> None:
        """See `WorldAccess`."""
        if os.getpid() == self._process_id:
            self.server.close()

    def _require_open(self) -> None:
        if not self.server.close.alive:
            raise Closed("this world is closed", hint="make another World()")


def _require_published(key: str) -> None:
    """Refuse topics of sensor processes, which a world in process does not have."""
    suffix = key.rpartition("/")[2]
    found = [one for one in (*ROBOT_TOPICS.values(), *TOPICS.values()) if one.suffix == suffix]
    if found and all(one.publisher is Participant.SENSORS for one in found):
        raise Unsupported(
            f"topic '{key}' is published by a sensor process, which a world in process lacks",
            hint="use zensim.launch(sensors=1), or cast_rays()",
        )


class World(Simulation):
    """A simulated world in this process: no network, no other clients, no agents to start.

    It is paused: time moves in `run_for`, `step`, `steps` and `wait_until` only, as fast as it
    can. Equal orders give the bytes of a server in lockstep.
    """

    def __init__(
        self,
        world: str | Path = "empty",
        *,
        engine: str = "mujoco",
        seed: int = 0,
        step_hz: float | None = None,
        control_hz: float | None = None,
    ) -> None:
        """Load a world.

        Args:
            world: Name of a shipped world, or an SDF file.
            engine: `mujoco`, or `pybullet`.
            seed: Of the noise of sensors.
            step_hz: Steps of the engine per simulated second; None = as the world's file says,
                else 240.
            control_hz: Most control steps per simulated second; None = 100.

        Raises:
            Invalid: There is no such world, or a number is out of range.
        """
        with api_errors():
            config = ServerConfig(
                world_file=str(world),
                seed=seed,
                step_hz=step_hz,
                control_hz=CONTROL_HZ if control_hz is None else control_hz,
                is_paused=True,
                real_time_factor=0.0,
                physics=EngineOptions(
                    engine=parse_engine_name(engine), workers=0, compiles_ahead=False
                ),
            )
            self._server = InProcessServer(config)
        super().__init__(InProcessAccess(self._server))

    def play(self) -> None:
        """Refuse: time moves only when this program asks for it.

        Raises:
            Unsupported: Always.
        """
        raise Unsupported("a world in process does not run by itself", hint=NO_CLOCK_HINT)
