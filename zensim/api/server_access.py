"""ServerAccess: a world on a server, by a session of its own."""

import math
import os
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from zensim.api.api_errors import Closed, ConnectionLost, Timeout
from zensim.api.call_deadline import LEAST_S, limit
from zensim.api.step_channel import StepChannel
from zensim.api.world_access import Message, WorldAccess, api_errors
from zensim.api.world_state import WorldState, make_world_state
from zensim.proto import keys
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.bus.bus_session import Bus
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode, make_encoding
from zensim.proto.messages.agent_messages import TwistCommands, split_orders
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.sensing_messages import SensorStats
from zensim.proto.messages.simulation_messages import (
    JoinLockstepRequest,
    SimulateStepsRequest,
    SimulateStepsResponse,
)
from zensim.proto.messages.telemetry_messages import InfoRequest, Snapshot
from zensim.proto.security.role_checks import require_role
from zensim.proto.security.roles import Operation, User
from zensim.proto.service_catalog import (
    INFO,
    JOIN_LOCKSTEP,
    SIMULATE_STEPS,
    Request,
    Response,
    Service,
    require_ok,
)
from zensim.proto.topic_catalog import SENSOR_STATS, SNAPSHOT, TWISTS
from zensim.spawner.client.driven_count import NotDriven, wait_until_driven
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.client.topic_reader import TopicReader, read_as, read_topic

if TYPE_CHECKING:
    from zensim.api.recorder_process import RecorderProcess
    from zensim.proto.bus.bus_session import BusPublisher, LivelinessToken

POLL_S = 0.01
FRESH_S = 0.01
"""Wall time for which a state of a reply is taken for the newest."""
SILENCE_S = 2.0
"""Wall time without a state after which the server is asked whether it is there."""
GET_TIMEOUT_S = 1.0
MAX_LOST_STEPS = 3
"""Published requests that may be lost before all are queries."""
LOST_S = 0.5
"""A repeated request that is answered sooner was lost, or its response was."""
TOKEN_TIMEOUT_S = 2.0
"""Limit on the delay until the server has received the token of this client."""
CALL_TIMEOUT_S = 10.0
SUBSCRIBER_TIMEOUT_S = 1.0
SENSOR_TIMEOUT_S = 30.0
"""Limit on the start of a sensor process, with its libraries and meshes."""


