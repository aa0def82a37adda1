"""Engine layer that puts bodies at rest to sleep: they are neither stepped nor read."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.model_messages import Decay, Inertial, Model
from zensim.sim_server.physics.actuation import Actuation, make_actuation
from zensim.sim_server.physics.body_reach import MAX_REACH_M, ReachCache
from zensim.sim_server.physics.command_cache import CommandCache
from zensim.sim_server.physics.engine import BodyStates, BoolArray, Engine, FloatArray, IntArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.engine_layer import EngineLayer

SLEEP_DELAY_S = 1.0
"""Time within the thresholds before a body sleeps."""
SPEED_MARGIN_MPS = 1.0
"""Speed that an awake body may gain until the next check."""
WAKE_DISTANCE_M = 0.02
"""Gap below which bodies count as near."""
BODIES_PER_CHUNK = 256
"""Awake bodies per distance matrix, to bound memory."""
MOTIONLESS_M, MOTIONLESS_RAD = 2e-5, 1e-5
"""Largest motion since the last check, or its placement, of a body that sleeps without delay; of
joints in rad or m the second.

A box sinks 0.01 mm into its contacts when Bullet simulates it first, a robot that is placed on its
wheels 0.02 mm in a tenth of a second, and 0.001 mm in the next.
"""
MOTIONLESS_SPEED = 1e-4
"""Largest speed [m/s and rad/s] of a body that sleeps without delay, of joints, too."""
SLEEP_CHECK_PERIOD_S = 0.1
LOOKAHEAD_PERIODS = 2.0
"""Time ahead for which contacts are predicted, in check periods."""


class SleepState(IntEnum):
    """State of a body."""

    UNKNOWN = 0
    FIXED = 1
    """Never moves, and wakes no other body."""
    NEVER_SLEEPS = 2
    AWAKE = 3
    ASLEEP = 4


@dataclass(frozen=True)
class SleepThresholds:
    """Largest motion of a body at rest within `SLEEP_DELAY_S`; of joints in rad or m."""

    moved_m: float
    turned_rad: float
    joint: float


FREE_BODY_THRESHOLDS = SleepThresholds(5e-4, 1e-3, 1e-3)
BRAKED_BODY_THRESHOLDS = SleepThresholds(3e-3, 0.015, 0.1)
"""Thresholds where motors brake wheels: solver residuals let such robots creep by 1-2 mm/s."""


def choose_sleep_thresholds(model: Model) -> SleepThresholds:
    """Choose the thresholds of a model."""
    return BRAKED_BODY_THRESHOLDS if make_actuation(model).speeds.joints else FREE_BODY_THRESHOLDS


def is_loose(model: Model) -> bool:
    """Whether nothing but its surroundings moves a model: it has neither joints nor actuators."""
    return not model.joints and not make_actuation(model).width


def may_skip_delay(model: Model) -> bool:
    """Whether bodies of a model sleep once they do not move at all: loose ones, and braked robots.

    A chain of joints without brakes may be about to fall.
    """
    return is_loose(model) or bool(make_actuation(model).speeds.joints)


def find_initial_sleep_state(model: Model) -> SleepState:
    """Find whether bodies of a model may sleep.

    Bodies with loads, gears or a planar twist do not: these act in every step.
    """
    if model.is_static:
        has_joints = any(joint.kind != "fixed" for joint in model.joints)
        return SleepState.NEVER_SLEEPS if has_joints else SleepState.FIXED
    is_loaded = any(link.weightless != Inertial() or link.decay != Decay() for link in model.links)
    is_geared = any(joint.mimic is not None for joint in model.joints)
    has_twist = make_actuation(model).twist is not None
    return SleepState.NEVER_SLEEPS if is_loaded or is_geared or has_twist else SleepState.AWAKE


@dataclass(frozen=True)
class SleepTraits:
    """How bodies of a model sleep.

    Attributes:
        actuation: Of the model.
        initial_state: Of its bodies.
        thresholds: Of its bodies.
        skips_delay: See `may_skip_delay`.
        is_loose: See `is_loose`.
    """

    actuation: Actuation
    initial_state: SleepState
    thresholds: SleepThresholds
    skips_delay: bool
    is_loose: bool


def find_sleep_traits(model: Model) -> SleepTraits:
    """Find how bodies of a model sleep."""
    return SleepTraits(
        make_actuation(model),
        find_initial_sleep_state(model),
        choose_sleep_thresholds(model),
        may_skip_delay(model),
        is_loose(model),
    )


class SleepTracker:
    """States by body number: when the body last moved, or in which it sleeps."""

    def __init__(self, delay_steps: int) -> None:
        self._delay_steps = delay_steps
        self.state = np.zeros(64, dtype=np.int8)
        self.is_driven = np.zeros(64, dtype=np.bool_)
        self.radius: FloatArray = np.zeros(64)
        self.base: FloatArray = np.full((64, 13), np.nan)
        self.joints: FloatArray = np.zeros((64, 4))
        self.joint_count = np.zeros(64, dtype=np.intp)
        self._since = np.zeros(64, dtype=np.int64)
        self._last: tuple[Model, SleepTraits] | None = None
        self._limits: FloatArray = np.zeros((64, 3))
        self._may_skip_delay = np.zeros(64, dtype=np.bool_)
        self._checked_base: FloatArray = np.full((64, 13), np.nan)
        """State at the last check."""
        self._checked_joints: FloatArray = np.zeros((64, 4))

    def add(
        self, body: int, model: Model, radius_m: float, step: int, base: FloatArray | None = None
    ) -> None:
        """Add a body; with `base` (13,), the first check of a loose one is its placement."""
        self._make_room(body, len(model.joints))
        traits = self.find_traits(model)
        limits = traits.thresholds
        self.state[body] = traits.initial_state
        self.radius[body] = radius_m
        self.joint_count[body] = len(model.joints)
        self._limits[body] = limits.moved_m, limits.turned_rad, limits.joint
        self._may_skip_delay[body] = traits.skips_delay
        self.is_driven[body] = False
        self.mark_moved(body, step)
        if base is not None and traits.is_loose:
            self._checked_base[body] = base

    def find_traits(self, model: Model) -> SleepTraits:
        """Find how bodies of a model sleep; cached for the last model."""
        if self._last is None or self._last[0] is not model:
            self._last = model, find_sleep_traits(model)
        return self._last[1]

    def keep_awake(self, body: int) -> None:
        """Let a body that moves never sleep."""
        if self.state[body] == SleepState.AWAKE:
            self.state[body] = SleepState.NEVER_SLEEPS

    def mark_moved(self, body: int | IntArray, step: int) -> None:
        """Restart the delay of a body, whose pose may have changed."""
        self.base[body] = self._checked_base[body] = np.nan
        self._since[body] = step

    def remove(self, body: int) -> None:
        """Remove a body."""
        self.state[body] = SleepState.UNKNOWN

    def in_states(self, *states: SleepState) -> BoolArray:
        """Mask of the bodies in any of these states."""
        return np.asarray(np.isin(self.state, states))

    def update(self, bodies: IntArray, reading: BodyStates, step: int) -> BoolArray:
        """Compare bodies with where they last moved.

        Returns:
            Mask of those at rest for the whole delay, and of those that skip it: they have not
            moved at all since the last check.
        """
        positions = self._pad(bodies, reading.joint_positions)
        is_still = self._find_still(bodies, reading.base, positions)
        moved = bodies[~is_still]
        self.base[moved] = reading.base[~is_still]
        self.joints[moved] = positions[~is_still]
        self._since[moved] = step
        is_rested = step - self._since[bodies] >= self._delay_steps
        is_motionless = self._find_motionless(bodies, reading, positions)
        self._checked_base[bodies], self._checked_joints[bodies] = reading.base, positions
        return np.asarray(is_rested | is_motionless)

    def _find_still(self, bodies: IntArray, base: FloatArray, positions: FloatArray) -> BoolArray:
        """Find the bodies that have hardly moved since the start of their delay."""
        distance_limit, angle_limit, joint_limit = self._limits[bodies].T
        distance, cosine = _measure_motion(self.base[bodies], base)
        is_still = (distance <= distance_limit) & (cosine >= np.cos(angle_limit / 2.0))
        joint_motion = np.abs(positions - self.joints[bodies]).max(axis=1, initial=0.0)
        return np.asarray(is_still & (joint_motion <= joint_limit))

    def _find_motionless(
        self, bodies: IntArray, reading: BodyStates, positions: FloatArray
    ) -> BoolArray:
        """Find the bodies that skip the delay as they have not moved since the last check."""
        distance, cosine = _measure_motion(self._checked_base[bodies], reading.base)
        joints = np.abs(positions - self._checked_joints[bodies]).max(axis=1, initial=0.0)
        joint_speeds = np.abs(self._pad(bodies, reading.joint_velocities))
        with np.errstate(all="ignore"):  # diverged bodies
            speed = np.abs(reading.base[:, 7:]).max(axis=1, initial=0.0)
            return np.asarray(
                self._may_skip_delay[bodies]
                & (distance <= MOTIONLESS_M)
                & (cosine >= np.cos(MOTIONLESS_RAD / 2.0))
                & (joints <= MOTIONLESS_RAD)
                & (np.maximum(speed, joint_speeds.max(axis=1, initial=0.0)) <= MOTIONLESS_SPEED)
            )

    def store_asleep(self, bodies: IntArray, reading: BodyStates) -> None:
        """Store the state in which bodies fall asleep, with zero velocity."""
        self.state[bodies] = SleepState.ASLEEP
        self.base[bodies] = reading.base
        self.base[bodies, 7:] = 0.0
        self.joints[bodies] = self._pad(bodies, reading.joint_positions)

    def joints_of(self, bodies: IntArray) -> FloatArray:
        """Joint positions of sleeping bodies, body by body."""
        return np.asarray(self.joints[bodies][self._mask(bodies)])

    def _pad(self, bodies: IntArray, values: FloatArray) -> FloatArray:
        padded = np.zeros((len(bodies), self.joints.shape[1]))
        padded[self._mask(bodies)] = values
        return padded

    def _mask(self, bodies: IntArray) -> BoolArray:
        columns = np.arange(self.joints.shape[1])
        return np.asarray(columns < self.joint_count[bodies][:, None])

    def _make_room(self, body: int, joints: int) -> None:
        height, width = len(self.state), self.joints.shape[1]
        if joints > width:
            for name in ("joints", "_checked_joints"):
                setattr(self, name, np.pad(getattr(self, name), ((0, 0), (0, joints - width))))
        if body < height:
            return
        more = max(height, body + 1 - height)
        for name in ("state", "is_driven", "radius", "joint_count", "_since", "_may_skip_delay"):
            setattr(self, name, np.pad(getattr(self, name), (0, more)))
        for name in ("base", "joints", "_limits", "_checked_base", "_checked_joints"):
            setattr(self, name, np.pad(getattr(self, name), ((0, more), (0, 0))))


def _measure_motion(before: FloatArray, after: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Measure the way (n,) between states (n, 13), and the cosine (n,) of half the angle."""
    with np.errstate(all="ignore"):  # diverged bodies
        distance = np.linalg.norm(after[:, :3] - before[:, :3], axis=1)
        # Two quaternions of either sign.
        cosine = np.abs((after[:, 3:7] * before[:, 3:7]).sum(axis=1))
    return distance, cosine


