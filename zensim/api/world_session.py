"""WorldSession: what all handles of one simulation share: state, roster, orders, topics, time."""

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import msgspec
import numpy as np

from zensim.api.api_errors import Closed, ConnectionLost, Invalid, NotFound, Timeout, Unsupported
from zensim.api.argument_checks import check_range
from zensim.api.call_deadline import check_deadline
from zensim.api.odometry_table import TABLE_DEPTH, OdometryTable
from zensim.api.topic import Topic, TopicDispatcher
from zensim.api.world_access import Message, WorldAccess, api_errors
from zensim.api.world_state import FloatArray, WorldState
from zensim.proto.messages.agent_messages import Claim, FleetOdometry, TwistCommands
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.sensing_messages import Environment
from zensim.proto.messages.sensor_messages import CameraSensor, RaySensor
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.messages.telemetry_messages import PROTOCOL, Info
from zensim.proto.near_names import name_choices
from zensim.proto.path_following import PathController, steer_each
from zensim.proto.se3 import to_yaw
from zensim.proto.topic_catalog import (
    CMD_VEL,
    CONTROLLER_COMMANDS,
    FLEET_ODOMETRY,
    JOINT_COMMANDS,
    JOINT_STATES,
    ODOM,
    ROBOT_DESCRIPTION,
    ROBOT_TOPICS,
    TF,
    TF_STATIC,
    TOPICS,
    Participant,
    TopicSpec,
)
from zensim.robot_agent.topic_remapping import find_topic_keys
from zensim.spawner.client.service_client import CALL_TIMEOUT_S, ServiceClient

TWIST_COLUMNS = 3
"""Forward, left [m/s], turn [rad/s]."""
RELEASED = np.full(TWIST_COLUMNS, np.nan)
POLL_S = 0.002
MAX_CHUNK_S = 0.5
"""Simulation time of one request, so that an interrupt and progress come through."""
STEP_TIMEOUT_S = 30.0
"""Wall time of one request of steps."""
MAX_RUN_S = 1e7
MIN_WAIT_S, MAX_SLOWNESS = 10.0, 20.0
"""Wall time that a wait in a running world may take: a base, and a factor of simulation time."""
MAX_ORDERS = 64
"""Orders that wait for the next step before they are merged."""


@dataclass(frozen=True)
class RosterEntry:
    """An entity as `get_models` describes it."""

    name: str
    namespace: str
    agent: str
    model: Model


@dataclass(frozen=True)
class Roster:
    """Entities and the environment, as of one roster number."""

    number: int
    entries: dict[str, RosterEntry]
    environment: Environment

    @property
    def robots(self) -> tuple[str, ...]:
        """Names of the entities that an agent serves: with a drive, or joints, as an arm."""
        return tuple(name for name, one in self.entries.items() if one.model.needs_agent)


@dataclass(frozen=True)
class SavedOrders:
    """What a client has ordered, and the world does not know yet."""

    twists: list[tuple[tuple[str, ...], FloatArray]]
    paths: dict[str, PathController]


