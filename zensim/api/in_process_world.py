"""World: a simulation in this process, without network, other clients or threads."""

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from zensim.api.api_errors import Closed, Invalid, Timeout, Unsupported
from zensim.api.collision_watch import CollisionWatch
from zensim.api.entity_values import Collision
from zensim.api.simulation import Simulation, read_world_keywords
from zensim.api.world_access import Message, WorldAccess, api_errors
from zensim.api.world_host import CLIENT, NO_RATES, WorldHost
from zensim.api.world_pool import POOL
from zensim.api.world_session import SavedOrders
from zensim.api.world_state import WorldState, make_world_state
from zensim.api.world_view import WorldView
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.agent_messages import TwistCommands
from zensim.proto.messages.simulation_messages import SimulateStepsRequest
from zensim.proto.service_catalog import SIMULATE_STEPS, Request, Response, Service
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.proto.settings.pace_settings import PaceSettings
from zensim.proto.settings.rate_settings import RateOverrides
from zensim.proto.settings.server_settings import ServerSettings, WorldKeywords
from zensim.proto.settings.start_settings import StartSettings
from zensim.sim_server.server_config import ServerConfig
from zensim.spawner.client.topic_reader import TopicReader, read_as

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from zensim.api.in_process_recorder import InProcessRecorder

replace = msgspec.structs.replace
IN_PROCESS = ServerSettings(
    start=StartSettings(paused=True),
    physics=EngineSettings(engine="mujoco", compiles_ahead=False).limit_workers(0),
    pace=PaceSettings(rtf=0.0),
)
"""Settings of a world in process, which keywords change."""
NO_CLOCK_HINT = "use run_for(), step() or steps(), or zensim.launch(rtf=1) for a world that runs"


class InProcessAccess(WorldAccess):
    """Operations on a world of this process; nothing waits, so timeouts have no effect."""

    has_own_clock = False

    def __init__(self, server: WorldHost) -> None:
        self.server = server
        self.world_name = server.world.name
        self._process_id = os.getpid()
        self._view: WorldView | None = None
        self._state: WorldState | None = None
        self._before: WorldState | None = None

    @property
    def client(self) -> str:
        """See `WorldAccess`."""
        return CLIENT

    @property
    def view(self) -> WorldView:
        """The state of all entities as live arrays."""
        self._require_open()
        if self._view is None or not self._view.is_current:
            self._view = WorldView(self.server.world)
        return self._view

    def _apply_view(self) -> None:
        if self._view is not None and self._view.is_current:
            self._view.apply()

    def _refresh_view(self) -> None:
        if self._view is not None and self._view.is_current:
            self._view.refresh()
        else:
            self._view = None

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
        if self._view is None:
            return self.server.call(service, request)
        self._apply_view()
        response = self.server.call(service, request)
        self._refresh_view()
        return response

    def save(self, orders: SavedOrders) -> bytes:
        """Write the state of the world and orders as bytes."""
        self._require_open()
        self._apply_view()
        return self.server.save(orders)

    def restore(self, snapshot: bytes) -> SavedOrders:
        """Replace the state by a saved one; return the orders that were saved with it."""
        self._require_open()
        orders = self.server.restore(snapshot, SavedOrders([], {}))
        self._state = self._view = None
        return orders

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

    def subscribe(self, key: str, kind: type[Message], depth: int) -> TopicReader[Message]:
        """See `WorldAccess`."""
        self._require_open()
        return TopicReader(self.server.subscribe(key, depth), read_as(kind))

    def publish(self, key: str, message: msgspec.Struct) -> None:
        """See `WorldAccess`."""
        self._require_open()
        encoding = make_encoding(message, Format.CDR)
        self.server.publish(key, encode(message, Format.CDR), encoding)

    def record(
        self, path: Path, topics: Sequence[str], rate: float, timeout_s: float
    ) -> "InProcessRecorder":
        """See `WorldAccess`."""
        # Imported here: most worlds are not recorded.
        from zensim.api.in_process_recorder import InProcessRecorder  # noqa: PLC0415

        del timeout_s
        self._require_open()
        return InProcessRecorder(self.server, path, topics, rate)

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


