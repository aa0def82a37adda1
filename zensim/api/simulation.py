"""Simulation: the methods of the API, the same for a world in process and on a server."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.api.api_errors import Error, Invalid, SpawnRefused, Timeout, refuse_pickling
from zensim.api.argument_checks import (
    MAX_NUMBER,
    check_finite,
    check_range,
    check_text,
    check_whole,
    make_numbers,
)
from zensim.api.call_deadline import check_deadline, limit, limited
from zensim.api.closed_on_exit import ClosedOnExit
from zensim.api.entity_values import SpawnReport, make_html_table
from zensim.api.fleet import Fleet
from zensim.api.robot import EntityHandle, Robot
from zensim.api.spawning import (
    AgentKeywords,
    DescriptionKeywords,
    DescriptionOrder,
    FleetKeywords,
    SpawnKeywords,
    check_keywords,
    make_description_order,
    make_fleet_placements,
    make_order,
    make_report,
    make_spawn_pose,
    read_description,
)
from zensim.api.undriven_spawns import UndrivenSpawns
from zensim.api.world_access import WorldAccess, api_errors
from zensim.api.world_session import (
    MAX_RUN_S,
    WorldSession,
    check_protocol,
    list_robot_topics,
    make_not_found,
)
from zensim.proto.bounded_files import read_text_file
from zensim.proto.messages.entity_messages import CastRaysRequest
from zensim.proto.messages.fault_messages import (
    FOR_EVER,
    BodyFaultKind,
    InjectFaultRequest,
    TopicFaultKind,
)
from zensim.proto.messages.result_messages import ResultCode, ServiceError, SetSimulationStateCode
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import NANOSECONDS, Duration, Point, Vector3
from zensim.proto.messages.telemetry_messages import EVENT_KINDS, Event, GetModelsResponse, Info
from zensim.proto.network_protocols import MAX_REQUEST_BYTES
from zensim.proto.service_catalog import INJECT_FAULT, Request, Response, Service
from zensim.proto.settings.server_settings import ServerSettings, WorldKeywords
from zensim.proto.settings.setting import change_settings
from zensim.proto.topic_catalog import EVENTS, WORLD_TOPICS
from zensim.spawner.client.service_client import ServiceClient
from zensim.spawner.spawn.spawn_client import send_files, spawn_bonded, spawn_many

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from zensim.api.topic import Topic, TopicCallback
    from zensim.api.world_picture import WorldPicture
    from zensim.api.world_recorder import WorldRecorder

Handle = TypeVar("Handle", bound=EntityHandle)
Own = TypeVar("Own", bound="Simulation")
FAULT_KINDS = (*get_args(BodyFaultKind), *get_args(TopicFaultKind))
RATE_TOLERANCE = 1e-6
MAX_SEED = (1 << 64) - 1
MAX_STEPS = 10_000_000
"""Most steps of one call of `step`."""
DRIVEN_TIMEOUT_S = 10.0
"""Wall time within which an agent must drive a new robot."""
RECORDER_TIMEOUT_S = 30.0
MAX_RATE_HZ = 10_000.0
"""Highest rate of topics that are thinned."""


class HandleMapping(Mapping[str, Handle]):
    """Handles by name, of the entities that exist now."""

    def __init__(
        self, what: str, names: Callable[[], Sequence[str]], make: Callable[[str], Handle]
    ) -> None:
        self._what = what
        self._list_names = names
        self._make = make

    def __getitem__(self, name: str) -> Handle:
        """Return a handle.

        Raises:
            NotFound: There is none of this name.
        """
        names = self._list_names()
        if name not in names:
            raise make_not_found(self._what, str(name), names)
        return self._make(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._list_names())

    def __len__(self) -> int:
        return len(self._list_names())

    def __repr__(self) -> str:
        """List the names."""
        title = {"entity": "entities"}.get(self._what, f"{self._what}s")
        return f"<{len(self)} {title}: {', '.join(self)}>"


class Simulation(ClosedOnExit):
    """A simulated world: `World` in this process, `Sim` on a server.

    Properties are those of the newest state and do not wait. Methods may take a round trip. Units
    are SI and radians; times are simulated seconds, except those with `_s` in their name.
    """

    def __init__(self, access: WorldAccess) -> None:
        self._session = WorldSession(access)
        self._info = self._read_info()
        self._recorders: list[WorldRecorder] = []
        self._undriven: UndrivenSpawns[SpawnReport] = UndrivenSpawns(
            lambda report: report.name in self._session.access.refresh().row
        )
        self._undriven_fleets: UndrivenSpawns[tuple[list[str], dict[str, str]]] = UndrivenSpawns(
            lambda fleet: set(fleet[0]) <= self._session.access.refresh().row.keys()
        )

    # State

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return self._session.state().time

    @property
    def epoch(self) -> int:
        """Count of resets and restarts."""
        return self._session.state().snapshot.epoch

    @property
    def step_period(self) -> float:
        """Duration of a step [s]."""
        return self._session.step_ns / NANOSECONDS

    @property
    def control_period(self) -> float:
        """Time between two control steps [s]."""
        return self.step_period * self._session.control_steps

    @property
    def is_paused(self) -> bool:
        """Whether time advances by requests only."""
        return not self._session.is_playing

    @property
    def seed(self) -> int:
        """Seed of the world's random numbers."""
        return self._info.seed

    @property
    def info(self) -> Info:
        """Version, engine and configuration, as of the start of the session."""
        return self._info

    @property
    def robots(self) -> Mapping[str, Robot]:
        """Robots by name: what has a drive or joints that an agent serves."""
        return HandleMapping("robot", lambda: self._session.roster().robots, self._make_robot)

    @property
    def entities(self) -> Mapping[str, EntityHandle]:
        """All entities by name, robots included."""
        return HandleMapping(
            "entity", lambda: self._session.state().snapshot.names, self._make_entity
        )

    @property
    def agents(self) -> tuple[str, ...]:
        """Agents that drive robots, as of the last change of the roster."""
        entries = self._session.roster().entries.values()
        return tuple(dict.fromkeys(entry.agent for entry in entries if entry.agent))

    # Spawning

    def spawn(self, model: str | Path, name: str = "", **options: "Unpack[SpawnKeywords]") -> Robot:
        """Spawn a robot or an object, and return when it can be driven.

        Args:
            model: Name of a shipped model, or a file: URDF, xacro or SDF.
            name: Unique in the world; derived from the model if it is not given.
            options: x, y, z [m], roll, pitch, yaw [rad] and others; see `SpawnKeywords`.

        Raises:
            NotFound: There is no such file.
            SpawnRefused: The description or a name was refused, also that of a shipped model.
            Timeout: No agent drives it.
        """
        check_keywords(options, SpawnKeywords)
        check_text("name", name)
        description = make_description_order(model, options)
        with (
            limited(options.get("timeout_s")),
            self._undriven.retried(
                (str(model), name), options, lambda: self._spawn(description, name, options)
            ) as report,
        ):
            self._wait_until_driven([report.name] if report.drive else [], options)
        return Robot(self._session, report.name, report)

    def spawn_fleet(
        self, model: str | Path, count: int | None = None, **options: "Unpack[FleetKeywords]"
    ) -> Fleet:
        """Spawn several robots of one model in one step, on the ground.

        Args:
            model: See `spawn`.
            count: Number of robots; 10 if neither it nor `poses` is given.
            options: layout, spacing [m], poses, prefix and others; see `FleetKeywords`.

        Raises:
            SpawnRefused: A robot was refused, so that none was spawned.
        """
        self._session.check_open()
        check_keywords(options, FleetKeywords)
        with (
            limited(options.get("timeout_s")),
            self._undriven_fleets.retried(
                (str(model), count), options, lambda: self._spawn_fleet(model, count, options)
            ) as (names, refused),
        ):
            return self._make_fleet(names, refused, options)

    def _spawn_fleet(
        self, model: str | Path, count: int | None, options: FleetKeywords
    ) -> tuple[list[str], dict[str, str]]:
        """Spawn the robots of a fleet; return their names, and what was refused."""
        is_partial = options.get("partial", False)
        with api_errors():
            description = make_description_order(model, options)
            placements = make_fleet_placements(str(model), count, options)
            payload = read_description(description)
            order = make_order(description, bond=self._find_bond(options))
            client = self._session.client
            send_files(client, payload.bundle)
            outcomes = spawn_many(client, payload, placements, order, is_atomic=not is_partial)
        refused = {one.name: one.message for one in outcomes if one.code != ResultCode.OK}
        if refused and not is_partial:
            name, reason = next(iter(refused.items()))
            if name in self._session.access.refresh().row:
                raise SpawnRefused(
                    f"'{name}' exists already", slug="name.taken", hint="use another `prefix`"
                )
            raise SpawnRefused(f"'{name}': {reason}", slug="fleet_refused")
        return [one.name for one in outcomes if one.code == ResultCode.OK], refused

    def check(self, model: str | Path, **options: "Unpack[DescriptionKeywords]") -> SpawnReport:
        """Read a description as `spawn` does, without spawning.

        Args:
            model: See `spawn`.
            options: See `DescriptionKeywords`.

        Raises:
            SpawnRefused: `spawn` would refuse it.
        """
        check_keywords(options, DescriptionKeywords)
        return self._spawn(make_description_order(model, options, is_dry_run=True), "", {})

    def delete(self, name: str) -> None:
        """Delete an entity.

        Raises:
            NotFound: There is none of this name.
        """
        self.entities[name].delete()

    @contextmanager
    def temporary(self: Own) -> Iterator[Own]:
        """Delete at the end of the block what was spawned in it."""
        before = set(self._session.access.refresh().row)
        try:
            yield self
        finally:
            for name in self._session.access.refresh().snapshot.names:
                if name not in before:
                    with api_errors():
                        self._session.client.delete(name)
            self._session.access.refresh()

    # Time

    def run_for(
        self, seconds: float, *, progress: bool = False, timeout_s: float | None = None
    ) -> None:
        """Advance by simulated seconds; in a world that runs by itself, wait for them.

        Args:
            seconds: Rounded to whole steps.
            progress: Print a line with the time each simulated second.
            timeout_s: Wall time; 30 s for each request of steps if it is not given.

        Raises:
            Timeout: It took longer.
            SteppedElsewhere: Another client steps.
        """
        with limited(timeout_s):
            if not progress:
                self._session.run(seconds, timeout_s)
                return
            left = seconds
            while left > 0.0:
                part = min(left, 1.0)
                self._session.run(part, timeout_s)
                left -= part
                end = "" if left > 0.0 else "\n"
                print(f"\r{self.time:.1f} s", end=end, flush=True)  # noqa: T201

    def run_to(self, time: float, *, timeout_s: float | None = None) -> None:
        """Advance to the first step at or after a simulation time [s].

        Raises:
            Invalid: The time is past.
        """
        self._session.check_open()
        with limited(timeout_s):
            left = time - self.time
            if not left >= -self.step_period / 2:
                raise Invalid(
                    f"time {time:g} s is before the present {self.time:g} s",
                    hint="use a later time, or reset()",
                )
            self._session.run(max(0.0, left), timeout_s)

    def step(self, count: int = 1, *, timeout_s: float | None = None) -> None:
        """Advance a paused world by steps of the engine, each `step_period` long.

        Args:
            count: Of steps.
            timeout_s: Wall time; 30 s for each request of steps if it is not given.

        Raises:
            SteppedElsewhere: Another client steps.
            Timeout: It took longer.
        """
        self._session.check_open()
        check_whole("count", count, 1, MAX_STEPS)
        with limited(timeout_s):
            self._session.advance(count)

    def steps(self, seconds: float | None = None, rate: float | None = None) -> Iterator[float]:
        """Iterate over control steps of a paused world: the loop of a controller.

        The body sees the state at the yielded time, and its commands act from that step on.

        Args:
            seconds: Simulation time, rounded to whole rounds; None = without end.
            rate: Of the rounds [Hz]; must divide the control rate, which is the default.

        Yields:
            Simulation time [s].
        """
        self._session.check_open()
        if seconds is not None:
            check_range("seconds", seconds, 0.0, MAX_RUN_S)
        count = self._count_steps(rate)
        period = count * self._session.step_ns / NANOSECONDS
        rounds = None if seconds is None else round(seconds / period)
        number = 0
        while rounds is None or number < rounds:
            yield self.time
            number += 1
            if self._session.runs_by_itself:
                self._session.run(period)
            else:
                self._session.advance(count, is_eager=number != rounds)

    def wait_until(
        self, condition: Callable[[], object], within: float = 10.0, *, timeout_s: float = math.inf
    ) -> float:
        """Advance until a condition is true, checked at each control step; return the time [s].

        Args:
            condition: Called without arguments.
            within: Most simulated seconds.
            timeout_s: Wall time.

        Raises:
            Timeout: It was not true in time.
        """
        self._session.check_open()
        check_range("within", within, 0.0, math.inf)
        with limited(timeout_s):
            end = self.time + within
            while not condition():
                if self.time >= end - self.step_period / 2:
                    raise Timeout(
                        f"the condition was not true within {within:g} simulated s, "
                        f"at time {self.time:g} s",
                        hint="use a larger 'within'",
                    )
                check_deadline()
                if self._session.runs_by_itself:
                    self._session.wait_for_next(limit(timeout_s))
                else:
                    self._session.advance(self._session.control_steps)
        return self.time

    def pause(self) -> None:
        """Pause: time advances by requests only."""
        self._set_state(State.PAUSED)

    def play(self) -> None:
        """Let time advance by itself."""
        self._set_state(State.PLAYING)

    def reset(self) -> None:
        """Set time to 0, delete all that was spawned, and reset the world's own entities."""
        self._session.check_open()
        with api_errors():
            self._session.client.reset()
        self._session.forget()
        self._session.access.refresh()

    def load(self, world: str | Path) -> None:
        """Replace the world by a named one or an SDF file; time is 0, and paused or not as before.

        Raises:
            NotFound: There is no such world.
        """
        self._session.check_open()
        was_paused = self.is_paused
        file = Path(world)
        with api_errors():
            if file.is_file():
                self._session.client.load_world(text=read_text_file(file, MAX_REQUEST_BYTES))
            else:
                self._session.client.load_world(str(world))
        self._session.forget()
        self._session.access.refresh()
        self._set_state(State.PAUSED if was_paused else State.PLAYING)
        self._info = self._read_info()

    # Queries

    def models(self) -> tuple[str, ...]:
        """List the names of the shipped models."""
        self._session.check_open()
        with api_errors():
            found = self._session.client.spawnables()
        return tuple(one.entity_resource.uri.rpartition("/")[2] for one in found)

    def worlds(self) -> tuple[str, ...]:
        """List the names of the worlds that `load` takes."""
        self._session.check_open()
        with api_errors():
            return tuple(one.world_resource.uri for one in self._session.client.available_worlds())

    def state_hash(self) -> str:
        """Hash of time, names, poses, velocities and joint positions, as hexadecimal digits.

        Equal orders to equal worlds in lockstep give equal hashes.
        """
        self._session.check_open()
        return self._session.access.refresh().digest()

    def picture(self, *, width: int = 960, height: int = 600) -> "WorldPicture":
        """Take a picture of all that was spawned, from above one side; notebooks show it.

        Args:
            width: [pixels], 1 to 4096.
            height: [pixels], 1 to 4096.

        Raises:
            Unsupported: Images cannot be made on this host.
        """
        self._session.check_open()
        # Renderers take a while to import, and are missing without the server extra.
        from zensim.api import world_picture  # noqa: PLC0415

        check_whole("width", width, 1, world_picture.MAX_SIDE)
        check_whole("height", height, 1, world_picture.MAX_SIDE)
        return world_picture.make_picture(self._session.access, width, height)

    def cast_rays(
        self,
        origins: npt.ArrayLike,
        directions: npt.ArrayLike,
        *,
        range_max: float = 100.0,
        ignore: str = "",
    ) -> tuple[npt.NDArray[np.float64], tuple[str, ...]]:
        """Find what rays hit first.

        Args:
            origins: In the world [m], (n, 3).
            directions: Of any length but 0, (n, 3).
            range_max: [m], > 0.
            ignore: Name of an entity that rays pass through.

        Returns:
            Distances [m] (n,), infinite where nothing is hit; and the names of what is hit.
        """
        self._session.check_open()
        starts, along = (
            np.atleast_2d(make_numbers("rays", one, "(n, 3)")) for one in (origins, directions)
        )
        if starts.shape != along.shape or starts.shape[1:] != (3,):
            raise Invalid(
                f"origins and directions have shapes {starts.shape} and {along.shape}",
                slug="wrong_shape",
                hint="give (n, 3) for both",
            )
        check_finite("rays", np.concatenate([starts, along], axis=1), "(n, 3)")
        request = CastRaysRequest(
            tuple(Point(*row) for row in starts.tolist()),
            tuple(Vector3(*row) for row in along.tolist()),
            range_max,
            ignore,
        )
        with api_errors():
            found = self._session.client.cast_rays(request)
        ranges = np.array(found.ranges)
        return np.where(ranges < 0.0, np.inf, ranges), found.entities

    def topic(self, key: str, kind: type[msgspec.Struct] | None = None) -> "Topic[Any]":
        """Find a topic by its key, as `r1/scan`.

        Args:
            key: Without a leading slash.
            kind: Class of its messages; that of the topic catalog if it is not given.
        """
        self._session.check_open()
        check_text("key", key)
        return self._session.find_topic(key.removeprefix("/"), kind)

    def topics(self) -> tuple[str, ...]:
        """List the keys of the topics of the world and of its robots."""
        world = [topic.key(self._session.access.world_name) for topic in WORLD_TOPICS]
        entries = self._session.roster().entries.values()
        robots = [key for one in entries for key, _ in list_robot_topics(one).values()]
        return (*world, *robots)

    def inject(  # noqa: PLR0913  the numbers of a fault, each with a default
        self,
        name: str,
        kind: BodyFaultKind | TopicFaultKind,
        part: str,
        *,
        value: float = 0.0,
        low: float = 0.0,
        high: float = 0.0,
        seconds: float | None = None,
        seed: int = 0,
    ) -> None:
        """Let a part of an entity fail from now on, for a time or until a reset.

        Args:
            name: Of the entity.
            kind: `wheel_slip`, `wheel_jam`, `motor_weak`, `joint_lock`, `link_broken`;
                `sensor_off`, `sensor_stuck`, `sensor_slow`, `sensor_delay`, `sensor_intermittent`,
                `sensor_noise`, `sensor_bias` or `sensor_sector`.
            part: The joint; the link of `link_broken`; the sensor of `sensor_…`.
            value: Factor of friction or torque; every n-th message; delay [s]; share of lost
                messages; standard deviation or bias in the unit of the sensor.
            low: First blind angle of `sensor_sector` [rad].
            high: Last blind angle of `sensor_sector` [rad].
            seconds: Simulation time; it ends at the first control step after it.
            seed: Of lost messages and noise.

        Raises:
            NotFound: There is no such entity or part.
            Invalid: A number is out of range, or the kind unknown.
            Error: The engine cannot simulate it.
        """
        check_text("name", name)
        check_text("part", part)
        _check_kind(kind)
        for what, number in (("value", value), ("low", low), ("high", high)):
            check_range(what, number, -MAX_NUMBER, MAX_NUMBER)
        check_whole("seed", seed, 0, MAX_SEED)
        span = _make_duration(seconds)
        self.call(INJECT_FAULT, InjectFaultRequest(name, kind, part, value, low, high, span, seed))

    @property
    def events(self) -> "Topic[Event]":
        """What happens in the world, from the first use on: spawns, claims, resets, warnings.

        Iterate over it, `read()` the next one, or call a function `on` each.
        """
        self._session.check_open()
        topic = self._session.find_topic(EVENTS.key(self._session.access.world_name), Event)
        topic.collect()
        return topic

    def on(
        self, kind: str, queue: int = 100
    ) -> Callable[[Callable[[Event], object]], "TopicCallback[Event]"]:
        """Decorate a function that is called with the events of a kind, as `spawned`.

        Args:
            kind: Kind of event; empty = all.
            queue: See `Topic.on`.

        Raises:
            NotFound: There is no such kind.
        """
        if kind and kind not in EVENT_KINDS:
            raise make_not_found("kind of event", kind, EVENT_KINDS)

        def subscribe(call: Callable[[Event], object]) -> "TopicCallback[Event]":
            return self.events.on(
                lambda event: call(event) if kind in ("", event.kind) else None, queue
            )

        return subscribe

    def attach(
        self, robots: Fleet, controller: Callable[[Fleet, float], npt.ArrayLike]
    ) -> Callable[[], None]:
        """Drive robots by a function, called before each control step for all of them at once.

        In a world that runs by itself it is called with each state, by a thread.

        Args:
            robots: Robots to drive.
            controller: Takes the robots and the time since its last call [s]; returns v [m/s] and
                w [rad/s] of each, (n, 2).

        Returns:
            A function that ends it and stops the robots.
        """

        def control(period_s: float) -> None:
            twists = np.asarray(controller(robots, period_s), dtype=np.float64)
            if twists.shape != (len(robots), 2):
                raise Invalid(
                    f"the controller returned shape {twists.shape}",
                    slug="wrong_shape",
                    hint=f"return ({len(robots)}, 2): v and w",
                )
            robots.drive(twists[:, 0], twists[:, 1])

        detach = self._session.attach(control)

        def end() -> None:
            detach()
            robots.stop()

        return end

    def fleet(self, names: Sequence[str]) -> Fleet:
        """Find several robots, as arrays with a row for each.

        Raises:
            NotFound: There is none of one of these names.
        """
        self._session.check_open()
        if isinstance(names, str):
            raise Invalid(f"names={names[:40]!r} is one text", hint="give a list of names")
        known = self._session.state().row
        for name in names:
            if name not in known:
                raise make_not_found("robot", name, list(known))
        return Fleet(self._session, names)

    def call(self, service: Service[Request, Response], request: Request) -> Response:
        """Call a service of the catalog (`zensim.proto.service_catalog`) of this world.

        Raises:
            Error: The request was refused.
            Timeout: There was no reply in time.
        """
        self._session.check_open()
        with api_errors():
            return self._session.access.call(
                service, request, world=self._session.access.world_name
            )

    # Recording

    def record(
        self,
        file: str | Path,
        *topics: str,
        rate: float = 0.0,
        timeout_s: float = RECORDER_TIMEOUT_S,
    ) -> "WorldRecorder":
        """Record topics to an MCAP file, until the recorder or this simulation is closed.

        On a server a process of this host records. A world in process records by itself: nothing
        is lost, all times are simulation time, and equal runs give equal files, byte by byte.

        Args:
            file: New file with suffix `.mcap`, or a new folder.
            topics: Names, with wildcards such as `*/odom`; all if none is given.
            rate: Keep the newest message of each topic so often in simulation time [Hz]; 0 = all.
            timeout_s: Wall time of its start.

        Raises:
            Error: It cannot record, for example as the file exists.
            Timeout: It has not begun in time.
        """
        self._session.check_open()
        check_range("rate", rate, 0.0, MAX_RATE_HZ)
        for topic in topics:
            check_text("topic", topic)
        with api_errors(), limited(timeout_s):
            recorder = self._session.access.record(Path(file), topics, rate, timeout_s)
        self._recorders.append(recorder)
        return recorder

    # Lifetime

    def close(self) -> None:
        """Stop what this client commands, and end; may be repeated.

        Raises:
            Error: A recorder ended before, for example as the disk is full.
        """
        with ExitStack() as stack:
            stack.callback(self._session.close)
            for recorder in self._recorders:
                stack.callback(recorder.close)
            self._recorders = []

    def __reduce__(self) -> tuple[object, ...]:
        """Refuse: a simulation belongs to its process."""
        refuse_pickling(self, "pass sim.endpoint, or the bytes of World.snapshot()")

    def _repr_html_(self) -> str:
        state = self._session.state()
        rows: list[tuple[object, ...]] = [
            ("world", self._info.world_model),
            ("engine", self._info.engine),
            ("time [s]", f"{state.time:.3f}"),
            ("state", state.snapshot.state),
            ("entities", len(state.snapshot.names)),
        ]
        return make_html_table((type(self).__name__, ""), rows)

    def _spawn(
        self, description: DescriptionOrder, name: str, options: SpawnKeywords
    ) -> SpawnReport:
        self._session.check_open()
        with api_errors():
            payload = read_description(description)
            order = make_order(
                description,
                name=name,
                namespace=options.get("namespace", ""),
                pose=make_spawn_pose(options),
                payload=payload,
                bond=self._find_bond(options),
            )
            send_files(self._session.client, payload.bundle)
            report = spawn_bonded(self._session.client, order)
        if not description.is_dry_run:
            self._session.access.refresh()
        return make_report(report)

    def _make_fleet(
        self, names: list[str], refused: dict[str, str], options: AgentKeywords
    ) -> Fleet:
        self._session.access.refresh()
        entries = self._session.read_roster().entries
        driven = [name for name in names if entries[name].model.drive is not None]
        self._wait_until_driven(driven, options)
        report = entries[names[0]].model.report if names else ()
        return Fleet(self._session, names, SpawnReport("fleet", "", report, refused=refused))

    def _wait_until_driven(self, names: list[str], options: AgentKeywords) -> None:
        if names and options.get("agent") != "external":
            timeout_s = options.get("timeout_s", DRIVEN_TIMEOUT_S)
            self._session.access.wait_until_driven(names, timeout_s)

    def _find_bond(self, options: AgentKeywords) -> str:
        return self._session.access.hold_bond() if options.get("bond") else ""

    def _count_steps(self, rate: float | None) -> int:
        """Count the engine's steps in a period of a rate."""
        control = self._session.control_steps
        if rate is None:
            return control
        control_rate = NANOSECONDS / (self._session.step_ns * control)
        periods = control_rate / rate if rate > 0.0 else 0.0
        if round(periods) < 1 or abs(periods - round(periods)) > RATE_TOLERANCE * periods:
            raise Invalid(
                f"rate={rate!r} does not divide the control rate {control_rate:g} Hz",
                slug="wrong_rate",
                hint=f"use {control_rate:g}, {control_rate / 2:g}, {control_rate / 5:g}, …",
            )
        return round(periods) * control

    def _set_state(self, state: State) -> None:
        self._session.check_open()
        try:
            with api_errors():
                self._session.client.set_simulation_state(state)
        except Error as error:
            cause = error.__cause__
            is_same = (
                isinstance(cause, ServiceError)
                and cause.code == SetSimulationStateCode.ALREADY_IN_TARGET_STATE
            )
            if not is_same:
                raise
        self._session.access.refresh()

    def __repr__(self) -> str:
        """Say which world it is, its engine and its time."""
        kind = type(self).__name__
        if self._session.is_closed:
            return f"<{kind}, closed>"
        return f"<{kind} {self._info.world!r}, {self._info.engine}, {self.time:.3f} s>"

    def _read_info(self) -> Info:
        with api_errors():
            info = self._session.client.info()
        check_protocol(info)
        return info

    def _make_robot(self, name: str) -> Robot:
        return Robot(self._session, name)

    def _make_entity(self, name: str) -> EntityHandle:
        is_robot = name in self._session.roster().robots
        return (Robot if is_robot else EntityHandle)(self._session, name)