class WorldSession:
    """One world, as the handles of a simulation use it."""

    def __init__(self, access: WorldAccess) -> None:
        self.access = access
        self.client = ServiceClient(access, access.world_name)
        self.dispatcher = TopicDispatcher()
        self.steps_lock = threading.RLock()
        self.controllers: list[Callable[[float], None]] = []
        """Called before each control step, with the control period [s]."""
        self._roster: Roster | None = None
        self._paths: dict[str, PathController] = {}
        self._control_thread: threading.Thread | None = None
        self._orders: list[tuple[tuple[str, ...], FloatArray]] = []
        self._dispatch_thread: threading.Thread | None = None
        self._topics: dict[tuple[str, type[msgspec.Struct]], Topic[Any]] = {}
        self._odometry: OdometryTable | None = None
        self.is_joined = False
        """Whether the world awaits this client at its control steps; see `Sim.join_lockstep`."""
        self._is_closed = False

    @property
    def is_closed(self) -> bool:
        """Whether `close` was called."""
        return self._is_closed

    def check_open(self) -> None:
        """Raise what a callback has raised, or that the simulation is closed."""
        if self._is_closed:
            raise Closed("this simulation is closed")
        self.dispatcher.raise_failure()

    def state(self) -> WorldState:
        """Return the newest state."""
        if self._is_closed:
            raise Closed("this simulation is closed")
        return self.access.newest()

    def forget(self) -> None:
        """Forget orders, paths and models: the world was reset or replaced."""
        self._orders, self._roster = [], None
        self._paths.clear()

    def save_orders(self) -> SavedOrders:
        """Take the orders that wait for the next step, and the paths that robots follow."""
        return SavedOrders(self._orders, self._paths)

    def load_orders(self, saved: SavedOrders) -> None:
        """Replace the orders and paths, after the world was replaced."""
        self.forget()
        self._orders, self._paths = saved.twists, saved.paths
        for topic in self._topics.values():
            topic.clear()
        if self._odometry is not None:
            self._odometry.close()
            self._odometry = None
            self.odometry()

    def close(self) -> None:
        """Stop what this client commands, and free all; may be repeated."""
        if not self._is_closed:
            self._is_closed = True
            for topic in self._topics.values():
                topic.close()
            if self._odometry is not None:
                self._odometry.close()
            self.access.close()

    def odometry(self) -> OdometryTable:
        """Return the odometry of all robots, which is subscribed from the first call on."""
        self.check_open()
        if self._odometry is None:
            key = FLEET_ODOMETRY.key(self.access.world_name, "*")
            self._odometry = OdometryTable(self.access.subscribe(key, FleetOdometry, TABLE_DEPTH))
        return self._odometry

    def find_row(self, name: str) -> tuple[WorldState, int]:
        """Find the newest state and the row of an entity.

        Raises:
            NotFound: It does not exist any more.
        """
        state = self.state()
        if (row := state.row.get(name)) is None:
            raise NotFound(
                f"entity '{name}' does not exist any more",
                slug="entity_gone",
                hint="spawn it again, or check 'exists' before",
            )
        return state, row

    def roster(self) -> Roster:
        """Return models and namespaces of the present entities; a round trip after a change."""
        number = self.state().snapshot.roster
        if self._roster is None or self._roster.number != number:
            self._roster = self.read_roster()
        return self._roster

    def read_roster(self, timeout_s: float = CALL_TIMEOUT_S) -> Roster:
        """Read models, namespaces and agents of the present entities."""
        with api_errors():
            found = ServiceClient(self.access, self.access.world_name, timeout_s).models()
        entries = {
            one.entity: RosterEntry(one.entity, one.namespace, one.agent, found.models[one.model])
            for one in found.entities
        }
        self._roster = Roster(found.roster, entries, found.environment)
        return self._roster

    def find_entry(self, name: str) -> RosterEntry:
        """Find an entity by name.

        Raises:
            NotFound: There is none of this name.
        """
        entries = self.roster().entries
        if (entry := entries.get(name)) is None:
            raise make_not_found("entity", name, entries)
        return entry

    def order(self, names: Sequence[str], twists: FloatArray) -> None:
        """Order twists (n, 3): now, or with the next step of a world that this client steps."""
        for name in names if self._paths else ():
            self._paths.pop(name, None)
        self._send(tuple(names), twists)

    def _send(self, names: tuple[str, ...], twists: FloatArray) -> None:
        if self.runs_by_itself:
            self.access.command(self._make_commands(names, twists))
            return
        self._orders.append((names, twists))
        if len(self._orders) > MAX_ORDERS:
            self._orders = [_merge_orders(self._orders)]

    @property
    def is_playing(self) -> bool:
        """Whether simulation time advances without requests."""
        return self.access.has_own_clock and self.state().snapshot.state == "playing"

    @property
    def runs_by_itself(self) -> bool:
        """Whether simulation time may advance while the caller does something else."""
        return not self.is_joined and self.is_playing

    @property
    def control_steps(self) -> int:
        """Steps between two control steps."""
        return max(1, self._environment.control_steps)

    @property
    def step_ns(self) -> int:
        """Duration of a step [ns]."""
        return self._environment.step_ns

    @property
    def _environment(self) -> Environment:
        return (self._roster or self.roster()).environment

    def advance(
        self, steps: int, timeout_s: float = STEP_TIMEOUT_S, *, is_eager: bool = False
    ) -> WorldState:
        """Make steps of a paused world, with controllers and callbacks at each control step.

        Args:
            steps: Their number.
            timeout_s: Wall time of each request.
            is_eager: See `WorldAccess.is_eager`.
        """
        self.check_open()
        if self.is_joined:
            raise Invalid(
                "this client has joined lockstep, where others make the steps",
                slug="joined",
                hint="iterate over the control steps of the block",
            )
        state = self.state()
        if self._roster is None:
            self.read_roster(timeout_s)
        with self.steps_lock:
            while steps > 0:
                check_deadline()
                count = min(steps, self._chunk_steps(steps, state))
                self._control(count * self.step_ns / NANOSECONDS)
                self.access.is_eager = is_eager
                with api_errors():
                    state = self.access.advance(count, self.take_orders(), timeout_s)
                steps -= count
                if self.dispatcher.has_callbacks:
                    self.dispatcher.dispatch()
                    self.dispatcher.raise_failure()
        return state

    def follow(
        self, join: Callable[[TwistCommands | None], WorldState], period_s: float
    ) -> WorldState:
        """Finish a control step of a client that has joined, with controllers and callbacks.

        Args:
            join: Sends the orders, and waits for the next control step.
            period_s: Between two of these control steps [s].
        """
        self.check_open()
        self._control(period_s)
        with api_errors():
            state = join(self.take_orders())
        if self.dispatcher.has_callbacks:
            self.dispatcher.dispatch()
            self.dispatcher.raise_failure()
        return state

    def run(self, seconds: float, timeout_s: float | None = None) -> WorldState:
        """Advance simulation time: by steps, or by waiting in a world that runs by itself."""
        self.check_open()
        check_range("seconds", seconds, 0.0, MAX_RUN_S)
        if not self.runs_by_itself:
            steps = round(seconds * NANOSECONDS / self.step_ns)
            return self.advance(steps, STEP_TIMEOUT_S if timeout_s is None else timeout_s)
        end = self.state().time + seconds
        wall_s = MIN_WAIT_S + MAX_SLOWNESS * seconds if timeout_s is None else timeout_s
        return self.wait(lambda state: state.time >= end, wall_s)

    def follow_path(self, name: str, control: PathController) -> None:
        """Drive a robot by a controller until it is over or another order comes."""
        self.check_open()
        self.find_row(name)
        self._paths[name] = control
        self._start_control_thread()

    def attach(self, control: Callable[[float], None]) -> Callable[[], None]:
        """Call a function before each control step, with the period [s]; return what ends it."""
        self.check_open()
        self.controllers.append(control)
        self._start_control_thread()

        def detach() -> None:
            if control in self.controllers:
                self.controllers.remove(control)

        return detach

    def _start_control_thread(self) -> None:
        if self.runs_by_itself and self._control_thread is None:
            self._control_thread = threading.Thread(target=self._control_running, daemon=True)
            self._control_thread.start()

    def _control_running(self) -> None:
        """Call the controllers at each new state while the world runs by itself."""
        before = self.state()
        while (self._paths or self.controllers) and not self._is_closed:
            with suppress(Closed, ConnectionLost):
                state = self.state()
                if state.order > before.order and self.runs_by_itself:
                    period_s = (state.snapshot.time_ns - before.snapshot.time_ns) / NANOSECONDS
                    before = state
                    self._control(max(0.0, period_s))
            time.sleep(POLL_S)
        self._control_thread = None

    def _control(self, period_s: float) -> None:
        for control in self.controllers[:]:
            control(period_s)
        if self._paths:
            self._control_paths()

    def _control_paths(self) -> None:
        state = self.state()
        aims, over = dict[str, tuple[float, float, float]](), list[str]()
        for name, path in list(self._paths.items()):
            row = state.row.get(name)
            aimed = None if row is None else path.aim(*state.base[row, :2].tolist())
            if aimed is not None:
                aims[name] = aimed
                continue
            self._paths.pop(name, None)
            if row is not None:
                over.append(name)
        twists = np.zeros((len(aims) + len(over), 3))
        if aims:
            headings = to_yaw(state.base[[state.row[name] for name in aims], 3:7])
            twists[: len(aims), ::2] = steer_each(headings, list(aims.values()))
        if len(twists):
            self._send((*aims, *over), twists)

    def wait(self, is_over: Callable[[WorldState], bool], timeout_s: float) -> WorldState:
        """Wait in a world that runs by itself.

        Raises:
            Timeout: It did not happen within this wall time.
            ConnectionLost: The server is gone.
            Invalid: The world was reset meanwhile, or does not run any more.
        """
        deadline = time.monotonic() + timeout_s
        state = self.state()
        epoch = state.snapshot.epoch
        while not is_over(state):
            if time.monotonic() > deadline:
                raise Timeout(f"simulation time {state.time:g} s after {timeout_s:g} s")
            time.sleep(POLL_S)
            self.check_open()
            state = self.state()
            if state.snapshot.epoch != epoch:
                raise Timeout("the simulation was reset meanwhile", slug="reset")
        return state

    def wait_for_next(self, timeout_s: float) -> WorldState:
        """Wait for a newer state of a world that runs by itself."""
        order = self.state().order
        return self.wait(lambda state: state.order > order, timeout_s)

    def find_topic(self, key: str, kind: type[msgspec.Struct] | None = None) -> "Topic[Any]":
        """Find a topic by its key; its class is that of the catalog if it is not given.

        Raises:
            NotFound: The catalog has no such topic.
        """
        if kind is None:
            kind = _find_kind(key)
        if (key, kind) not in self._topics:
            self._topics[key, kind] = self.make_topic(key, kind)
        return self._topics[key, kind]

    def make_topic(self, key: str, kind: type[Message]) -> Topic[Message]:
        """Make another subscription to a topic, which has its own unread messages."""
        topic = Topic(
            self.access,
            self.dispatcher,
            key,
            kind,
            on_callback=self._start_dispatch_thread,
            on_subscribed=lambda: self._await_sensor(key),
        )
        topic.before_first_put = partial(self._prepare_put, key)
        spec = _find_spec(key)
        topic.is_latched = spec is not None and spec.is_latched
        if spec is not None and kind in spec.messages:
            topic.kinds = spec.messages
        return topic

    def find_robot_topic(self, name: str, topic: str) -> "Topic[Any]":
        """Find a topic of a robot by its name below the namespace, as `scan` or `front/scan`."""
        entry = self.find_entry(name)
        known = list_robot_topics(entry)
        if topic not in known:
            raise make_not_found(f"topic of '{name}'", topic, known)
        key, spec = known[topic]
        return self.find_topic(key, spec.messages[0])

    def _prepare_put(self, key: str, kind: type[msgspec.Struct]) -> None:
        """Wait until the agent of a robot subscribes to its topic.

        Raises:
            Invalid: The simulation publishes this topic.
        """
        for entry in self.roster().entries.values():
            if not key.startswith(f"{entry.namespace}/"):
                continue
            topics = list_robot_topics(entry)
            user = Participant.USER
            taken = [name for name, (_, spec) in topics.items() if spec.publisher is user]
            if any(key == own and name not in taken for name, (own, _) in topics.items()):
                raise Invalid(
                    f"{key} is published by the simulation",
                    slug="not_a_command",
                    hint=f"'{entry.name}' takes {', '.join(taken) or 'no commands'}",
                )
            if any(key == topics[name][0] for name in taken):
                self.access.await_subscriber(key, kind)

    def _await_sensor(self, key: str) -> None:
        """Wait until a sensor process has the subscription, so that each run has equal scans."""
        if self.runs_by_itself:
            return
        for entry in self.roster().entries.values():
            for sensor in entry.model.sensors:
                is_process_sensor = isinstance(sensor.settings, RaySensor | CameraSensor)
                names = [f"{entry.namespace}/{topic.name}" for topic in sensor.topics]
                if is_process_sensor and key in names:
                    self.access.await_sensor(entry.name, sensor.name)

    def _start_dispatch_thread(self) -> None:
        # A world of this thread may not be read by another one.
        if self._dispatch_thread is None and self.access.has_own_clock:
            self._dispatch_thread = threading.Thread(target=self._dispatch_running, daemon=True)
            self._dispatch_thread.start()

    def _dispatch_running(self) -> None:
        """Call callbacks while the caller does not step the world."""
        while self.dispatcher.has_callbacks and not self._is_closed:
            with suppress(Closed, ConnectionLost):
                if self.runs_by_itself:
                    self.dispatcher.dispatch()
            time.sleep(POLL_S)
        self._dispatch_thread = None

    def _chunk_steps(self, steps: int, state: WorldState) -> int:
        control_steps = self.control_steps
        left = control_steps - state.snapshot.step % control_steps
        if steps <= left or self.controllers or self._paths or self.dispatcher.has_callbacks:
            return left
        most = max(1, round(MAX_CHUNK_S * NANOSECONDS / self.step_ns / control_steps))
        return left + (most - 1) * control_steps

    def take_orders(self) -> TwistCommands | None:
        """Take the orders for the next step."""
        orders, self._orders = self._orders, []
        if not orders:
            return None
        return self._make_commands(*_merge_orders(orders))

    def _make_commands(self, names: tuple[str, ...], twists: FloatArray) -> TwistCommands:
        return TwistCommands(self.access.client, names, twists.astype("<f8").tobytes())


