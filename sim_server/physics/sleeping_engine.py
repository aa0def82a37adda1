"""An Engine layer that puts bodies at rest to sleep: they are neither stepped nor read."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Decay, Inertial, Model
from zensim.sim_server.physics.actuation import Actuation, make_actuation
from zensim.sim_server.physics.body_reach import MAX_REACH_M, ReachCache
from zensim.sim_server.physics.command_cache import CommandCache
from zensim.sim_server.physics.engine import BodyStates, Engine, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.engine_layer import EngineLayer

IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]

SLEEP_DELAY_S = 1.0
"""For how long a body must hardly move."""
SPEED_MARGIN_MPS = 1.0
"""What may come to the speed of an awake body until the next look."""
WAKE_DISTANCE_M = 0.02
BODIES_PER_CHUNK = 256
"""Awake bodies whose distances from all others are found at once."""


class SleepState(IntEnum):
    """What a body does, as far as sleep goes."""

    UNKNOWN = 0
    FIXED = 1
    """Never moves, and wakes nobody."""
    NEVER_SLEEPS = 2
    """Never sleeps."""
    AWAKE = 3
    ASLEEP = 4


@dataclass(frozen=True)
class SleepThresholds:
    """What a body may do in `SLEEP_DELAY_S` and still be calm: metres, radians, and of its joints."""

    moved_m: float
    turned_rad: float
    joint: float


FREE_BODY_THRESHOLDS = SleepThresholds(5e-4, 1e-3, 1e-3)
BRAKED_BODY_THRESHOLDS = SleepThresholds(3e-3, 0.015, 0.1)
"""Of robots whose motors hold wheels: what a finite solver leaves lets those creep by 1-2 mm/s."""


def choose_sleep_thresholds(model: Model) -> SleepThresholds:
    """Find by what a model is judged."""
    return BRAKED_BODY_THRESHOLDS if make_actuation(model).speeds.joints else FREE_BODY_THRESHOLDS


def find_initial_sleep_state(model: Model) -> SleepState:
    """Say whether bodies of a model may sleep.

    Those do not that something acts on in every step: loads, gears, a twist of their own.
    """
    if model.is_static:
        can_move = any(joint.kind != "fixed" for joint in model.joints)
        return SleepState.NEVER_SLEEPS if can_move else SleepState.FIXED
    is_loaded = any(link.weightless != Inertial() or link.decay != Decay() for link in model.links)
    is_geared = any(joint.mimic is not None for joint in model.joints)
    is_imposed = make_actuation(model).twist is not None
    return SleepState.NEVER_SLEEPS if is_loaded or is_geared or is_imposed else SleepState.AWAKE


class SleepTracker:
    """Bodies by number: where each was when it last moved, or where it sleeps."""

    def __init__(self, calm_steps: int) -> None:
        self._delay_steps = calm_steps
        self.state = np.zeros(64, dtype=np.int8)
        self.is_driven = np.zeros(64, dtype=np.bool_)
        self.radius: FloatArray = np.zeros(64)
        self.base: FloatArray = np.full((64, 13), np.nan)
        self.joints: FloatArray = np.zeros((64, 4))
        self.joint_count = np.zeros(64, dtype=np.intp)
        self._since = np.zeros(64, dtype=np.int64)
        self._bounds: FloatArray = np.zeros((64, 3))

    def add(self, body: int, model: Model, radius_m: float, step: int) -> None:
        """Take a new body in."""
        self._make_room(body, len(model.joints))
        bounds = choose_sleep_thresholds(model)
        self.state[body] = find_initial_sleep_state(model)
        self.radius[body] = radius_m
        self.joint_count[body] = len(model.joints)
        self._bounds[body] = bounds.moved_m, bounds.turned_rad, bounds.joint
        self.is_driven[body] = False
        self.mark_moved(body, step)

    def mark_moved(self, body: int | IntArray, step: int) -> None:
        """Note that a body may move from now on, perhaps from another place."""
        self.base[body] = np.nan
        self._since[body] = step

    def remove(self, body: int) -> None:
        """Forget a body."""
        self.state[body] = SleepState.UNKNOWN

    def in_states(self, *states: SleepState) -> BoolArray:
        """Find the bodies that are in one of some states."""
        return np.asarray(np.isin(self.state, states))

    def update(self, bodies: IntArray, reading: BodyStates, step: int) -> BoolArray:
        """See how far bodies came, and say which have been calm for long enough."""
        positions = self._grid(bodies, reading.joint_positions)
        before = self.base[bodies]
        moved, turned, bent = self._bounds[bodies].T
        with np.errstate(all="ignore"):  # of bodies gone bad
            away = np.linalg.norm(reading.base[:, :3] - before[:, :3], axis=1)
            # Of the half turn between two quaternions, whichever sign they have.
            cosines = np.abs((reading.base[:, 3:7] * before[:, 3:7]).sum(axis=1))
            is_calm = (away <= moved) & (cosines >= np.cos(turned / 2.0))
        swung = np.abs(positions - self.joints[bodies]).max(axis=1, initial=0.0)
        is_calm &= swung <= bent
        stirred = bodies[~is_calm]
        self.base[stirred] = reading.base[~is_calm]
        self.joints[stirred] = positions[~is_calm]
        self._since[stirred] = step
        return np.asarray(step - self._since[bodies] >= self._delay_steps)

    def store_asleep(self, bodies: IntArray, reading: BodyStates) -> None:
        """Keep the state in which bodies fall asleep: at rest."""
        self.state[bodies] = SleepState.ASLEEP
        self.base[bodies] = reading.base
        self.base[bodies, 7:] = 0.0
        self.joints[bodies] = self._grid(bodies, reading.joint_positions)

    def joints_of(self, bodies: IntArray) -> FloatArray:
        """List the joint positions of sleepers, body by body."""
        return np.asarray(self.joints[bodies][self._mask(bodies)])

    def _grid(self, bodies: IntArray, numbers: FloatArray) -> FloatArray:
        found = np.zeros((len(bodies), self.joints.shape[1]))
        found[self._mask(bodies)] = numbers
        return found

    def _mask(self, bodies: IntArray) -> BoolArray:
        columns = np.arange(self.joints.shape[1])
        return np.asarray(columns < self.joint_count[bodies][:, None])

    def _make_room(self, body: int, joints: int) -> None:
        height, width = len(self.state), self.joints.shape[1]
        if joints > width:
            self.joints = np.pad(self.joints, ((0, 0), (0, joints - width)))
        if body < height:
            return
        more = max(height, body + 1 - height)
        for name in ("state", "is_driven", "radius", "joint_count", "_since"):
            setattr(self, name, np.pad(getattr(self, name), (0, more)))
        for name in ("base", "joints", "_bounds"):
            setattr(self, name, np.pad(getattr(self, name), ((0, more), (0, 0))))


def find_reachable(
    base: FloatArray, radius: FloatArray, others: FloatArray, radii: FloatArray, ahead_s: float
) -> BoolArray:
    """Find the others that bodies may touch soon.

    Args:
        base: (n, 13) of the bodies.
        radius: (n,) of balls that hold them.
        others: (m, 3) where the others are.
        radii: (m,) of balls that hold them.
        ahead_s: How soon.

    Returns:
        (m,) whether any may.
    """
    found = np.zeros(len(others), dtype=np.bool_)
    with np.errstate(all="ignore"):  # of bodies gone bad
        spins = radius * np.linalg.norm(base[:, 10:], axis=1)
        speeds = np.linalg.norm(base[:, 7:10], axis=1) + spins
        reach = radius + WAKE_DISTANCE_M + (speeds + SPEED_MARGIN_MPS) * ahead_s
        for start in range(0, len(base), BODIES_PER_CHUNK):
            some = slice(start, start + BODIES_PER_CHUNK)
            apart = np.linalg.norm(base[some, None, :3] - others[None], axis=2)
            found |= (apart < reach[some, None] + radii[None]).any(axis=0)
    return found


SLEEP_CHECK_PERIOD_S = 0.1
LOOKAHEAD_PERIODS = 2.0
"""How far ahead a look sees, in looks."""


def wrap_with_sleep(engine: Engine, config: EngineConfig) -> Engine:
    """Let bodies sleep in an engine, if they can."""
    return SleepingEngine(engine, config) if engine.capabilities.sleeps else engine


class DeferredPush(NamedTuple):
    """A wrench on a link, or an effort on a joint, in the next step."""

    body: int
    where: int
    what: FloatArray | float


class _ReadRows(NamedTuple):
    """Where the bodies of a reading come from, awake and asleep."""

    awake: tuple[int, ...]
    asleep: IntArray
    awake_rows: IntArray
    asleep_rows: IntArray
    awake_joints: IntArray
    asleep_joints: IntArray


class SleepingEngine(EngineLayer):
    """An engine whose bodies at rest sleep."""

    def __init__(self, engine: Engine, config: EngineConfig) -> None:
        super().__init__(engine)
        dt_s = config.step_ns * 1e-9
        self._measure = ReachCache(config.mesh_folder)
        self._every = max(1, round(SLEEP_CHECK_PERIOD_S / dt_s))
        self._ahead_s = LOOKAHEAD_PERIODS * self._every * dt_s
        self._steps = 0
        self._tracker = SleepTracker(max(1, round(SLEEP_DELAY_S / dt_s)))
        self._plans: dict[int, Actuation] = {}
        self._commands = CommandCache(lambda body: self._plans[body].width)
        self._touched: dict[int, frozenset[int]] = {}
        self._hidden: dict[int, SleepState] = {}
        self._waking: set[int] = set()
        self._deferred_pushes: list[DeferredPush] = []
        self._rows: tuple[Sequence[int], _ReadRows] | None = None

    @property
    def asleep(self) -> tuple[int, ...]:
        """The bodies that sleep."""
        return tuple(self._bodies_in(SleepState.ASLEEP).tolist())

    def add(self, model: Model, base: FloatArray) -> int:
        """See `Engine.add`."""
        body = self._inner.add(model, base)
        self._plans[body] = make_actuation(model)
        self._commands.forget(body)
        self._tracker.add(body, model, self._find_radius_m(model), self._steps)
        if self._tracker.state[body] == SleepState.FIXED:
            # Else each sleeper that stands on it would be looked for contacts in each step.
            self._inner.sleep([body])
        self._rows = None
        self._wake_near(body, base)
        return body

    def remove(self, body: int) -> None:
        """See `Engine.remove`; who may have stood on it wakes."""
        self._wake([body])
        if self._touched:
            self._wake_near(body, self._inner.read([body]).base[0])
        self._inner.remove(body)
        self._tracker.remove(body)
        self._hidden.pop(body, None)
        self._deferred_pushes = [push for push in self._deferred_pushes if push.body != body]
        self._waking.discard(body)
        self._rows = None

    def hide(self, body: int) -> None:
        """See `Engine.hide`."""
        self._inner.hide(body)
        self._hidden[body] = SleepState(self._tracker.state[body])
        self._tracker.remove(body)

    def show(self, bodies: Sequence[int]) -> None:
        """See `Engine.show`."""
        self._inner.show(bodies)
        for body in bodies:
            self._tracker.state[body] = self._hidden.pop(body)
            self._tracker.mark_moved(body, self._steps)
        if self._touched:
            for body, base in zip(bodies, self._inner.read(bodies).base, strict=True):
                self._wake_near(body, base)

    def forget_removed(self) -> None:
        """See `Engine.forget_removed`."""
        self._inner.forget_removed()
        self._wake(self.asleep)
        self._steps = 0
        self._tracker.mark_moved(np.flatnonzero(self._tracker.state), 0)

    def read(self, bodies: Sequence[int]) -> BodyStates:
        """See `Engine.read`; sleepers stand where they fell asleep."""
        if not self._touched:
            return self._inner.read(bodies)
        rows = self._split_rows(bodies)
        if not len(rows.asleep):
            return self._inner.read(bodies)
        reading = self._inner.read(rows.awake)
        joints = len(rows.awake_joints) + len(rows.asleep_joints)
        base, positions, velocities = (
            np.empty((len(bodies), 13)),
            np.empty(joints),
            np.zeros(joints),
        )
        base[rows.awake_rows] = reading.base
        base[rows.asleep_rows] = self._tracker.base[rows.asleep]
        positions[rows.awake_joints] = reading.joint_positions
        positions[rows.asleep_joints] = self._tracker.joints_of(rows.asleep)
        velocities[rows.awake_joints] = reading.joint_velocities
        return BodyStates(base, positions, velocities)

    def set_base_state(self, body: int, base: FloatArray) -> None:
        """See `Engine.set_base_state`."""
        self._mark_placed(body, base)
        self._inner.set_base_state(body, base)

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.set_state`."""
        self._mark_placed(body, base)
        self._inner.set_state(body, base, positions, velocities)

    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.set_at_rest`."""
        self._mark_placed(body, base)
        self._commands.forget(body)
        self._tracker.is_driven[body] = False
        self._inner.set_at_rest(body, base, positions)

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`; who is told something new wakes."""
        news = list(self._commands.take_changed(bodies, targets))
        if not news:
            return
        self._inner.command(bodies, targets)
        for body, numbers in news:
            plan = self._plans[body]
            twist = numbers[plan.twist : plan.twist + 3] if plan.twist is not None else []
            self._tracker.is_driven[body] = any(plan.speeds.select(numbers)) or any(twist)
            self._tracker.mark_moved(body, self._steps)
        self._wake([body for body, _ in news])

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.apply_link_wrench`; a sleeper is pushed a step later, when it is awake."""
        if self._wake_for_push(body):
            self._deferred_pushes.append(DeferredPush(body, link, wrench.copy()))
        else:
            self._inner.apply_link_wrench(body, link, wrench)

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.apply_joint_effort`; a sleeper is pushed a step later, when it is awake."""
        if self._wake_for_push(body):
            self._deferred_pushes.append(DeferredPush(body, joint, effort))
        else:
            self._inner.apply_joint_effort(body, joint, effort)

    def step(self) -> bool:
        """See `Engine.step`."""
        is_well = self._inner.step()
        self._steps += 1
        self._waking.clear()
        late, self._deferred_pushes = self._deferred_pushes, []
        for push in late:
            if isinstance(push.what, float):
                self._inner.apply_joint_effort(push.body, push.where, push.what)
            else:
                self._inner.apply_link_wrench(push.body, push.where, push.what)
        if self._steps % self._every == 0 and is_well:
            self._update_sleepers()
        return is_well

    def _update_sleepers(self) -> None:
        calm = self._tracker
        asleep, awake = self._bodies_in(SleepState.ASLEEP), self._bodies_in(SleepState.AWAKE)
        quiet = awake[~calm.is_driven[awake]]
        if not len(quiet) and not len(asleep):
            return
        reading = self._inner.read(tuple(quiet.tolist()))
        is_ripe = calm.update(quiet, reading, self._steps)
        if not is_ripe.any() and not len(asleep):
            return
        ripe, base = quiet[is_ripe], reading.base[is_ripe]
        restless = np.setdiff1d(self._bodies_in(SleepState.AWAKE, SleepState.NEVER_SLEEPS), ripe)
        moving = self._inner.read(tuple(restless.tolist())).base
        radius = calm.radius[restless]
        spots, radii = calm.base[asleep, :3], calm.radius[asleep]
        self._wake(asleep[find_reachable(moving, radius, spots, radii, self._ahead_s)].tolist())
        is_near = find_reachable(moving, radius, base[:, :3], calm.radius[ripe], self._ahead_s)
        self._put_to_sleep(ripe[~is_near].tolist())

    def _put_to_sleep(self, bodies: list[int]) -> None:
        """Let those sleep that touch none who stays awake."""
        touched = {body: frozenset(self._inner.find_contacts(body)) for body in bodies}
        fixed = set(self._bodies_in(SleepState.FIXED).tolist())
        while True:
            still = touched.keys() | self._touched.keys() | fixed
            awake = [body for body, others in touched.items() if not others <= still]
            if not awake:
                break
            for body in awake:
                del touched[body]
        if touched:
            numbers = np.array(list(touched), dtype=np.intp)
            self._tracker.store_asleep(numbers, self._inner.read(tuple(touched)))
            self._inner.sleep(tuple(touched))
            self._touched |= touched
            self._rows = None

    def _wake(self, bodies: Iterable[int]) -> None:
        """Wake sleepers among some bodies, and all that they touched."""
        waiting, woken = [body for body in bodies if body in self._touched], []
        while waiting:
            if (body := waiting.pop()) in self._touched:
                waiting += sorted(self._touched.pop(body))
                woken.append(body)
        if woken:
            self._tracker.state[woken] = SleepState.AWAKE
            self._tracker.mark_moved(np.array(woken, dtype=np.intp), self._steps)
            self._inner.wake(sorted(woken))
            self._waking.update(woken)
            self._rows = None

    def _wake_near(self, body: int, base: FloatArray) -> None:
        if not self._touched:
            return
        asleep, calm = self._bodies_in(SleepState.ASLEEP), self._tracker
        spots, radii = calm.base[asleep, :3], calm.radius[asleep]
        near = find_reachable(base[None], calm.radius[[body]], spots, radii, self._ahead_s)
        self._wake(asleep[near].tolist())

    def _mark_placed(self, body: int, base: FloatArray) -> None:
        """Note that a body is taken from where it is, and put somewhere."""
        self._wake([body])
        if self._touched:
            self._wake_near(body, self._inner.read([body]).base[0])
            self._wake_near(body, base)
        self._tracker.mark_moved(body, self._steps)

    def _wake_for_push(self, body: int) -> bool:
        """Wake a body, and say whether it was woken since the last step: the next passes it by."""
        self._wake([body])
        self._tracker.mark_moved(body, self._steps)
        return body in self._waking

    def _split_rows(self, bodies: Sequence[int]) -> _ReadRows:
        """Part the bodies of a reading: those of the same tuple are at hand."""
        if self._rows is not None and self._rows[0] == bodies:
            return self._rows[1]
        numbers = np.array(bodies, dtype=np.intp)
        is_asleep = self._tracker.state[numbers] == SleepState.ASLEEP
        has_sleeper = np.repeat(is_asleep, self._tracker.joint_count[numbers])
        found = _ReadRows(
            tuple(numbers[~is_asleep].tolist()),
            numbers[is_asleep],
            np.flatnonzero(~is_asleep),
            np.flatnonzero(is_asleep),
            np.flatnonzero(~has_sleeper),
            np.flatnonzero(has_sleeper),
        )
        if isinstance(bodies, tuple):
            self._rows = bodies, found
        return found

    def _bodies_in(self, *states: SleepState) -> IntArray:
        return np.flatnonzero(self._tracker.in_states(*states))

    def _find_radius_m(self, model: Model) -> float:
        """Find the radius of a ball about the root that holds a body, however far it slides."""
        slides = [joint for joint in model.joints if joint.kind == "prismatic"]
        ways = (max(abs(joint.lower), abs(joint.upper)) for joint in slides)
        return min(self._measure.measure(model).radius_m + sum(ways) + WAKE_DISTANCE_M, MAX_REACH_M)
