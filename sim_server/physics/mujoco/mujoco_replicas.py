"""Many copies of a world, which share one model."""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import fields, replace
from typing import Any

import mujoco
import numpy as np

from zensim.sim_server.physics.engine import (
    SUPPORT_NORMAL_Z,
    BodyStates,
    BoolArray,
    EngineReplicas,
    FloatArray,
    SteppedTogether,
)
from zensim.sim_server.physics.mujoco.body_selection import MujocoBody, make_body_selection
from zensim.sim_server.physics.mujoco.compiled_model import SavedState
from zensim.sim_server.physics.mujoco.slot_layout import NO_INDEX, IndexArray
from zensim.sim_server.physics.mujoco.slot_state import ActuatorTargets
from zensim.sim_server.physics.mujoco.stepped_world import (
    FALLBACK_SOLVER,
    SteppedWorld,
    step_worlds,
)

NO_OWNERS = np.zeros(0, np.intp)
GROUP_SIZE = 16
"""Copies that are stepped together: few enough for the cache."""


class ReplicatedWorld(SteppedWorld):
    """One of many equal worlds: it has data and targets of its own and shares all else."""

    def __init__(
        self, shared: dict[str, Any], targets: ActuatorTargets, fallback: mujoco.MjModel
    ) -> None:
        """Make data; `restore` comes before the first step.

        Args:
            shared: Attributes of the engine that is copied, which has no sleeping bodies.
            targets: Of this one.
            fallback: The model with the second solver: another thread may step the first.
        """
        self.__dict__.update(shared)
        self._data = mujoco.MjData(self._model)
        self._targets = targets
        self._fallback = fallback
        self._diverged: set[int] = set()
        self._is_sleep_changed = False

    @property
    def is_diverged(self) -> bool:
        """Whether a body has diverged."""
        return bool(self._diverged)

    def restore(self, saved: SavedState) -> None:
        """Load a state of the engine that is copied."""
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        mujoco.mj_setState(self._model, self._data, saved.numbers, kind)
        self._data.qacc[:] = saved.accelerations
        self._data.ncon = 0  # a state has no contacts; the next step finds them
        self._has_loads = True  # of the state that is copied
        self._diverged.clear()

    def take(self, data: mujoco.MjData, *, is_diverged: bool) -> None:
        """Take the state of another copy, with its contacts."""
        mujoco.mj_copyData(self._data, self._model, data)
        if is_diverged:
            self._find_diverged()

    def note_new_modes(self) -> None:
        """Let the next step find which motors are on: their modes have changed."""
        for body in self._bodies:
            self._set_joint_motors(body)
        self._is_changed = True

    def list_touching(self) -> IndexArray:
        """List the bodies that touch another one, repeatedly; what carries them does not count."""
        data = self._data
        if not data.ncon:
            return NO_OWNERS
        owners = self._owners[data.contact.geom]
        is_pair = (owners[:, 0] != owners[:, 1]) & (owners != NO_INDEX).all(axis=1)
        pairs = np.flatnonzero(is_pair)
        if not len(pairs):
            return NO_OWNERS
        # A normal points to the second body: upward if the first one carries it.
        owners, upward = owners[pairs], data.contact.frame[pairs, 2]
        is_static = np.array(
            [[self._bodies[body].archetype.is_static for body in pair] for pair in owners.tolist()]
        )
        upward = np.stack([upward, -upward], axis=1)
        is_carried = (is_static & (upward > SUPPORT_NORMAL_Z)).any(axis=1)
        return np.asarray(owners[~is_carried].ravel())

    def _step_by_fallback(self) -> None:
        mujoco.mj_step2(self._fallback, self._data)

    def _find_diverged(self) -> None:
        """Note that a body diverged; its slot stays active, as it is that of all copies."""
        self._diverged.update(self._bodies)


class ReplicaGroup:
    """Copies that make their steps together, each with the bits of `MujocoEngine.step`."""

    def __init__(self, replicas: "MujocoReplicas", part: IndexArray) -> None:
        """Prepare arrays.

        Args:
            replicas: All copies.
            part: Which of them make their steps together; in a row.
        """
        self._arguments = replicas, part
        self._worlds = [replicas.worlds[at] for at in part.tolist()]
        self._all_speeds = replicas.speeds[part[0] : part[-1] + 1]

    def __reduce__(self) -> tuple[object, ...]:
        """Make the views anew."""
        return ReplicaGroup, self._arguments

    def step(self) -> bool:
        """See `SteppedTogether`."""
        live = [one for one, world in enumerate(self._worlds) if not world.is_diverged]
        if live:
            step_worlds([self._worlds[one] for one in live], self._all_speeds[live])
        return not any(world.is_diverged for world in self._worlds)


