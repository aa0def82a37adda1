"""Batch: many copies of one world in arrays, which threads step."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zensim.api.api_errors import Closed, Invalid, Unsupported
from zensim.api.argument_checks import check_limits, check_whole
from zensim.api.closed_on_exit import ClosedOnExit
from zensim.api.in_process_world import World, get_server
from zensim.envs.batch_drives import BatchDrives, SavedDrives
from zensim.envs.batch_sensors import BatchSensors, SensorName
from zensim.envs.world_layout import make_world_layout
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.se3 import conjugate, rotate, to_yaw
from zensim.proto.sensor_noise import KeyArray
from zensim.proto.state_hash import hash_states
from zensim.sim_server.physics.cells.cell_executor import StepThreads
from zensim.sim_server.physics.engine import BoolArray, EngineRefused, FloatArray
from zensim.sim_server.world.simulated_world import SimulatedWorld

STATE_COLUMNS = 13
TWIST_COLUMNS = 3
MAX_WORLDS, MAX_THREADS = 65536, 1024


@dataclass(frozen=True)
class BatchState:
    """State of all worlds of a batch, for a batch of the same world.

    Attributes:
        start: Hash of the state in which the world was copied.
        steps: Of each world, (worlds,).
        time_ns: Time of the drives.
        replicas: See `EngineReplicas.save`.
        drives: See `BatchDrives.save`.
        noise_keys: Of lidars, (worlds, robots).
    """

    start: str
    steps: npt.NDArray[np.int64]
    time_ns: int
    replicas: tuple[FloatArray, ...]
    drives: tuple[FloatArray, tuple[SavedDrives, ...]]
    noise_keys: KeyArray


class Batch(ClosedOnExit):
    """Copies of a world, each with a time of its own; arrays are (worlds, robots, …).

    Engine and drives are those of the world: a copy has the bits that the world, or a server in
    lockstep, has after equal commands. One exception: objects that are pushed about never sleep.
    """

    def __init__(
        self, world: World, worlds: int, *, threads: int = 1, sensors: Sequence[SensorName] = ()
    ) -> None:
        """Copy a world as it is; it may be closed or changed afterwards.

        Args:
            world: With robots; their drives start anew in the copies.
            worlds: Number of copies, 1 to 65536.
            threads: That step the copies, 1 to 1024; results do not depend on it.
            sensors: That are measured: `scan`, `imu`.

        Raises:
            Invalid: A number is out of range, or there is no robot, or one without such a sensor.
            Unsupported: The engine is not MuJoCo, the world has several cells or kinematic
                robots, joints are controlled, or a force or a fault acts that a copy cannot have.
        """
        check_whole("worlds", worlds, 1, MAX_WORLDS)
        check_whole("threads", threads, 1, MAX_THREADS)
        server = get_server(world)
        simulated = server.world
        _refuse_passing(simulated)
        self._layout = make_world_layout(simulated)
        with _as_unsupported():
            self._replicas = simulated.engine.replicate(self._layout.bodies, worlds)
        self._is_closed = False
        self._step_ns, self._control_steps = simulated.clock.step_ns, simulated.control_steps
        self._start_steps = simulated.clock.steps
        self._steps = np.zeros(worlds, np.int64)
        self._time_ns = 0
        self._is_diverged: BoolArray = np.zeros(worlds, np.bool_)
        self._groups = self._replicas.make_groups(threads)
        self._threads = StepThreads(threads)
        self._drives = BatchDrives(self._layout.models, self._layout.first_joints, worlds)
        self._sensors = BatchSensors(server, self._layout, worlds, sensors)
        self._read()
        self._start = self.digest()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the robots."""
        return self._layout.names

    @property
    def shape(self) -> tuple[int, int]:
        """Worlds and robots."""
        return len(self._steps), len(self.names)

    @property
    def control_period(self) -> float:
        """Simulated seconds of a control step."""
        return self._control_steps * self._step_ns / NANOSECONDS

    @property
    def times(self) -> FloatArray:
        """Simulated seconds since each world was restarted, (worlds,)."""
        return np.asarray(self._steps * self._step_ns / NANOSECONDS)

    @property
    def is_diverged(self) -> BoolArray:
        """Worlds (worlds,) with a state that is not finite: they rest until a restart."""
        return np.array(self._is_diverged)

    @property
    def states(self) -> FloatArray:
        """Position, quaternion, linear and angular velocity in the world, (worlds, robots, 13)."""
        return np.asarray(self._base[:, self._layout.robots])

    @property
    def poses2d(self) -> FloatArray:
        """Position x y [m] and heading [rad], (worlds, robots, 3)."""
        states = self.states
        return np.concatenate([states[..., :2], to_yaw(states[..., 3:7])[..., None]], axis=-1)

    @property
    def twists(self) -> FloatArray:
        """Linear [m/s] and angular [rad/s] velocity in the robot, (worlds, robots, 6)."""
        states = self.states.reshape(-1, STATE_COLUMNS)
        back = conjugate(states[:, 3:7])
        found = [rotate(back, states[:, 7:10]), rotate(back, states[:, 10:])]
        return np.concatenate(found, axis=1).reshape(*self.shape, 6)

    @property
    def velocities(self) -> FloatArray:
        """Forward [m/s] and turn [rad/s] of each robot, (worlds, robots, 2)."""
        columns = np.ascontiguousarray(self.states.reshape(-1, STATE_COLUMNS).T)
        x, y, z, w, vx, vy, vz, *spin = columns[3:]
        ahead, up = _find_axes(x, y, z, w)
        found = np.stack([_dot(ahead, (vx, vy, vz)), _dot(up, spin)], axis=-1)
        return found.reshape(*self.shape, 2)

    @property
    def has_diverged(self) -> bool:
        """Whether a world has; see `is_diverged`."""
        return bool(self._is_diverged.any())

    @property
    def is_touching(self) -> BoolArray:
        """Whether each robot touches something that does not carry it, (worlds, robots)."""
        return np.asarray(self._replicas.find_touching()[:, self._layout.robots])

    @property
    def scans(self) -> FloatArray:
        """Ranges [m] of the lidars with noise, (worlds, robots, rays); their limits beyond them.

        Raises:
            Invalid: The batch was made without `scan`.
        """
        return self._sensors.measure_scans(self._steps, self._base, self._positions)

    @property
    def imu(self) -> FloatArray:
        """Last messages of the inertial units, (worlds, robots, 10).

        Orientation x y z w, angular velocity [rad/s], and specific force [m/s^2], in the sensor.

        Raises:
            Invalid: The batch was made without `imu`.
        """
        return self._sensors.read_imu()

    @property
    def sensor_limits(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Least and greatest values (k,) of what each sensor of a robot measures."""
        return self._sensors.limits

    def step(self, twists: npt.ArrayLike, control_steps: int = 1) -> None:
        """Advance all worlds, with a command that holds.

        Args:
            twists: Forward, left [m/s] and turn [rad/s] of each robot, (worlds, robots, 3).
            control_steps: In which the drives are updated; > 0.

        Raises:
            Invalid: The shape is wrong, or a number is not finite, or there is no control step.
            Closed: The batch is closed.
        """
        if self._is_closed:
            raise Closed("this batch is closed", hint="make another Batch()")
        if control_steps < 1:
            raise Invalid(f"control_steps={control_steps} is out of range", hint="use 1 or more")
        wanted = np.asarray(twists, np.float64)
        if wanted.shape != (*self.shape, TWIST_COLUMNS):
            raise Invalid(
                f"twists have shape {wanted.shape}",
                slug="wrong_shape",
                hint=f"use {(*self.shape, TWIST_COLUMNS)}: worlds, robots, and v, left, w",
            )
        check_limits("twists", wanted, str((*self.shape, TWIST_COLUMNS)))
        for _ in range(control_steps):
            self._make_control_step(wanted)

    def restart(
        self, worlds: npt.ArrayLike | None = None, seeds: Mapping[int, int] | None = None
    ) -> None:
        """Put worlds back into the state in which they were copied.

        Args:
            worlds: Mask (worlds,); None = all.
            seeds: Of the noise of their sensors, by world; None = the row of each.

        Raises:
            Invalid: The mask has a wrong shape or type, or a seed is of a world outside it.
        """
        chosen = np.ones(len(self._steps), np.bool_) if worlds is None else np.asarray(worlds)
        if chosen.shape != self._steps.shape or chosen.dtype != np.bool_:
            raise Invalid(
                f"the mask has shape {chosen.shape} of {chosen.dtype}",
                slug="wrong_shape",
                hint=f"use {self._steps.shape} of bool",
            )
        rows = np.flatnonzero(chosen).tolist()
        if others := sorted(set(seeds or ()).difference(rows)):
            raise Invalid(
                f"seeds of worlds {others[:5]}, which do not restart", hint="give those of the mask"
            )
        self._replicas.restore(rows)
        self._drives.restart(chosen)
        self._steps[chosen] = 0
        self._is_diverged[chosen] = False
        self._read()
        self._sensors.restart(dict(zip(rows, rows, strict=True)) if seeds is None else seeds)

    def save(self) -> "BatchState":
        """Copy the state of all worlds.

        Raises:
            Unsupported: The worlds have full dynamics, or inertial units are measured.
        """
        with _as_unsupported():
            replicas = self._replicas.save()
        steps, drives = self._steps.copy(), self._drives.save()
        return BatchState(self._start, steps, self._time_ns, replicas, drives, self._sensors.save())

    def load(self, state: "BatchState") -> None:
        """Put all worlds into a state that `save` returned.

        Raises:
            Invalid: The state has another number of worlds, or is of another world.
            Unsupported: See `save`.
        """
        if state.start != self._start or state.steps.shape != self._steps.shape:
            raise Invalid(
                f"the state of {len(state.steps)} worlds is not of this batch",
                slug="wrong_state",
                hint=f"use one of {len(self._steps)} copies of the same world",
            )
        with _as_unsupported():
            self._replicas.load(state.replicas)
        self._steps[:], self._time_ns = state.steps, state.time_ns
        self._drives.load(state.drives)
        self._sensors.load(state.noise_keys)
        self._read()

    def digest(self, world: int = 0) -> str:
        """Hash the state of a world, as `World.state_hash()` does; IndexError if there is none."""
        chosen = [world]
        base, positions = self._layout.fill_in(self._base[chosen], self._positions[chosen])
        time_ns = int(self._start_steps + self._steps[world]) * self._step_ns
        return hash_states(time_ns, self._layout.entities, base.tobytes(), positions.tobytes())

    def close(self) -> None:
        """End the threads; may be repeated. What was measured can still be read."""
        self._is_closed = True
        self._threads.close()

    def _make_control_step(self, twists: FloatArray) -> None:
        self._drives.update(self._time_ns, (self._positions, self._velocities), twists)
        self._replicas.command(self._drives.targets)
        is_ok = self._threads.step(self._groups, self._control_steps)
        self._steps += self._control_steps
        self._time_ns += self._control_steps * self._step_ns
        self._read()
        if not is_ok:
            self._is_diverged = np.asarray(~np.isfinite(self._base).all(axis=(1, 2)))
        times_ns = (self._steps * self._step_ns).tolist()
        self._sensors.take(times_ns, self._base, (self._positions, self._velocities))

    def _read(self) -> None:
        found, worlds = self._replicas.read(), len(self._steps)
        self._base = found.base.reshape(worlds, -1, STATE_COLUMNS)
        self._positions = found.joint_positions.reshape(worlds, -1)
        self._velocities = found.joint_velocities.reshape(worlds, -1)


def _find_axes(
    x: FloatArray, y: FloatArray, z: FloatArray, w: FloatArray
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Find the axes x and z of frames, by their quaternions."""
    ahead = [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)]
    return ahead, [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)]


def _dot(one: Sequence[FloatArray], other: Sequence[FloatArray]) -> FloatArray:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@contextmanager
def _as_unsupported() -> Iterator[None]:
    try:
        yield
    except EngineRefused as refused:
        raise Unsupported(str(refused), slug="not_replicable") from refused


def _refuse_passing(world: SimulatedWorld) -> None:
    """Refuse a world with forces and faults that are no part of its engine.

    Raises:
        Unsupported: It has some.
    """
    if world.applied_forces.has_left(world.clock.time_ns):
        raise Unsupported(
            "a wrench or an effort acts in the world, which copies would not have",
            slug="not_replicable",
            hint="clear it, or step the world until it has ended",
        )
    if not world.injected_faults.is_in_models:
        raise Unsupported(
            "a fault of the world is of a topic or ends by itself, which copies would not have",
            slug="not_replicable",
            hint="use faults of bodies without a duration, or reset the world",
        )
