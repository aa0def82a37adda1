"""Episodes of a task in the worlds of a batch: random streams, actions, observations, ends."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.api.api_errors import Closed, Invalid
from zensim.api.in_process_world import World
from zensim.envs.batch import TWIST_COLUMNS, BatchState
from zensim.envs.env_settings import EnvSettings, count_control_steps, make_batch
from zensim.envs.robot_task import FleetView, RobotTask, check_returned
from zensim.envs.world_streams import WorldStreams
from zensim.sim_server.physics.engine import BoolArray, FloatArray, IntArray

Observations = npt.NDArray[np.float32]
ACTION_COLUMNS = 2
"""Forward velocity and turn, from -1 to 1."""
JUDGED = {"rewards": "numbers", "is_success": "bool", "is_failure": "bool"}
"""Attributes of a `Judgement`."""


@dataclass(frozen=True)
class Outcome:
    """What a step gave; (worlds, agents), and a row for each world.

    Attributes:
        observations: (worlds, agents, d).
        rewards: 0 of robots whose episode had ended.
        is_over: Whether the episode of a robot has ended, now or before.
        is_success: Whether it has ended because the task is done.
        terminated: (worlds,) whether the episodes of all robots have ended.
        truncated: (worlds,) whether the time is over, or a state was not finite.
    """

    observations: Observations
    rewards: FloatArray
    is_over: BoolArray
    is_success: BoolArray
    terminated: BoolArray
    truncated: BoolArray


@dataclass(frozen=True)
class EpisodesState:
    """State of the episodes of all worlds.

    Attributes:
        made_for: Kind of task and settings, which a state is loaded with.
        batch: Of the worlds.
        is_over, is_success: See `Outcome`.
        task: The task, and the random numbers.
    """

    made_for: tuple[object, ...]
    batch: BatchState
    is_over: BoolArray
    is_success: BoolArray
    task: tuple[RobotTask, WorldStreams]


class Episodes:
    """Many worlds in which robots do a task.

    World w has the same random numbers and the same states, whatever the number of worlds and of
    threads.
    """

    def __init__(self, task: RobotTask, settings: EnvSettings, worlds: int) -> None:
        """Make the worlds.

        Raises:
            Invalid: The task needs more robots, or the rate does not fit.
        """
        self.batch = make_batch(settings, worlds, task)
        # A World cannot be copied, and is not needed any more.
        given = "" if isinstance(settings.world, World) else settings.world
        self._task, self._settings = task, msgspec.structs.replace(settings, world=given)
        robots = self.batch.shape[1]
        if robots < task.least_robots:
            raise Invalid(
                f"{type(task).__name__} needs {task.least_robots} robots, not {robots}",
                hint="set count",
            )
        self._agents = _choose_agents(task, robots)
        self._control_steps = count_control_steps(self.batch, settings.rate_hz)
        self._scale = np.array([settings.max_speed_m_s, settings.max_turn_rad_s])
        self._limits = self._find_limits(robots)
        numbers = (one.tobytes() for one in (self._agents, self._scale, *self._limits))
        settled = self._control_steps, settings.time_limit_s, tuple(settings.sensors)
        self._made_for = (type(task), *settled, *numbers)
        self._is_over = np.zeros((worlds, len(self._agents)), np.bool_)
        self._is_success = self._is_over.copy()
        self._view_before: FleetView | None = None
        self._is_closed = False
        self._streams = WorldStreams(worlds)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the robots that learn."""
        return tuple(self.batch.names[robot] for robot in self._agents.tolist())

    @property
    def limits(self) -> tuple[Observations, Observations]:
        """Least and greatest observation (d,) of a robot."""
        return self._limits

    def seed(self, seed: int, worlds: BoolArray) -> None:
        """Start the random numbers of some worlds (worlds,) anew."""
        self._streams.seed(seed, np.flatnonzero(worlds))

    def seed_each(self, seeds: Sequence[int | None]) -> None:
        """Start worlds anew, each as the first of a seed of its own; None = a world goes on."""
        self._streams.seed_each(seeds)

    def restart(self, worlds: BoolArray) -> FleetView:
        """Start new episodes in some worlds (worlds,); return the view of all.

        Raises:
            Closed: See `close`.
        """
        self._refuse_closed()
        chosen = np.flatnonzero(worlds)
        seeds: dict[int, int] = {}
        if self._settings.sensors:  # noise differs by episode
            drawn = self._streams.draw_seeds(chosen)
            seeds = dict(zip(chosen.tolist(), drawn, strict=True))
        self.batch.restart(worlds, seeds)
        self._is_over[worlds] = self._is_success[worlds] = False
        view = self._view()
        self._task.restart(chosen, view, self._streams)
        return view

    def observe(self) -> Observations:
        """Make the observations (worlds, agents, d)."""
        return self._observe(self._view())

    def step(self, actions: FloatArray, restarted: BoolArray | None = None) -> Outcome:
        """Make a step of all worlds.

        Args:
            actions: (worlds, agents, 2).
            restarted: Worlds (worlds,) that start new episodes instead; None = none does.

        Raises:
            Closed: See `close`.
            Invalid: No episode was started, or the shape is wrong, or an action of a robot whose
                episode goes on is not finite.
        """
        self._refuse_closed()
        if self._view_before is None:
            raise Invalid("no episode was started", slug="not_reset", hint="call reset()")
        if actions.shape != (*self._is_over.shape, ACTION_COLUMNS):
            raise Invalid(
                f"actions have shape {actions.shape}",
                slug="wrong_shape",
                hint=f"use {(*self._is_over.shape, ACTION_COLUMNS)}: worlds, robots, v and w",
            )
        is_still = self._is_over
        if restarted is not None:
            is_still = is_still | restarted[:, None]
        self._refuse_not_finite(actions, is_still)
        limited = np.clip(actions, -1.0, 1.0) * self._scale
        twists = np.zeros((*self.batch.shape, TWIST_COLUMNS))
        if len(self._agents) < self.batch.shape[1]:
            driven = self._task.drive(self._view_before)
            shape = (*self.batch.shape, ACTION_COLUMNS)
            check_returned(self._task, "drive()", driven, shape, live=False)
            twists[..., (0, 2)] = np.nan_to_num(driven)  # NaN of lost worlds
        twists[:, self._agents, ::2] = np.where(is_still[..., None], 0.0, limited)
        self.batch.step(twists, self._control_steps)
        return self._judge(self._view(), restarted)

    def save(self) -> "EpisodesState":
        """Copy the state of all worlds and of the task; raises what `Batch.save` raises."""
        marks = self._is_over.copy(), self._is_success.copy()
        # The task may keep the streams: one copy of both.
        task = deepcopy((self._task, self._streams))
        return EpisodesState(self._made_for, self.batch.save(), *marks, task)

    def load(self, state: "EpisodesState") -> None:
        """Put back a state that `save` returned.

        Raises:
            Invalid: The state is of another task, or of other settings or worlds; nothing changes.
        """
        if state.made_for != self._made_for:
            raise Invalid(
                f"the state is of {type(state.task[0]).__name__}, or of other settings",
                slug="wrong_state",
                hint=f"use one of {type(self._task).__name__}, with equal settings",
            )
        self.batch.load(state.batch)
        self._is_over, self._is_success = state.is_over.copy(), state.is_success.copy()
        self._task, self._streams = deepcopy(state.task)
        self._view()

    def close(self) -> None:
        """End the threads; no step and no episode follows."""
        self._is_closed = True
        self.batch.close()

    def _refuse_closed(self) -> None:
        if self._is_closed:
            raise Closed("this environment is closed", hint="make another one")

    def _refuse_not_finite(self, actions: FloatArray, is_still: BoolArray) -> None:
        is_finite = np.isfinite(actions)
        if not is_finite.all() and not (is_right := is_finite.all(axis=-1) | is_still).all():
            pairs = np.argwhere(~is_right)[:5].tolist()
            wrong = ", ".join(f"'{self.names[row]}' in world {world}" for world, row in pairs)
            raise Invalid(
                f"actions are not finite: of {wrong}",
                slug="not_finite",
                hint="give numbers from -1 to 1",
            )

    def _judge(self, view: FleetView, restarted: BoolArray | None) -> Outcome:
        is_lost = self.batch.is_diverged
        with np.errstate(invalid="ignore"):  # of lost worlds
            judgement = self._task.judge(view)
        is_live = ~self._is_over & ~is_lost[:, None]
        if restarted is not None and restarted.any():
            is_live[restarted] = False
        for name, kind in JUDGED.items():
            judged = getattr(judgement, name, None)
            check_returned(self._task, f"judge().{name}", judged, is_live.shape, kind, live=is_live)
        self._is_success |= is_live & judgement.is_success
        self._is_over |= is_live & (judgement.is_success | judgement.is_failure)
        # Steps are whole nanoseconds: their sum differs from the limit.
        limit_s = self._settings.time_limit_s - self.batch.control_period / 2.0
        is_late = view.times >= limit_s
        ends = is_late | is_lost
        if restarted is not None and restarted.any():
            view, ends = self.restart(restarted), ends & ~restarted
        terminated = np.asarray(self._is_over.all(axis=1))
        return Outcome(
            observations=self._observe(view),
            rewards=np.where(is_live, judgement.rewards, 0.0),
            is_over=self._is_over.copy(),
            is_success=self._is_success.copy(),
            terminated=terminated,
            truncated=ends & ~terminated,
        )

    def _view(self) -> FleetView:
        batch = self.batch
        view = FleetView(batch.poses2d, batch.velocities, batch.is_touching, batch.times)
        self._view_before = view
        return view

    def _observe(self, view: FleetView) -> Observations:
        with np.errstate(invalid="ignore"):  # of lost worlds
            parts = [self._task.observe(view)]
        shape = (*self._is_over.shape, self._observed)
        live = ~self.batch.is_diverged[:, None, None]
        check_returned(self._task, "observe()", parts[0], shape, live=live)
        measured = {"scan": lambda: self.batch.scans, "imu": lambda: self.batch.imu}
        parts += [measured[name]()[:, self._agents] for name in self._settings.sensors]
        found = np.concatenate(parts, axis=-1) if len(parts) > 1 else parts[0]
        if self.batch.has_diverged:
            found = np.nan_to_num(found)
        return np.asarray(np.clip(found.astype(np.float32), *self._limits))

    def _find_limits(self, robots: int) -> tuple[Observations, Observations]:
        bounds = self._task.list_bounds(robots)
        check_returned(self._task, "list_bounds()", bounds, (np.size(bounds),))
        self._observed = len(bounds)
        parts = [(-bounds, bounds)]
        parts += [self.batch.sensor_limits[name] for name in self._settings.sensors]
        low, high = (np.concatenate(values) for values in zip(*parts, strict=True))
        return low.astype(np.float32), high.astype(np.float32)


def _choose_agents(task: RobotTask, robots: int) -> IntArray:
    found = task.choose_agents(robots)
    check_returned(task, "choose_agents()", found, (np.size(found),), "whole numbers")
    if not len(found) or sorted(set(found.tolist()) & set(range(robots))) != sorted(found.tolist()):
        raise Invalid(
            f"{type(task).__name__}.choose_agents() is {found[:5].tolist()}",
            hint=f"return different numbers from 0 to {robots - 1}",
        )
    return found
