"""The Engine over many engines: bodies that cannot touch for a while are in cells of their own.

Cost a body grows with the bodies of one engine; so each cell has few. What may touch before the
next look is in one cell, what never moves is in every cell, and a body moves to another cell by
being read here, parked, and put there.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.clusters.cells import Asked, Cells, Told
from zensim.sim_server.physics.clusters.dealing import Room, deal
from zensim.sim_server.physics.clusters.homes import Homes
from zensim.sim_server.physics.clusters.members import EVERYWHERE
from zensim.sim_server.physics.clusters.parting import MARGIN_M, SPARE_MPS, Parting, part
from zensim.sim_server.physics.clusters.reach import Measure
from zensim.sim_server.physics.clusters.routes import Lineup, Route, joined, lineup_of, route_of
from zensim.sim_server.physics.engine import BodyStates, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig

PERIODS = (4, 2, 1)
"""How many periods to the next look: the first for which no group is too large for a cell."""
ALARM_S = 1.0
"""How long every step is looked at, once somebody was faster than thought."""
KNOWN_ROUTES = 256
LEAST = 1e-3
"""Of a mass [kg] or a radius [m] that something is divided by."""


class Push(NamedTuple):
    """A wrench on a link, or an effort on a joint, in the next step."""

    body: int
    where: int
    what: FloatArray | float


@dataclass(frozen=True)
class Settings:
    """How a world is cut into cells.

    Attributes:
        alone: So many moving bodies at most stay in one cell.
        most: Bodies of a cell, once there are several.
        period_steps: The least time between two looks, while nobody is too fast.
        largest: Bodies of a cell of a large world.
        at_once: Bodies that leave a cell that is too full in one look.
    """

    alone: int = 150
    most: int = 64
    period_steps: int = 1
    at_once: int = 8
    largest: int = 0


class Clusters:
    """Engines as one."""

    def __init__(self, config: EngineConfig, cells: Cells, settings: Settings) -> None:
        self._cells = cells
        self._settings = settings
        self._room = Room(settings.most, settings.at_once, settings.largest)
        self._dt_s = config.step_ns * 1e-9
        self._ahead_s = settings.period_steps * PERIODS[0] * self._dt_s
        self._gained_mps = SPARE_MPS + float(np.linalg.norm(config.gravity)) * self._ahead_s
        self._measure = Measure(config.mesh_folder)
        self._homes = Homes(cells, settings.alone, self._room)
        self._members = self._homes.members
        self._pushes: list[Push] = []
        self._lineup: tuple[int, Lineup] | None = None
        self._routes: dict[int, tuple[Sequence[int], int, Route]] = {}
        self._now: BodyStates | None = None
        self._steps = self._looked_at = self._next_look = self._alarm_until = 0
        self._is_due = self._was_due = self._is_bad = self._is_news = False

    @property
    def name(self) -> str:
        """See `Engine.name`."""
        return self._homes.engines[0].name

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`: a part for one of the cells, or a mesh is measured."""
        return self._homes.prepare(model) and self._measure.prepare(model)

    def add(self, model: Model, base: FloatArray) -> int:
        """See `Engine.add`."""
        number = self._homes.add(model, self._measure.reach(model), base)
        self._was_due = self._is_due
        self._note_place(number, base)
        return number

    def skip_validation(self, model: Model) -> None:
        """See `Patient.trust`; here cells trust each other."""

    def hide(self, body: int) -> None:
        """See `Concealing.conceal`; who takes no part is looked at by nobody."""
        self._homes.hide(body)
        if body in self._members.concealed:
            self._is_due = self._was_due

    def show(self, bodies: Sequence[int]) -> None:
        """See `Concealing.reveal`."""
        self._homes.show(bodies)
        self._now, self._is_due = None, True

    def remove(self, body: int) -> None:
        """See `Engine.remove`."""
        self._pushes = [push for push in self._pushes if push.body != body]
        self._homes.remove(body)
        self._now = None

    def forget_removed(self) -> None:
        """See `Engine.forget_removed`."""
        self._homes.forget_removed()
        self._steps = self._looked_at = self._next_look = self._alarm_until = 0
        self._is_due = True

    def find_overlaps(self, body: int) -> Sequence[int]:
        """See `Engine.overlapping`."""
        return self.find_overlaps_async(body)()

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        """See `Patient.overlapping_soon`."""
        if not self._homes.is_one and self._may_touch_others(body):
            self._look()
        return self._homes.find_overlaps_async(body)

    def is_idle(self) -> bool:
        """See `Patient.is_settled`."""
        return self._homes.is_idle()

    def read(self, bodies: Sequence[int]) -> BodyStates:
        """See `Engine.read`."""
        if not self._members.concealed.isdisjoint(bodies):
            return self._homes.read_apart(bodies)
        if self._homes.is_one:
            return self._homes.engines[0].read(self._route(bodies).alone)
        return self._route(bodies).cut(self._reading())

    def place(self, body: int, base: FloatArray) -> None:
        """See `Engine.place`."""
        for engine, inner in self._homes.of(body):
            engine.place(inner, base)
        self._note_place(body, base)

    def rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.rest`."""
        for engine, inner in self._homes.of(body):
            engine.rest(inner, base, positions)
        self._members.forget_targets(body)
        self._note_place(body, base)

    def put(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.put`."""
        for engine, inner in self._homes.of(body):
            engine.put(inner, base, positions, velocities)
        self._note_place(body, base)

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`: cells are told before the next step, all at once."""
        members, route = self._members, self._route(bodies)
        if not len(route.driven):
            return
        members.targets[route.targets] = targets
        members.told[route.driven] = True
        if self._homes.is_one:
            self._homes.engines[0].command(route.alone, targets)
            return
        members.is_due[route.driven] = self._is_news = True
        speeds = np.abs(targets) * members.levers[route.targets]
        asked = np.maximum.reduceat(speeds, route.starts)
        self._is_due |= bool((asked > members.bound[route.driven]).any())

    def push_link(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.push_link`: cells are told before the next step."""
        self._note_kick(body, float(np.abs(wrench[:3]).sum()), float(np.abs(wrench[3:]).sum()))
        self._pushes.append(Push(body, link, wrench.copy()))

    def push_joint(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.push_joint`: likewise."""
        self._note_kick(body, abs(effort), abs(effort))
        self._pushes.append(Push(body, joint, effort))

    def step(self) -> bool:
        """See `Engine.step`."""
        if not self._homes.is_one and (self._is_due or self._steps >= self._next_look):
            self._look()
        if self._is_news:
            self._tell()
        if self._pushes:
            self._push()
        is_well = self._advance()
        self._steps += 1
        self._now = None
        return is_well

    def close(self) -> None:
        """See `Engine.close`."""
        self._homes.close()

    def _advance(self) -> bool:
        engines = self._homes.engines
        if self._homes.is_one:
            return engines[0].step()
        is_well = self._cells.step([engines[cell] for cell in self._lined_up().cells], 1)
        is_well, self._is_bad = is_well and not self._is_bad, False
        return is_well

    def _may_touch_others(self, body: int) -> bool:
        """Whether a body may touch one that is in another cell."""
        members, moving = self._members, self._members.moving
        if members.cell[body] == EVERYWHERE:
            return False
        others = moving[members.cell[moving] != members.cell[body]]
        elapsed_s = (self._steps - self._looked_at) * self._dt_s
        radii = members.radius + members.bound * elapsed_s + MARGIN_M
        apart = np.linalg.norm(members.place[others] - members.place[body], axis=1)
        return bool((apart <= radii[others] + radii[body]).any())

    def _note_place(self, body: int, base: FloatArray) -> None:
        if self._members.cell[body] == EVERYWHERE:
            self._homes.note_still(body)
        self._members.place[body] = base[:2]
        self._now, self._is_due = None, True

    def _note_kick(self, body: int, force: float, torque: float) -> None:
        """Bound the speed that a push gives a body; a torque pushes at its rim."""
        members = self._members
        rim, mass = members.radius[body], members.by_number[body].model.mass_kg
        gained = (force + torque / max(rim, LEAST)) / max(mass, LEAST) * self._dt_s
        members.kick[body] += gained
        self._is_due |= bool(members.kick[body] > SPARE_MPS / 4.0)

    def _lined_up(self) -> Lineup:
        if self._lineup is None or self._lineup[0] != self._members.version:
            self._lineup = (self._members.version, lineup_of(self._members))
        return self._lineup[1]

    def _route(self, bodies: Sequence[int]) -> Route:
        version = self._members.version
        known = self._routes.get(id(bodies))
        if known is not None and known[0] is bodies and known[1] == version:
            return known[2]
        route = route_of(bodies, self._members, self._lined_up())
        if isinstance(bodies, tuple):  # else its content may change
            if len(self._routes) >= KNOWN_ROUTES:
                self._routes.clear()
            self._routes[id(bodies)] = (bodies, version, route)
        return route

    def _reading(self) -> BodyStates:
        """Read all that moves, once a step at most."""
        if self._now is None:
            lineup, engines = self._lined_up(), self._homes.engines
            homes = zip(lineup.cells, lineup.bodies, strict=True)
            self._now = joined(self._cells.read([Asked(engines[cell], b) for cell, b in homes]))
        return self._now

    def _look(self) -> None:
        """Put bodies that may touch before the next look into one cell."""
        lineup, now, members = self._lined_up(), self._reading(), self._members
        numbers, places = lineup.numbers, now.base[:, :2]
        self._heed_the_fast(places - members.place[numbers], members.bound[numbers])
        parting = self._part(lineup, now)
        members.place[numbers], members.bound[numbers] = places, parting.speeds
        members.kick[numbers] = 0.0
        is_good = np.asarray(np.isfinite(now.base).all(axis=1))
        self._is_bad |= not is_good.all()
        before = members.cell[numbers]
        after = deal(before, parting.groups, np.where(is_good[:, None], places, 0.0), self._room)
        if self._homes.move(lineup, now, np.where(is_good, after, before)):
            self._now, self._is_news = None, True
        self._looked_at, self._is_due = self._steps, False
        period = self._settings.period_steps
        self._next_look = (self._steps // period + parting.periods) * period
        if self._steps < self._alarm_until:
            self._next_look = self._steps + 1

    def _heed_the_fast(self, moved: FloatArray, bounds: FloatArray) -> None:
        """Look at every step for a while when somebody went farther than was thought."""
        elapsed_s = (self._steps - self._looked_at) * self._dt_s
        with np.errstate(invalid="ignore", over="ignore"):
            beyond = np.linalg.norm(moved, axis=1) - bounds * elapsed_s
        if (beyond > MARGIN_M / 2.0).any():
            self._alarm_until = self._steps + round(ALARM_S / self._dt_s)

    def _part(self, lineup: Lineup, now: BodyStates) -> Parting:
        members, numbers = self._members, lineup.numbers
        radii = members.radius[numbers] = self._radii(lineup, now)
        velocity = now.base[:, 7:]
        with np.errstate(invalid="ignore", over="ignore"):
            linear = np.linalg.norm(velocity[:, :3], axis=1)
            own = linear + np.linalg.norm(velocity[:, 3:], axis=1) * members.arm[numbers]
        asked = np.zeros(len(numbers))
        if len(lineup.driven):
            told = np.abs(members.targets[lineup.targets]) * members.levers[lineup.targets]
            asked[lineup.driven] = np.maximum.reduceat(told, lineup.target_starts)
        speeds = np.maximum(own, asked) + members.kick[numbers] + self._gained_mps
        period_s = self._settings.period_steps * self._dt_s
        choices = PERIODS[-1:] if self._steps < self._alarm_until else PERIODS
        for periods in choices:
            found = part(now.base[:, :2], radii, speeds, period_s, periods=periods)
            if found.largest <= self._room.of(len(numbers)):
                break
        return found

    def _radii(self, lineup: Lineup, now: BodyStates) -> FloatArray:
        """Find how far each body reaches, with what slides where it is and will be."""
        radii = self._members.rigid_m[lineup.numbers]
        rows, joints = lineup.slides
        ahead = np.abs(now.joint_velocities[joints]) * self._ahead_s
        np.add.at(radii, rows, np.abs(now.joint_positions[joints]) + ahead)
        return radii

    def _tell(self) -> None:
        """Tell cells the targets of their bodies."""
        self._cells.command(list(self._told()))
        self._members.is_due[:] = self._is_news = False

    def _push(self) -> None:
        """Push what is to be pushed in this step."""
        for body, where, push in self._pushes:
            for engine, inner in self._homes.of(body):
                if isinstance(push, float):
                    engine.push_joint(inner, where, push)
                else:
                    engine.push_link(inner, where, push)
        self._pushes.clear()

    def _told(self) -> Iterator[Told]:
        lineup, members, engines = self._lined_up(), self._members, self._homes.engines
        is_due = members.is_due[lineup.numbers]
        if is_due[lineup.driven].all():
            ends = lineup.cell_targets.tolist()
            for cell, bodies, at, end in zip(
                lineup.cells, lineup.bodies, ends, ends[1:], strict=False
            ):
                if at < end:
                    yield Told(engines[cell], bodies, members.targets[lineup.targets[at:end]])
            return
        due = np.flatnonzero(is_due)
        cells = members.cell[lineup.numbers[due]]
        for cell in np.unique(cells).tolist():
            numbers = lineup.numbers[due[cells == cell]]
            targets = [members.targets[members.by_number[n].targets] for n in numbers.tolist()]
            bodies = tuple(members.inner[numbers].tolist())
            yield Told(engines[cell], bodies, np.concatenate(targets))