class MujocoReplicas(EngineReplicas):
    """Many data of one model; states and targets of all are single arrays.

    Attributes:
        worlds: The copies.
        speeds: (worlds, degrees of freedom) their `ActuatorTargets.speeds`.
    """

    def __init__(
        self, engine: SteppedWorld, saved: SavedState, bodies: Sequence[int], count: int
    ) -> None:
        """Make the copies.

        Args:
            engine: A copied one, which nothing else uses.
            saved: Its state.
            bodies: See `Engine.replicate`.
            count: Likewise.
        """
        self._arguments = engine, saved, bodies, count
        self._saved, shared = saved, vars(engine)
        model, targets = shared["_model"], shared["_targets"]
        fallback = copy(model)
        fallback.opt.solver, fallback.opt.iterations = FALLBACK_SOLVER
        stacked = [np.tile(getattr(targets, one.name), (count, 1)) for one in fields(targets)]
        self._targets = ActuatorTargets(*(values.reshape(-1) for values in stacked))
        self.worlds = [
            ReplicatedWorld(shared, ActuatorTargets(*rows), fallback)
            for rows in zip(*stacked, strict=True)
        ]
        self.speeds = stacked[[one.name for one in fields(targets)].index("speeds")]
        self.restore(range(count))
        states = [world.data for world in self.worlds]
        self._views = [data.qpos for data in states], [data.qvel for data in states]
        self._numbers = np.empty(count * model.nq), np.empty(count * model.nv)
        known: dict[int, MujocoBody] = shared["_bodies"]
        self._bodies = len(bodies)
        self._columns = np.full(max(known, default=0) + 1, NO_INDEX)
        self._columns[list(bodies)] = np.arange(len(bodies))
        self._selection = make_body_selection(
            [
                _shift_body(known[body], positions=copied * model.nq, velocities=copied * model.nv)
                for copied in range(count)
                for body in bodies
            ]
        )

    def __reduce__(self) -> tuple[object, ...]:
        """Make the views anew; take what the next steps depend on."""
        states = [(world.data, world.is_diverged) for world in self.worlds]
        return MujocoReplicas, self._arguments, (states, self._targets)

    def __setstate__(self, state: tuple[list[tuple[mujoco.MjData, bool]], ActuatorTargets]) -> None:
        """Put in what was copied."""
        for world, (data, is_diverged) in zip(self.worlds, state[0], strict=True):
            world.take(data, is_diverged=is_diverged)
        for one in fields(self._targets):
            getattr(self._targets, one.name)[:] = getattr(state[1], one.name)

    def make_groups(self, least: int) -> Sequence[SteppedTogether]:
        """See `EngineReplicas.make_groups`."""
        count = len(self.worlds)
        parts = np.array_split(np.arange(count), min(count, max(least, -(-count // GROUP_SIZE))))
        return [ReplicaGroup(self, part) for part in parts]

    def read(self) -> BodyStates:
        """See `EngineReplicas.read`."""
        qpos, qvel = self._numbers
        np.concatenate(self._views[0], out=qpos)
        np.concatenate(self._views[1], out=qvel)
        gather = self._selection.gather
        with np.errstate(all="ignore"):  # diverged
            base = self._selection.read_bases(qpos, qvel)
        found = BodyStates(
            base,
            gather.gather_joints(qpos, gather.positions),
            gather.gather_joints(qvel, gather.velocities),
        )
        for copied, world in enumerate(self.worlds):
            if world.is_diverged:
                for rows in (found.base, found.joint_positions, found.joint_velocities):
                    rows.reshape(len(self.worlds), -1)[copied] = np.nan
        return found

    def command(self, targets: FloatArray) -> None:
        """See `EngineReplicas.command`."""
        if self._selection.scatter.apply(self._targets, targets.reshape(-1)):
            for world in self.worlds:
                world.note_new_modes()

    def restore(self, copies: Iterable[int]) -> None:
        """See `EngineReplicas.restore`."""
        for copied in copies:
            self.worlds[copied].restore(self._saved)

    def find_touching(self) -> BoolArray:
        """See `EngineReplicas.find_touching`."""
        found = np.zeros((len(self.worlds), self._bodies + 1), np.bool_)
        for row, world in zip(found, self.worlds, strict=True):
            touching = world.list_touching()
            if len(touching):
                row[self._columns[touching]] = True  # of the others: the last
        return found[:, :-1]


def _shift_body(body: MujocoBody, *, positions: int, velocities: int) -> MujocoBody:
    """Move the indexes of a body in qpos and qvel to those of a copy."""
    start = body.address.start
    start = replace(
        start, positions=start.positions + positions, velocities=start.velocities + velocities
    )
    return replace(body, address=replace(body.address, start=start))
