"""LoggedEngine: notes every call that changes an engine, in order."""

from collections.abc import Callable, Sequence

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.engine import Engine, FloatArray, Place
from zensim.sim_server.physics.engine_calls import (
    REFUSED,
    Add,
    AnyCall,
    ApplyJointEffort,
    ApplyLinkWrench,
    Command,
    CommandGroup,
    Expect,
    FindOverlaps,
    ForgetRemoved,
    Hide,
    Prepare,
    Remove,
    SetAtRest,
    SetBaseState,
    SetState,
    Show,
    SkipValidation,
    Steps,
    UsedModel,
    to_places,
    write_floats,
)
from zensim.sim_server.physics.engine_layer import EngineLayer

# ruff: noqa: D102 - see `Engine`

MAX_KNOWN = 4096
"""Models, and groups of commanded bodies, that are noted once; more are noted again."""


class LoggedEngine(EngineLayer):
    """The outermost layer of an engine while its inputs are logged.

    Steps are counted, and a command is one record, whatever the number of its robots.

    Attributes:
        inner: The engine that is logged.
        steps: Made since the log began.
    """

    def __init__(self, inner: Engine) -> None:
        super().__init__(inner)
        self.inner = inner
        self.steps = 0
        self._calls: list[AnyCall] = []
        self._noted_steps = 0
        self._models: dict[int, tuple[int, Model]] = {}
        """Number and model by identity; the model is kept so that its identity stays its own."""
        self._groups: dict[tuple[int, ...], int] = {}
        self._targets: dict[int, bytes] = {}
        self._numbers = 0
        self._prepared = REFUSED
        """Number of the model that was prepared last."""

    def take_calls(self) -> list[AnyCall]:
        """Take the calls since the last time, oldest first."""
        self._note_steps()
        calls, self._calls = self._calls, []
        return calls

    def note_again(self) -> None:
        """Note models and groups again when they are next used: a new reader knows none."""
        self._models.clear()
        self._groups.clear()
        self._targets.clear()

    def number_of(self, model: Model) -> int:
        """Find the number of a model, which is noted before its first use."""
        if (known := self._models.get(id(model))) is not None:
            return known[0]
        if len(self._models) >= MAX_KNOWN:
            self._models.clear()
        number = self._next_number()
        self._models[id(model)] = number, model
        self._note(UsedModel(number, model))
        return number

    def prepare(self, model: Model) -> bool:
        number = self.number_of(model)
        if number != self._prepared:  # it is called until nothing is left to make
            self._prepared = number
            self._note(Prepare(number))
        return self._inner.prepare(model)

    def skip_validation(self, model: Model) -> None:
        self._note(SkipValidation(self.number_of(model)))
        self._inner.skip_validation(model)

    def expect(self, models: Sequence[Model], places: Sequence[Place] = ()) -> None:
        self._note(Expect(tuple(map(self.number_of, models)), to_places(places)))
        self._inner.expect(models, places)

    def add(self, model: Model, base: FloatArray) -> int:
        number, body, start = self.number_of(model), REFUSED, write_floats(base)
        try:
            body = self._inner.add(model, base)
        finally:
            self._note(Add(number, start, body))
        return body

    def remove(self, body: int) -> None:
        self._note(Remove(body))
        self._inner.remove(body)

    def forget_removed(self) -> None:
        self._note(ForgetRemoved())
        self._inner.forget_removed()

    def find_overlaps(self, body: int) -> Sequence[int]:
        self._note(FindOverlaps(body))
        return self._inner.find_overlaps(body)

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        self._note(FindOverlaps(body))
        return self._inner.find_overlaps_async(body)

    def set_base_state(self, body: int, base: FloatArray) -> None:
        self._note(SetBaseState(body, write_floats(base)))
        self._inner.set_base_state(body, base)

    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        joints = None if positions is None else write_floats(positions)
        self._note(SetAtRest(body, write_floats(base), joints))
        self._inner.set_at_rest(body, base, positions)

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        joints = write_floats(positions), write_floats(velocities)
        self._note(SetState(body, write_floats(base), *joints))
        self._inner.set_state(body, base, positions, velocities)

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        group = self._group_of(tuple(bodies))
        numbers = write_floats(targets)
        is_same = self._targets.get(group) == numbers
        self._targets[group] = numbers
        self._note(Command(group, b"" if is_same else numbers))
        self._inner.command(bodies, targets)

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        self._note(ApplyLinkWrench(body, link, write_floats(wrench)))
        self._inner.apply_link_wrench(body, link, wrench)

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        self._note(ApplyJointEffort(body, joint, float(effort)))
        self._inner.apply_joint_effort(body, joint, effort)

    def step(self) -> bool:
        self._noted_steps += 1
        self.steps += 1
        return self._inner.step()

    def hide(self, body: int) -> None:
        self._note(Hide(body))
        self._inner.hide(body)

    def show(self, bodies: Sequence[int]) -> None:
        self._note(Show(tuple(bodies)))
        self._inner.show(bodies)

    def _note(self, call: AnyCall) -> None:
        if self._noted_steps:
            self._note_steps()
        self._calls.append(call)

    def _note_steps(self) -> None:
        if self._noted_steps:
            self._calls.append(Steps(self._noted_steps))
            self._noted_steps = 0

    def _group_of(self, bodies: tuple[int, ...]) -> int:
        if (group := self._groups.get(bodies)) is not None:
            return group
        if len(self._groups) >= MAX_KNOWN:
            self._groups.clear()
            self._targets.clear()
        group = self._groups[bodies] = self._next_number()
        self._note(CommandGroup(group, bodies))
        return group

    def _next_number(self) -> int:
        self._numbers += 1
        return self._numbers