class World(Simulation):
    """A simulated world in this process: no network, no other clients, no agents to start.

    It is paused: time moves in `run_for`, `step`, `steps` and `wait_until` only, as fast as it
    can. Equal orders give the bytes of a server in lockstep.
    """

    def __init__(
        self,
        world: str | Path = "empty",
        *,
        rates: Mapping[str, RateOverrides] = NO_RATES,
        **options: "Unpack[WorldKeywords]",
    ) -> None:
        """Load a world.

        Args:
            world: Name of a shipped world, or an SDF file.
            rates: Of odometry and tf, by name of the robot; else those of its description.
            options: See `WorldKeywords`; `engine` is `mujoco` unless it is given.

        Raises:
            Invalid: There is no such world, its engine is not installed, or a number is out of
                range.
        """
        settings = read_world_keywords(world, options, IN_PROCESS)
        with api_errors():
            self._open(WorldHost(ServerConfig(settings=settings), rates))

    def _open(self, server: WorldHost) -> None:
        self._server = server
        self._access = InProcessAccess(server)
        super().__init__(self._access)

    @property
    def view(self) -> WorldView:
        """The state of all entities as live arrays, which may be written."""
        self._session.check_open()
        return self._access.view

    def watch_collisions(self) -> None:
        """Read the contacts of all robots after each step from now on; see `find_collision`."""
        self._session.check_open()
        self._server.collision_watch = CollisionWatch(self._server.world)

    def find_collision(self, name: str) -> Collision | None:
        """Find the first collision of a robot since it was spawned and is watched.

        The ground is no collision, nor is anything fixed that carries the robot.

        Raises:
            Invalid: `watch_collisions` was not called.
            NotFound: There is no entity of this name.
        """
        self._session.check_open()
        if (watch := self._server.collision_watch) is None:
            raise Invalid("collisions are not watched", hint="call watch_collisions() first")
        self._session.find_row(name)
        return watch.find(name)

    def snapshot(self) -> bytes:
        """Save the whole state: of the engine, entities, drives, odometry, sensors and orders.

        Raises:
            Unsupported: The engine cannot save its state.
        """
        self._session.check_open()
        with api_errors():
            return self._access.save(self._session.save_orders())

    def restore(self, snapshot: bytes) -> None:
        """Replace the state by a saved one, of this world or another; the run goes on bit by bit.

        Robots spawned since are gone, and those deleted since are back. Subscriptions stay, and
        have no message until the next one.

        Args:
            snapshot: As `snapshot()` returned it, also in another process of the same version.

        Raises:
            Invalid: These bytes are not a snapshot of this version and engine.
            Unsupported: The engine cannot restore it in this world.
        """
        self._session.check_open()
        if not isinstance(snapshot, bytes):
            raise Invalid(f"snapshot={str(snapshot)[:40]!r} are no bytes", hint="use snapshot()")
        with api_errors():
            self._session.load_orders(self._access.restore(snapshot))
        self._session.access.refresh()
        self._info = self._read_info()

    def fork(self) -> "World":
        """Make another world in the same state; both go on alone, with equal bits.

        Raises:
            Unsupported: The engine cannot copy its state.
        """
        self._session.check_open()
        if not self._server.world.engine.capabilities.copies:
            raise Unsupported(
                f"the engine {self._info.engine} cannot copy its state", hint="use MuJoCo"
            )
        config = self._server.config.requested or self._server.config
        other = World.__new__(World)
        other._open(WorldHost(config, self._server.rates))  # noqa: SLF001
        other.restore(self.snapshot())
        return other

    def play(self) -> None:
        """Refuse: time moves only when this program asks for it.

        Raises:
            Unsupported: Always.
        """
        raise Unsupported("a world in process does not run by itself", hint=NO_CLOCK_HINT)


def get_server(world: World) -> WorldHost:
    """Return what is behind a world: for what is built on it, such as `zensim.envs`.

    Raises:
        Closed: The world is closed.
    """
    world._session.check_open()  # noqa: SLF001
    return world._server  # noqa: SLF001