def find_reachable(
    base: FloatArray, radius: FloatArray, others: FloatArray, radii: FloatArray, ahead_s: float
) -> BoolArray:
    """Find which others any of some bodies may touch soon.

    Args:
        base: (n, 13) of the bodies.
        radius: (n,) of their bounding spheres.
        others: (m, 3) positions of the others.
        radii: (m,) of their bounding spheres.
        ahead_s: Time ahead.

    Returns:
        (m,) mask.
    """
    found = np.zeros(len(others), dtype=np.bool_)
    with np.errstate(all="ignore"):  # diverged bodies
        rim_speeds = radius * np.linalg.norm(base[:, 10:], axis=1)
        speeds = np.linalg.norm(base[:, 7:10], axis=1) + rim_speeds
        reach = radius + WAKE_DISTANCE_M + (speeds + SPEED_MARGIN_MPS) * ahead_s
        for start in range(0, len(base), BODIES_PER_CHUNK):
            chunk = slice(start, start + BODIES_PER_CHUNK)
            distance = np.linalg.norm(base[chunk, None, :3] - others[None], axis=2)
            found |= (distance < reach[chunk, None] + radii[None]).any(axis=0)
    return found


def wrap_with_sleep(engine: Engine, config: EngineConfig) -> Engine:
    """Add the sleep layer to an engine that supports it."""
    return engine if engine.capabilities.sleeps == "none" else SleepingEngine(engine, config)