def _merge_orders(
    orders: list[tuple[tuple[str, ...], FloatArray]],
) -> tuple[tuple[str, ...], FloatArray]:
    """Merge orders; a later one replaces an earlier one of the same robot."""
    if len(orders) == 1:
        return orders[0]
    merged = {name: row for names, rows in orders for name, row in zip(names, rows, strict=True)}
    return tuple(merged), np.array(list(merged.values()))


def make_not_found(what: str, name: str, known: Iterable[str]) -> NotFound:
    """Make an error that names similar names."""
    choices = name_choices(name, known)
    hint = f"there are {choices}" if choices else "there are none"
    return NotFound(f"{what} '{name[:80]}' does not exist", hint=hint)


def _find_kind(key: str) -> type[msgspec.Struct]:
    if (topic := _find_spec(key)) is None:
        raise make_not_found("topic", key.rpartition("/")[2], ROBOT_TOPICS)
    return topic.messages[0]


def _find_spec(key: str) -> TopicSpec | None:
    every = (*ROBOT_TOPICS.values(), *TOPICS.values())
    fitting = (one for one in every if key == one.suffix or key.endswith("/" + one.suffix))
    return next(fitting, None)


def list_robot_topics(entry: RosterEntry) -> dict[str, tuple[str, TopicSpec]]:
    """List the topics of a robot by name below its namespace: key and topic."""
    found: dict[str, tuple[str, TopicSpec]] = {}
    if entry.model.needs_agent:
        keys = find_topic_keys(Claim(0, entry.name, entry.namespace, entry.model))
        found |= {
            topic.name: (key, topic)
            for topic, key in (
                (CMD_VEL, keys.cmd_vel if entry.model.drive is not None else ""),
                (ODOM, keys.odom),
                (TF, keys.tf),
                (TF_STATIC, f"{entry.namespace}/{TF_STATIC.suffix}"),
                (ROBOT_DESCRIPTION, f"{entry.namespace}/{ROBOT_DESCRIPTION.suffix}"),
                (JOINT_STATES, keys.joint_states),
                (JOINT_COMMANDS, keys.joint_commands),
            )
            if key
        }
        for controller in entry.model.joint_controllers:
            if not controller.follows_trajectories:
                name = f"{controller.name}/{CONTROLLER_COMMANDS.suffix}"
                found[name] = (f"{entry.namespace}/{name}", CONTROLLER_COMMANDS)
    for sensor in entry.model.sensors:
        for topic in sensor.topics:
            key = f"{entry.namespace}/{topic.name}"
            found.setdefault(topic.name, (key, TOPICS[topic.topic]))
    return found


def check_protocol(info: Info) -> None:
    """Check that a server uses the messages of this client.

    Raises:
        Unsupported: It does not.
    """
    if info.protocol != PROTOCOL:
        raise Unsupported(
            f"the server (zensim {info.version}) has protocol {info.protocol}, this client "
            f"{PROTOCOL}",
            slug="wrong_protocol",
            hint=f"install zensim {info.version} here, or this version on the server's host",
        )
