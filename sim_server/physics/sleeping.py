"""The Engine in which bodies that hardly move sleep: they are neither stepped nor read.

Each tenth of a second it looks: who has hardly moved for a second, is told nothing, and has nobody
near that moves, sleeps, together with all that it touches. Who is told something, pushed, put
somewhere, or may be touched before the next look, wakes, together with all that it touched.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol, cast

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.actuation import Actuation, actuation_of
from zensim.sim_server.physics.calm import CALM_S, GAP_M, Calm, IntArray, State, reached
from zensim.sim_server.physics.clusters.reach import FARTHEST_M, Measure
from zensim.sim_server.physics.engine import (
    Concealing,
    Dozing,
    Engine,
    EngineConfig,
    FloatArray,
    Reading,
)
from zensim.sim_server.physics.orders import Orders

LOOK_S = 0.1
AHEAD = 2.0
"""How far ahead a look sees, in looks."""


class Inner(Engine, Concealing, Dozing, Protocol):
    """An engine whose bodies can sleep."""


def with_sleep(engine: Engine, config: EngineConfig) -> Engine:
    """Let bodies sleep in an engine, if they can."""
    return Sleeping(cast("Inner", engine), config) if isinstance(engine, Dozing) else engine


class Push(NamedTuple):
    """A wrench on a link, or an effort on a joint, in the next step."""

    body: int
    where: int
    what: FloatArray | float


class _Rows(NamedTuple):
    """Where the bodies of a reading come from, awake and asleep."""

    awake: tuple[int, ...]
    asleep: IntArray
    awake_rows: IntArray
    asleep_rows: IntArray
    awake_joints: IntArray
    asleep_joints: IntArray


class Sleeping:
    """An engine, and who sleeps in it."""

    def __init__(self, engine: Inner, config: EngineConfig) -> None:
        dt_s = config.step_ns * 1e-9
        self._engine = engine
        self._measure = Measure(config.mesh_folder)
        self._every = max(1, round(LOOK_S / dt_s))
        self._ahead_s = AHEAD * self._every * dt_s
        self._steps = 0
        self._calm = Calm(max(1, round(CALM_S / dt_s)))
        self._plans: dict[int, Actuation] = {}
        self._orders = Orders(lambda body: self._plans[body].width)
        self._touched: dict[int, frozenset[int]] = {}
        self._concealed: dict[int, State] = {}
        self._rising: set[int] = set()
        self._late: list[Push] = []
        self._rows: tuple[Sequence[int], _Rows] | None = None

    @property
    def name(self) -> str:
        """See `Engine.name`."""
        return self._engine.name

    @property
    def asleep(self) -> tuple[int, ...]:
        """The bodies that sleep."""
        return tuple(self._numbers(State.ASLEEP).tolist())

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`."""
        return self._engine.prepare(model)

    def add(self, model: Model, base: FloatArray) -> int:
        """See `Engine.add`."""
        body = self._engine.add(model, base)
        self._plans[body] = actuation_of(model)
        self._orders.forget(body)
        self._calm.take(body, model, self._radius_m(model), self._steps)
        if self._calm.state[body] == State.FIXED:
            # Else each sleeper that stands on it would be looked for contacts in each step.
            self._engine.doze([body])
        self._rows = None
        self._wake_near(body, base)
        return body

    def remove(self, body: int) -> None:
        """See `Engine.remove`; who may have stood on it wakes."""
        self._wake([body])
        if self._touched:
            self._wake_near(body, self._engine.read([body]).base[0])
        self._engine.remove(body)
        self._calm.drop(body)
        self._concealed.pop(body, None)
        self._late = [push for push in self._late if push.body != body]
        self._rising.discard(body)
        self._rows = None

    def conceal(self, body: int) -> None:
        """See `Concealing.conceal`."""
        self._engine.conceal(body)
        self._concealed[body] = State(self._calm.state[body])
        self._calm.drop(body)

    def reveal(self, bodies: Sequence[int]) -> None:
        """See `Concealing.reveal`."""
        self._engine.reveal(bodies)
        for body in bodies:
            self._calm.state[body] = self._concealed.pop(body)
            self._calm.stir(body, self._steps)
        if self._touched:
            for body, base in zip(bodies, self._engine.read(bodies).base, strict=True):
                self._wake_near(body, base)

    def forget_removed(self) -> None:
        """See `Engine.forget_removed`."""
        self._engine.forget_removed()
        self._wake(self.asleep)
        self._steps = 0
        self._calm.stir(np.flatnonzero(self._calm.state), 0)

    def overlapping(self, body: int) -> Sequence[int]:
        """See `Engine.overlapping`."""
        return self._engine.overlapping(body)

    def read(self, bodies: Sequence[int]) -> Reading:
        """See `Engine.read`; sleepers stand where they fell asleep."""
        if not self._touched:
            return self._engine.read(bodies)
        rows = self._rows_of(bodies)
        if not len(rows.asleep):
            return self._engine.read(bodies)
        reading = self._engine.read(rows.awake)
        joints = len(rows.awake_joints) + len(rows.asleep_joints)
        base, positions, velocities = (
            np.empty((len(bodies), 13)),
            np.empty(joints),
            np.zeros(joints),
        )
        base[rows.awake_rows] = reading.base
        base[rows.asleep_rows] = self._calm.base[rows.asleep]
        positions[rows.awake_joints] = reading.joint_positions
        positions[rows.asleep_joints] = self._calm.joints_of(rows.asleep)
        velocities[rows.awake_joints] = reading.joint_velocities
        return Reading(base, positions, velocities)

    def place(self, body: int, base: FloatArray) -> None:
        """See `Engine.place`."""
        self._move(body, base)
        self._engine.place(body, base)

    def put(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.put`."""
        self._move(body, base)
        self._engine.put(body, base, positions, velocities)

    def rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.rest`."""
        self._move(body, base)
        self._orders.forget(body)
        self._calm.is_driven[body] = False
        self._engine.rest(body, base, positions)

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`; who is told something new wakes."""
        news = list(self._orders.news(bodies, targets))
        if not news:
            return
        self._engine.command(bodies, targets)
        for body, numbers in news:
            plan = self._plans[body]
            twist = numbers[plan.twist : plan.twist + 3] if plan.twist is not None else []
            self._calm.is_driven[body] = any(plan.speeds.of(numbers)) or any(twist)
            self._calm.stir(body, self._steps)
        self._wake([body for body, _ in news])

    def push_link(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.push_link`; a sleeper is pushed a step later, when it is awake."""
        if self._is_late(body):
            self._late.append(Push(body, link, wrench.copy()))
        else:
            self._engine.push_link(body, link, wrench)

    def push_joint(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.push_joint`; a sleeper is pushed a step later, when it is awake."""
        if self._is_late(body):
            self._late.append(Push(body, joint, effort))
        else:
            self._engine.push_joint(body, joint, effort)

    def step(self) -> bool:
        """See `Engine.step`."""
        is_well = self._engine.step()
        self._steps += 1
        self._rising.clear()
        late, self._late = self._late, []
        for push in late:
            if isinstance(push.what, float):
                self._engine.push_joint(push.body, push.where, push.what)
            else:
                self._engine.push_link(push.body, push.where, push.what)
        if self._steps % self._every == 0 and is_well:
            self._look()
        return is_well

    def close(self) -> None:
        """See `Engine.close`."""
        self._engine.close()

    def _look(self) -> None:
        calm = self._calm
        asleep, awake = self._numbers(State.ASLEEP), self._numbers(State.AWAKE)
        quiet = awake[~calm.is_driven[awake]]
        if not len(quiet) and not len(asleep):
            return
        reading = self._engine.read(tuple(quiet.tolist()))
        is_ripe = calm.compare(quiet, reading, self._steps)
        if not is_ripe.any() and not len(asleep):
            return
        ripe, base = quiet[is_ripe], reading.base[is_ripe]
        restless = np.setdiff1d(self._numbers(State.AWAKE, State.RESTLESS), ripe)
        moving = self._engine.read(tuple(restless.tolist())).base
        radius = calm.radius[restless]
        spots, radii = calm.base[asleep, :3], calm.radius[asleep]
        self._wake(asleep[reached(moving, radius, spots, radii, self._ahead_s)].tolist())
        is_near = reached(moving, radius, base[:, :3], calm.radius[ripe], self._ahead_s)
        self._lay_down(ripe[~is_near].tolist())

    def _lay_down(self, bodies: list[int]) -> None:
        """Let those sleep that touch none who stays awake."""
        touched = {body: frozenset(self._engine.touching(body)) for body in bodies}
        fixed = set(self._numbers(State.FIXED).tolist())
        while True:
            still = touched.keys() | self._touched.keys() | fixed
            awake = [body for body, others in touched.items() if not others <= still]
            if not awake:
                break
            for body in awake:
                del touched[body]
        if touched:
            numbers = np.array(list(touched), dtype=np.intp)
            self._calm.lay_down(numbers, self._engine.read(tuple(touched)))
            self._engine.doze(tuple(touched))
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
            self._calm.state[woken] = State.AWAKE
            self._calm.stir(np.array(woken, dtype=np.intp), self._steps)
            self._engine.rouse(sorted(woken))
            self._rising.update(woken)
            self._rows = None

    def _wake_near(self, body: int, base: FloatArray) -> None:
        if not self._touched:
            return
        asleep, calm = self._numbers(State.ASLEEP), self._calm
        spots, radii = calm.base[asleep, :3], calm.radius[asleep]
        near = reached(base[None], calm.radius[[body]], spots, radii, self._ahead_s)
        self._wake(asleep[near].tolist())

    def _move(self, body: int, base: FloatArray) -> None:
        """Note that a body is taken from where it is, and put somewhere."""
        self._wake([body])
        if self._touched:
            self._wake_near(body, self._engine.read([body]).base[0])
            self._wake_near(body, base)
        self._calm.stir(body, self._steps)

    def _is_late(self, body: int) -> bool:
        """Wake a body, and say whether it was woken since the last step: the next passes it by."""
        self._wake([body])
        self._calm.stir(body, self._steps)
        return body in self._rising

    def _rows_of(self, bodies: Sequence[int]) -> _Rows:
        """Part the bodies of a reading: those of the same tuple are at hand."""
        if self._rows is not None and self._rows[0] == bodies:
            return self._rows[1]
        numbers = np.array(bodies, dtype=np.intp)
        is_asleep = self._calm.state[numbers] == State.ASLEEP
        has_sleeper = np.repeat(is_asleep, self._calm.joint_count[numbers])
        found = _Rows(
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

    def _numbers(self, *states: State) -> IntArray:
        return np.flatnonzero(self._calm.having(*states))

    def _radius_m(self, model: Model) -> float:
        """Find the radius of a ball about the root that holds a body, however far it slides."""
        slides = [joint for joint in model.joints if joint.kind == "prismatic"]
        ways = (max(abs(joint.lower), abs(joint.upper)) for joint in slides)
        return min(self._measure.reach(model).radius_m + sum(ways) + GAP_M, FARTHEST_M)