class ServerAccess(WorldAccess):
    """A world on a server."""

    role = ""
    """Role of this client's user, once it is known; empty if the server is not secured."""
    _joined = (0, 0)
    """Epoch and step of the last control step that `join` waited for."""

    def __init__(
        self,
        bus: Bus,
        world: str,
        *,
        watch: Callable[[], None] = lambda: None,
        on_close: Callable[[], None] = lambda: None,
        starts_sensors: bool = False,
    ) -> None:
        """Subscribe to states of the world.

        Args:
            bus: Session; closed with this.
            world: Name of the world.
            watch: Called now and then while a call waits; raises if a program of ours has ended.
            on_close: Called before the session is closed.
            starts_sensors: Whether a sensor process of ours starts with the first sensor.
        """
        self.world_name = world
        self.bus = bus
        self._watch = watch
        self._on_close = on_close
        self._starts_sensors = starts_sensors
        self._process = os.getpid()
        self._is_closed = False
        self._client = f"client_{uuid.uuid4().hex[:12]}"
        self._token: LivelinessToken | None = None
        self._bond: tuple[str, LivelinessToken] | None = None
        self._publishers: dict[tuple[str, type], BusPublisher] = {}
        self._has_feeds = False
        """Whether topics were used, whose messages must precede the end of a step."""
        self._states = read_topic(bus, SNAPSHOT.key(world), Snapshot)
        self._received_s = time.monotonic()
        self._replied_s = -math.inf
        """Wall time of the last state that came as a reply."""
        self._steps: StepChannel | None = None
        self._lost_steps = 0
        """Published requests of steps that were lost, one after the other."""
        self._state = make_world_state(Snapshot(0, 0, 0, 0, (), b"", b""))
        self._read_first_state()

    def _read_first_state(self) -> None:
        try:
            self.refresh()
        except ConnectionLost:
            with suppress(NoServer, TimeoutError, ServiceError):
                self.role = self.bus.call(
                    INFO, InfoRequest(), world=self.world_name, timeout_s=limit(GET_TIMEOUT_S)
                ).role
            self._require_role(Operation.QUERY, SNAPSHOT.key(self.world_name))
            raise

    @property
    def client(self) -> str:
        """See `WorldAccess`."""
        return self._client

    @property
    def is_connected(self) -> bool:
        """Whether the server has published or replied within the last seconds."""
        try:
            self.newest()
        except (Closed, ConnectionLost):
            return False
        return True

    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str = "",
        timeout_s: float = CALL_TIMEOUT_S,
        request_id: str = "",
    ) -> Response:
        """See `WorldAccess`."""
        self._require_open()
        timeout_s = limit(timeout_s)
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                response = self.bus.call(
                    service,
                    request,
                    world=world or self.world_name,
                    timeout_s=max(LEAST_S, deadline - time.monotonic()),
                    request_id=request_id,
                )
            except NoServer as error:  # noqa: PERF203  once per wait
                self._watch()
                # A server that starts again may reply; a request that changes it is not repeated.
                if service.is_mutating or time.monotonic() > deadline:
                    raise ConnectionLost(f"the server at {self.bus.endpoint} is gone") from error
            except TimeoutError as error:
                self._watch()
                raise Timeout(f"{service.name} got no reply within {timeout_s:g} s") from error
            else:
                self._received_s = time.monotonic()
                return response

    def advance(self, steps: int, twists: TwistCommands | None, timeout_s: float) -> WorldState:
        """See `WorldAccess`."""
        self._declare()
        request = SimulateStepsRequest(
            steps,
            client=self._client,
            twists=twists,
            wants_snapshot=True,
            is_eager=self.is_eager and not self._has_feeds,
        )
        response = self._request_steps(request, timeout_s)
        if response.snapshot is None:
            return self.refresh()
        return self._replace(response.snapshot)

    def _request_steps(
        self, request: SimulateStepsRequest, timeout_s: float
    ) -> SimulateStepsResponse:
        """Request steps by topics, except for the first ones, which take the lease."""
        if self._steps is None:
            response = self._retry_early(
                lambda: self.call(SIMULATE_STEPS, request, timeout_s=timeout_s)
            )
            if self._lost_steps < MAX_LOST_STEPS:
                self._steps = StepChannel(self.bus, self.world_name, self._client)
            return response
        began_s = time.monotonic()
        if (found := self._steps.call(request, timeout_s)) is not None:
            self._lost_steps = 0
            return require_ok(SIMULATE_STEPS, found)
        self._watch()
        return self._repeat_steps(request, began_s + timeout_s)

    def _repeat_steps(
        self, request: SimulateStepsRequest, deadline_s: float
    ) -> SimulateStepsResponse:
        """Send a published request again as a query, which the server takes for a retry of it."""
        request_id = self._steps.request_id if self._steps is not None else ""
        began_s = time.monotonic()
        response = self.call(
            SIMULATE_STEPS,
            request,
            timeout_s=max(LEAST_S, deadline_s - began_s),
            request_id=request_id,
        )
        if time.monotonic() - began_s < LOST_S:
            self._lost_steps += 1
        if self._lost_steps >= MAX_LOST_STEPS and self._steps is not None:
            # The network does not pass these messages, as where users have roles.
            self._steps.close()
            self._steps = None
        return response

    def join(self, steps: int, twists: TwistCommands | None, timeout_s: float) -> WorldState:
        """Finish the control step that this returned last, and wait for the next one.

        Args:
            steps: Between two of these control steps.
            twists: Orders that act in the next control step.
            timeout_s: Wall time.

        Raises:
            ServiceError: It was refused.
            Timeout: No control step came in time.
            ConnectionLost: The server is gone.
        """
        self._declare()
        request = JoinLockstepRequest(self._client, steps, *self._joined, twists)
        response = self._retry_early(lambda: self.call(JOIN_LOCKSTEP, request, timeout_s=timeout_s))
        state = self.refresh() if response.snapshot is None else self._replace(response.snapshot)
        self._joined = state.order
        return state

    def newest(self) -> WorldState:
        """See `WorldAccess`."""
        if self._process != os.getpid() or self._is_closed:
            self._require_open()
        now_s = time.monotonic()
        if now_s - self._replied_s < FRESH_S:
            return self._state
        if (snapshot := self._states.newest()) is not None:
            self._received_s = now_s
            self._state = make_world_state(snapshot, self._state)
        elif now_s - self._received_s > SILENCE_S:
            self.refresh()
        return self._state

    def refresh(self) -> WorldState:
        """See `WorldAccess`."""
        self._require_open()
        for sample in self.bus.get(SNAPSHOT.key(self.world_name), limit(GET_TIMEOUT_S)):
            self._received_s = time.monotonic()
            return self._replace(decode(Snapshot, sample.payload, sample.encoding))
        self._watch()
        raise ConnectionLost(
            f"the server of world '{self.world_name}' at {self.bus.endpoint} does not reply"
        )

    def command(self, twists: TwistCommands) -> None:
        """See `WorldAccess`."""
        self._declare()
        for part in split_orders(twists):
            self.publish(TWISTS.key(self.world_name), part)

    def subscribe(self, key: str, kind: type[Message], depth: int) -> TopicReader[Message]:
        """See `WorldAccess`."""
        self._require_open()
        self._require_role(Operation.SUBSCRIBE, key)
        self._has_feeds = True
        subscription, read = self.bus.subscribe(key, depth), read_as(kind)
        first = []
        for sample in self.bus.get(key, limit(GET_TIMEOUT_S))[-1:]:
            with suppress(MalformedPayload):
                first.append(read(sample))
        return TopicReader(subscription, read, first=first)

    def publish(self, key: str, message: msgspec.Struct) -> None:
        """See `WorldAccess`."""
        self._require_open()
        self._find_publisher(key, type(message)).send(encode(message, _find_form(key)))

    def await_subscriber(self, key: str, kind: type[msgspec.Struct]) -> None:
        """See `WorldAccess`; returns after some time where no agent is."""
        publisher = self._find_publisher(key, kind)
        deadline = time.monotonic() + limit(SUBSCRIBER_TIMEOUT_S)
        while not publisher.is_matched and time.monotonic() < deadline:
            self._watch()
            time.sleep(POLL_S)

    def _find_publisher(self, key: str, kind: type[msgspec.Struct]) -> "BusPublisher":
        if (key, kind) not in self._publishers:
            self._require_role(Operation.PUBLISH, key)
            encoding = make_encoding(kind, _find_form(key))
            self._publishers[key, kind] = self.bus.advertise(key, encoding)
        return self._publishers[key, kind]

    def wait_until_driven(self, names: Sequence[str], timeout_s: float) -> None:
        """See `WorldAccess`."""
        self._require_open()
        client = SimClient(self.bus, self.world_name)
        try:
            wait_until_driven(client, names, limit(timeout_s), lambda _: self._watch())
        except NoServer as error:
            raise ConnectionLost(f"the server at {self.bus.endpoint} is gone") from error
        except NotDriven as error:
            raise Timeout(
                str(error).partition("; ")[0],
                slug="no_agent",
                hint="start one with 'zensim agent --pool', or give agent='external'",
            ) from error

    def await_sensor(self, entity: str, sensor: str) -> None:
        """See `WorldAccess`; returns at once where no sensor process runs or can measure it."""
        deadline = time.monotonic() + limit(SENSOR_TIMEOUT_S)
        while (found := self._read_sensor_stats()) or self._starts_sensors:
            rows = [
                (stats.is_active and one.has_subscribers, one.is_measured)
                for stats in found
                for one in stats.sensors
                if (one.entity, one.sensor) == (entity, sensor)
            ]
            if any(is_ready or not is_measured for is_ready, is_measured in rows):
                return
            if time.monotonic() > deadline:
                raise Timeout(
                    f"sensor '{sensor}' of '{entity}' is not measured after {SENSOR_TIMEOUT_S:g} s",
                    slug="no_sensor_process",
                    hint="start one with 'zensim sensors run'",
                )
            self._watch()
            time.sleep(POLL_S)

    def _read_sensor_stats(self) -> list[SensorStats]:
        self._require_open()
        samples = self.bus.get(SENSOR_STATS.key(self.world_name, "*"), limit(GET_TIMEOUT_S))
        found = []
        for sample in samples:
            with suppress(MalformedPayload):
                found.append(decode(SensorStats, sample.payload, sample.encoding))
        return found

    def hold_bond(self) -> str:
        """See `WorldAccess`."""
        self._require_open()
        if self._bond is None:
            name = f"bond_{uuid.uuid4().hex[:16]}"
            self._require_role(Operation.DECLARE_TOKEN, keys.bond(self.world_name, name))
            self._bond = name, self.bus.token(keys.bond(self.world_name, name))
        return self._bond[0]

    def record(
        self, path: Path, topics: Sequence[str], rate: float, timeout_s: float
    ) -> "RecorderProcess":
        """See `WorldAccess`."""
        # With all that reads and writes recordings.
        from zensim.api.recorder_process import RecorderProcess  # noqa: PLC0415

        self._require_open()
        options = (*(topics or ("--all",)), "--rate", f"{rate:g}")
        return RecorderProcess(self.bus.endpoint, self.world_name, path, options, timeout_s)

    def end_lease(self) -> None:
        """Return the world to its former mode, and stop what this client commands."""
        if self._token is not None:
            self._token.close()
            self._token = None
            if self._steps is not None:
                self._steps.close()
                self._steps = None
            # A name whose token has disappeared is not used again.
            self._client = f"client_{uuid.uuid4().hex[:12]}"

    def close(self) -> None:
        """See `WorldAccess`."""
        if self._is_closed:
            return
        self._is_closed = True
        if self._process == os.getpid():
            if self._token is not None:
                self._token.close()
            if self._bond is not None:
                self._bond[1].close()
            self._on_close()
            self.bus.close()

    def _replace(self, snapshot: Snapshot) -> WorldState:
        """Take the snapshot of a reply; states that were published before it are dropped."""
        self._states.newest()
        self._received_s = self._replied_s = time.monotonic()
        self._state = make_world_state(snapshot, self._state)
        return self._state

    def _declare(self) -> None:
        self._require_open()
        if self._token is None:
            key = keys.alive_client(self.world_name, self._client)
            self._require_role(Operation.DECLARE_TOKEN, key)
            self._token = self.bus.token(key)

    def _require_role(self, operation: Operation, key: str) -> None:
        """Refuse what the router of a secured server drops without a reply.

        Raises:
            Denied: The role does not permit it.
        """
        with api_errors():
            require_role(User(self.bus.user, self.role), self.world_name, operation, key)

    def _retry_early(self, call: Callable[[], Response]) -> Response:
        """Repeat a call while the server has not received the token of this client."""
        deadline = time.monotonic() + limit(TOKEN_TIMEOUT_S)
        while True:
            try:
                return call()
            except ServiceError as error:
                is_early = (
                    error.code == ResultCode.INCORRECT_STATE
                    and "no liveliness token" in error.message
                )
                if not is_early or time.monotonic() > deadline:
                    raise
            time.sleep(POLL_S)

    def _require_open(self) -> None:
        if self._process != os.getpid():
            raise Closed("this simulation belongs to the parent process", slug="forked")
        if self._is_closed:
            raise Closed("this simulation is closed")


def _find_form(key: str) -> Format:
    return Format.MSGPACK if key.startswith("sim/") else Format.CDR