def _check_kind(kind: str) -> None:
    if kind not in FAULT_KINDS:
        raise Invalid(f"fault '{kind}' is unknown", hint=f"use {', '.join(FAULT_KINDS)}")


def _make_duration(seconds: float | None) -> Duration:
    """Make a duration of simulated seconds; None = without end."""
    if seconds is None:
        return FOR_EVER
    check_range("seconds", seconds, 0.0, MAX_RUN_S)
    return Duration(*divmod(round(seconds * NANOSECONDS), NANOSECONDS))


def fetch_models(
    sim: Simulation, names: tuple[str, ...] = (), *, wants_descriptions: bool = False
) -> GetModelsResponse:
    """Get the models of the named entities, or of all.

    Raises:
        Error: The request was refused.
        Timeout: There was no reply in time.
    """
    access = sim._session.access  # noqa: SLF001
    with api_errors():
        client = ServiceClient(access, access.world_name)
        return client.models(names, wants_descriptions=wants_descriptions)


def read_world_keywords(
    world: str | Path, options: WorldKeywords, settings: ServerSettings
) -> ServerSettings:
    """Change settings by a world and keyword arguments.

    Raises:
        TypeError: One is unknown.
        Invalid: A value is out of range, or no word that it may have.
    """
    check_keywords(options, WorldKeywords)
    with api_errors():
        return change_settings(settings, {**options, "world": str(world)})