class DeferredLoad(NamedTuple):
    """A wrench on a link, or an effort on a joint, in the next step."""

    body: int
    part: int
    load: FloatArray | float


class _ReadRows(NamedTuple):
    """Rows of awake and sleeping bodies in a reading."""

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
        self._sleeps_loose_only = engine.capabilities.sleeps == "loose"
        self._candidates: set[int] = set()
        """Bodies that may sleep."""
        self._is_idle = False
        """Whether all bodies sleep or never move: a step changes nothing."""
        self._reaches = ReachCache(config.mesh_folder)
        self._period_steps = max(1, round(SLEEP_CHECK_PERIOD_S / dt_s))
        self._ahead_s = LOOKAHEAD_PERIODS * self._period_steps * dt_s
        self._steps = 0
        self._tracker = SleepTracker(max(1, round(SLEEP_DELAY_S / dt_s)))
        self._actuations: dict[int, Actuation] = {}
        self._commands = CommandCache(self._find_width)
        self._contacts: dict[int, frozenset[int]] = {}
        self._hidden: dict[int, SleepState] = {}
        self._waking: set[int] = set()
        self._deferred_loads: list[DeferredLoad] = []
        self._rows: tuple[Sequence[int], _ReadRows] | None = None

    def _find_width(self, body: int) -> int:
        return self._actuations[body].width

    @property
    def asleep(self) -> tuple[int, ...]:
        """Sleeping bodies."""
        return tuple(self._bodies_in(SleepState.ASLEEP).tolist())

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`; also measures one mesh."""
        return super().prepare(model) and self._reaches.prepare(model)

    def insert(self, body: int, model: Model, base: FloatArray) -> None:
        """See `Engine.insert`."""
        # Whatever may fail comes first: a body must not remain in the engine alone.
        traits, radius_m = self._tracker.find_traits(model), self._find_radius_m(model)
        self._inner.insert(body, model, base)
        self._actuations[body] = traits.actuation
        self._commands.forget(body)
        is_check = not self._steps % self._period_steps
        self._tracker.add(body, model, radius_m, self._steps, base if is_check else None)
        if self._sleeps_loose_only and not traits.is_loose:
            self._tracker.keep_awake(body)
        if self._tracker.state[body] == SleepState.AWAKE:
            self._candidates.add(body)
        if self._tracker.state[body] == SleepState.FIXED:
            # Else the engine searches contacts with each sleeping body on it in each step.
            self._inner.sleep([body])
        self._rows, self._is_idle = None, False
        self._wake_near([body], base[None])

    def discard(self, body: int) -> None:
        """See `Engine.discard`; bodies that may have stood on it wake."""
        self._wake([body])
        if self._contacts:
            self._wake_near([body], self._inner.read([body]).base)
        self._inner.discard(body)
        self._tracker.remove(body)
        self._candidates.discard(body)
        self._hidden.pop(body, None)
        self._deferred_loads = [load for load in self._deferred_loads if load.body != body]
        self._waking.discard(body)
        self._rows = None

    def hide(self, body: int) -> None:
        """See `Engine.hide`."""
        self._inner.hide(body)
        self._hidden[body] = SleepState(self._tracker.state[body])
        self._tracker.remove(body)

    def show(self, bodies: Sequence[int]) -> None:
        """See `Engine.show`."""
        self._is_idle = False
        self._inner.show(bodies)
        for body in bodies:
            self._tracker.state[body] = self._hidden.pop(body)
            self._tracker.mark_moved(body, self._steps)
        if self._contacts:
            self._wake_near(bodies, self._inner.read(bodies).base)

    def forget_removed(self) -> None:
        """See `Engine.forget_removed`."""
        self._is_idle = False
        self._inner.forget_removed()
        self._wake(self.asleep)
        self._steps = 0
        self._tracker.mark_moved(np.flatnonzero(self._tracker.state), 0)

    def read(self, bodies: Sequence[int]) -> BodyStates:
        """See `Engine.read`; sleeping bodies have the state in which they fell asleep."""
        if self._sleeps_loose_only or not self._contacts:
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
        """See `Engine.command`; bodies with new targets wake."""
        if self._sleeps_loose_only:  # these have no targets
            self._inner.command(bodies, targets)
            return
        changed = list(self._commands.take_changed(bodies, targets))
        if not changed:
            return
        self._inner.command(bodies, targets)
        for body, own in changed:
            self._tracker.is_driven[body] = self._actuations[body].is_driven(own)
            self._tracker.mark_moved(body, self._steps)
        self._wake([body for body, _ in changed])

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.apply_link_wrench`; a sleeping body gets it a step later, awake."""
        if self._wake_for_load(body):
            self._deferred_loads.append(DeferredLoad(body, link, wrench.copy()))
        else:
            self._inner.apply_link_wrench(body, link, wrench)

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.apply_joint_effort`; a sleeping body gets it a step later, awake."""
        if self._wake_for_load(body):
            self._deferred_loads.append(DeferredLoad(body, joint, effort))
        else:
            self._inner.apply_joint_effort(body, joint, effort)

    def step(self) -> bool:
        """See `Engine.step`."""
        is_valid = self._is_idle or self._inner.step()
        self._steps += 1
        self._waking.clear()
        deferred, self._deferred_loads = self._deferred_loads, []
        for body, part, load in deferred:
            if isinstance(load, float):
                self._inner.apply_joint_effort(body, part, load)
            else:
                self._inner.apply_link_wrench(body, part, load)
        is_check = self._steps % self._period_steps == 0
        if is_check and self._candidates and is_valid and not self._is_idle:
            self._update_sleepers()
            moving = self._bodies_in(SleepState.AWAKE, SleepState.NEVER_SLEEPS)
            self._is_idle = bool(self._contacts) and not len(moving)
        return is_valid

    def _update_sleepers(self) -> None:
        tracker = self._tracker
        asleep, awake = self._bodies_in(SleepState.ASLEEP), self._bodies_in(SleepState.AWAKE)
        undriven = awake[~tracker.is_driven[awake]]
        if not len(undriven) and not len(asleep):
            return
        reading = self._inner.read(tuple(undriven.tolist()))
        is_resting = tracker.update(undriven, reading, self._steps)
        if not is_resting.any() and not len(asleep):
            return
        resting, base = undriven[is_resting], reading.base[is_resting]
        active = np.setdiff1d(self._bodies_in(SleepState.AWAKE, SleepState.NEVER_SLEEPS), resting)
        moving = self._inner.read(tuple(active.tolist())).base
        radius = tracker.radius[active]
        positions, radii = tracker.base[asleep, :3], tracker.radius[asleep]
        is_near = find_reachable(moving, radius, positions, radii, self._ahead_s)
        self._wake(asleep[is_near].tolist())
        radii = tracker.radius[resting]
        is_near = find_reachable(moving, radius, base[:, :3], radii, self._ahead_s)
        self._put_to_sleep(resting[~is_near].tolist())

    def _put_to_sleep(self, bodies: list[int]) -> None:
        """Put those bodies to sleep that touch no body that stays awake."""
        contacts = {body: frozenset(self._inner.find_contacts(body)) for body in bodies}
        fixed = set(self._bodies_in(SleepState.FIXED).tolist())
        while True:
            still = contacts.keys() | self._contacts.keys() | fixed
            awake = [body for body, others in contacts.items() if not others <= still]
            if not awake:
                break
            for body in awake:
                del contacts[body]
        if contacts:
            bodies = list(contacts)
            states = self._inner.read(tuple(bodies))
            self._tracker.store_asleep(np.array(bodies, dtype=np.intp), states)
            self._inner.sleep(bodies)
            self._contacts |= contacts
            self._rows = None

    def _wake(self, bodies: Iterable[int]) -> None:
        """Wake the sleeping of some bodies, and all that they touched."""
        waiting, woken = [body for body in bodies if body in self._contacts], []
        while waiting:
            if (body := waiting.pop()) in self._contacts:
                waiting += sorted(self._contacts.pop(body))
                woken.append(body)
        if woken:
            self._tracker.state[woken] = SleepState.AWAKE
            self._tracker.mark_moved(np.array(woken, dtype=np.intp), self._steps)
            self._inner.wake(sorted(woken))
            self._waking.update(woken)
            self._rows, self._is_idle = None, False

    def _wake_near(self, bodies: Sequence[int], base: FloatArray) -> None:
        """Wake the sleeping bodies near some bodies at `base` (n, 13)."""
        if not self._contacts:
            return
        asleep, tracker = self._bodies_in(SleepState.ASLEEP), self._tracker
        positions, radii = tracker.base[asleep, :3], tracker.radius[asleep]
        radius = tracker.radius[list(bodies)]
        is_near = find_reachable(base, radius, positions, radii, self._ahead_s)
        self._wake(asleep[is_near].tolist())

    def _mark_placed(self, body: int, base: FloatArray) -> None:
        """Wake a body that is about to be moved, and its neighbours before and after."""
        self._is_idle = False
        self._wake([body])
        if self._contacts:
            self._wake_near([body], self._inner.read([body]).base)
            self._wake_near([body], base[None])
        self._tracker.mark_moved(body, self._steps)

    def _wake_for_load(self, body: int) -> bool:
        """Wake a body; return whether it was asleep at the last step: the next step skips it."""
        self._is_idle = False
        self._wake([body])
        self._tracker.mark_moved(body, self._steps)
        return body in self._waking

    def _split_rows(self, bodies: Sequence[int]) -> _ReadRows:
        """Split bodies by sleep; cached for the last tuple."""
        if self._rows is not None and self._rows[0] == bodies:
            return self._rows[1]
        numbers = np.array(bodies, dtype=np.intp)
        is_asleep = self._tracker.state[numbers] == SleepState.ASLEEP
        is_joint_asleep = np.repeat(is_asleep, self._tracker.joint_count[numbers])
        found = _ReadRows(
            tuple(numbers[~is_asleep].tolist()),
            numbers[is_asleep],
            np.flatnonzero(~is_asleep),
            np.flatnonzero(is_asleep),
            np.flatnonzero(~is_joint_asleep),
            np.flatnonzero(is_joint_asleep),
        )
        if isinstance(bodies, tuple):
            self._rows = bodies, found
        return found

    def _bodies_in(self, *states: SleepState) -> IntArray:
        return np.flatnonzero(self._tracker.in_states(*states))

    def _find_radius_m(self, model: Model) -> float:
        """Find the radius of a sphere about the root that holds a body at any joint position."""
        slides = [joint for joint in model.joints if joint.kind == "prismatic"]
        travel_m = sum(max(abs(joint.lower), abs(joint.upper)) for joint in slides)
        radius_m = self._reaches.measure(model).radius_m + travel_m + WAKE_DISTANCE_M
        return min(radius_m, MAX_REACH_M)
