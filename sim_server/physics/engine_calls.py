"""Calls that change an engine, as values: they are written, read, and made again."""

from collections.abc import Sequence
from contextlib import suppress
from typing import Annotated, TypeAlias

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.actuation import make_actuation
from zensim.sim_server.physics.engine import Engine, EngineRefused, FloatArray, Place

REFUSED = -1
"""Body of a model that the engine refused."""
MAX_STEPS = 1_000_000
"""Steps between two records; a log has one for each control step at least."""


def write_floats(values: FloatArray) -> bytes:
    """Write numbers with all their bits."""
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def read_floats(data: bytes) -> FloatArray:
    """Read numbers into an array of its own."""
    return np.array(np.frombuffer(data, dtype="<f8"))


class CallTarget:
    """An engine on which calls are made again.

    Attributes:
        engine: The engine.
        models: By the numbers in calls.
        model_of: Model of each body, by its number in calls.
        bodies: Numbers in the engine, by those in calls; bodies that it refused have none.
        refusals: Why it refused them.
        groups: Bodies of commands, by the numbers of groups in calls.
        targets: The last ones of each group.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.models: dict[int, Model] = {}
        self.model_of: dict[int, Model] = {}
        self.bodies: dict[int, int] = {}
        self.refusals: dict[int, str] = {}
        self.groups: dict[int, tuple[int, ...]] = {}
        self.targets: dict[int, FloatArray] = {}

    def add(self, model: int, base: FloatArray, body: int) -> None:
        """Add a body that has this number in calls."""
        if body != REFUSED:
            self.model_of[body] = self.models[model]
        try:
            own = self.engine.add(self.models[model], base)
        except EngineRefused as refused:
            if body != REFUSED:
                self.refusals[body] = str(refused)
            return
        if body == REFUSED:
            self.engine.remove(own)
        else:
            self.bodies[body] = own

    def remove(self, body: int) -> None:
        """Remove a body."""
        self.refusals.pop(body, None)
        self.model_of.pop(body, None)
        if (own := self.bodies.pop(body, None)) is not None:
            self.engine.remove(own)

    def command(self, group: int, targets: FloatArray) -> None:
        """Set the targets of a group, except those of bodies that the engine refused."""
        self.targets[group] = targets
        bodies = self.groups[group]
        if any(body not in self.bodies for body in bodies):
            widths = [make_actuation(self.model_of[body]).width for body in bodies]
            parts = np.split(targets, np.cumsum(widths[:-1]))
            known = [pair for pair in zip(bodies, parts, strict=True) if pair[0] in self.bodies]
            bodies = tuple(body for body, _ in known)
            targets = np.concatenate([np.zeros(0), *(part for _, part in known)])
        if bodies:
            self.engine.command(tuple(self.bodies[body] for body in bodies), targets)


class EngineCall(msgspec.Struct, frozen=True, array_like=True, tag=str.lower):
    """One call; its numbers of bodies and models are those of the engine that was logged."""

    def make_on(self, target: CallTarget) -> None:
        """Make it on an engine; a call for a body that the engine refused has no effect."""
        raise NotImplementedError


class BodyCall(EngineCall, frozen=True):
    """A call for one body."""

    body: int

    def make_on(self, target: CallTarget) -> None:
        """See `EngineCall`."""
        if (own := target.bodies.get(self.body)) is not None:
            self.make_for(target.engine, own)

    def make_for(self, engine: Engine, body: int) -> None:
        """Make it for a body of an engine."""
        raise NotImplementedError


class Steps(EngineCall, frozen=True):
    """Calls of `step`, one after another."""

    count: Annotated[int, msgspec.Meta(ge=0, le=MAX_STEPS)]

    def make_on(self, target: CallTarget) -> None:
        """See `EngineCall`."""
        for _ in range(self.count):
            target.engine.step()


class UsedModel(EngineCall, frozen=True):
    """The model that a number stands for in the calls that follow."""

    number: int
    model: Model

    def make_on(self, target: CallTarget) -> None:
        """See `EngineCall`."""
        target.models[self.number] = self.model


class Prepare(EngineCall, frozen=True):
    """Call of `prepare`."""

    model: int

    def make_on(self, target: CallTarget) -> None:
        """See `EngineCall`."""
        with suppress(EngineRefused):
            target.engine.prepare(target.models[self.model])


class SkipValidation(EngineCall, frozen=True):
    """Call of `skip_validation`."""

    model: int

    def make_on(self, target: CallTarget) -> None:
        """See `EngineCall`."""
        target.engine.skip_validation(target.models[self.model])


class Expect(EngineCall, frozen=True):
    """Call of `expect`."""

    models: tuple[int, ...]
    places: tuple[Place, ...]

    def make_on(self, target: CallTarget) -> None:
        """See `EngineCall`."""
        target.engine.expect([target.models[one] for one in self.models], self.places)


class Add(EngineCall, frozen=True):
    """Call of `add`."""

    model: int
    base: bytes
    body: int
    """Number of the body, or `REFUSED`."""

    def make_on(self, target: CallTarget) -> None:
        """See `EngineCall`."""
        target.add(self.model, read_floats(self.base), self.body)


class Remove(EngineCall, frozen=True):
    """Call of `remove`."""

    body: int

    def make_on(self, target: CallTarget) -> None:
        """See `EngineCall`."""
        target.remove(self.body)


class ForgetRemoved(EngineCall, frozen=True):
    """Call of `forget_removed`."""

    def make_on(self, target: CallTarget) -> None:
        """See `EngineCall`."""
        target.engine.forget_removed()


class FindOverlaps(BodyCall, frozen=True):
    """Call of `find_overlaps`, which may move what an engine caches."""

    def make_for(self, engine: Engine, body: int) -> None:
        """See `BodyCall`."""
        with suppress(EngineRefused):
            engine.find_overlaps(body)


class SetBaseState(BodyCall, frozen=True):
    """Call of `set_base_state`."""

    base: bytes

    def make_for(self, engine: Engine, body: int) -> None:
        """See `BodyCall`."""
        engine.set_base_state(body, read_floats(self.base))


class SetAtRest(BodyCall, frozen=True):
    """Call of `set_at_rest`."""

    base: bytes
    positions: bytes | None

    def make_for(self, engine: Engine, body: int) -> None:
        """See `BodyCall`."""
        positions = None if self.positions is None else read_floats(self.positions)
        engine.set_at_rest(body, read_floats(self.base), positions)


class SetState(BodyCall, frozen=True):
    """Call of `set_state`."""

    base: bytes
    positions: bytes
    velocities: bytes

    def make_for(self, engine: Engine, body: int) -> None:
        """See `BodyCall`."""
        joints = read_floats(self.positions), read_floats(self.velocities)
        engine.set_state(body, read_floats(self.base), *joints)


class CommandGroup(EngineCall, frozen=True):
    """The bodies that a number stands for in the commands that follow."""

    number: int
    bodies: tuple[int, ...]

    def make_on(self, target: CallTarget) -> None:
        """See `EngineCall`."""
        target.groups[self.number] = self.bodies


class Command(EngineCall, frozen=True):
    """Call of `command` for a group of bodies; a pool has one for all of its robots."""

    group: int
    targets: bytes
    """Empty = those of the last command of this group."""

    def make_on(self, target: CallTarget) -> None:
        """See `EngineCall`."""
        is_same = not self.targets and self.group in target.targets
        targets = target.targets[self.group] if is_same else read_floats(self.targets)
        target.command(self.group, targets)


class ApplyLinkWrench(BodyCall, frozen=True):
    """Call of `apply_link_wrench`, for the next step."""

    link: int
    wrench: bytes

    def make_for(self, engine: Engine, body: int) -> None:
        """See `BodyCall`."""
        engine.apply_link_wrench(body, self.link, read_floats(self.wrench))


class ApplyJointEffort(BodyCall, frozen=True):
    """Call of `apply_joint_effort`, for the next step."""

    joint: int
    effort: float

    def make_for(self, engine: Engine, body: int) -> None:
        """See `BodyCall`."""
        engine.apply_joint_effort(body, self.joint, self.effort)


class Hide(BodyCall, frozen=True):
    """Call of `hide`."""

    def make_for(self, engine: Engine, body: int) -> None:
        """See `BodyCall`."""
        engine.hide(body)


class Show(EngineCall, frozen=True):
    """Call of `show`."""

    bodies: tuple[int, ...]

    def make_on(self, target: CallTarget) -> None:
        """See `EngineCall`."""
        target.engine.show([target.bodies[one] for one in self.bodies if one in target.bodies])


AnyCall: TypeAlias = (
    Steps
    | UsedModel
    | Prepare
    | SkipValidation
    | Expect
    | Add
    | Remove
    | ForgetRemoved
    | FindOverlaps
    | SetBaseState
    | SetAtRest
    | SetState
    | CommandGroup
    | Command
    | ApplyLinkWrench
    | ApplyJointEffort
    | Hide
    | Show
)


def to_places(places: Sequence[Place]) -> tuple[Place, ...]:
    """Write places with numbers that can be encoded."""
    return tuple((float(x), float(y)) for x, y in places)
