"""Injected faults: models whose parts fail for a time, and faults of topics of sensors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec

from zensim.proto.messages.fault_messages import BodyFaultKind, TopicFault
from zensim.proto.messages.model_messages import Joint, Link, Model, Shape
from zensim.proto.messages.result_messages import ResultCode
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.world.applied_forces import TimeSpan

MAX_INJECTED_FAULTS = 1024
"""Most faults that act at a time."""


@dataclass(frozen=True)
class BodyFault:
    """A part of a body that fails.

    Attributes:
        part: Index among `Model.links` of `wheel_slip` and `link_broken`, else `Model.joints`.
        value: Factor of friction or torque.
        position: Of the joint at the start [rad or m].
    """

    entity: str
    kind: BodyFaultKind
    part: int
    value: float
    position: float
    span: TimeSpan

    def apply(self, model: Model) -> Model:
        """Change a model so that the part fails."""
        if self.kind == "wheel_slip":
            return _replace_link(model, self.part, self._make_slippery)
        if self.kind == "link_broken":
            return _replace_link(model, self.part, _break_off)
        return _replace_joint(model, self.part, self._fail)

    def _make_slippery(self, link: Link) -> Link:
        shapes = tuple(_scale_friction(shape, self.value) for shape in link.collisions)
        return msgspec.structs.replace(link, collisions=shapes)

    def _fail(self, joint: Joint) -> Joint:
        if self.kind == "motor_weak":
            factor = joint.motor_factor * self.value
            return msgspec.structs.replace(joint, motor_factor=factor)
        # Equal limits hold a driven joint in both engines; neither friction nor damping does.
        kind = "revolute" if joint.kind == "continuous" else joint.kind
        return msgspec.structs.replace(joint, kind=kind, lower=self.position, upper=self.position)


@dataclass(frozen=True)
class TimedTopicFault:
    """A fault of topics of an entity."""

    entity: str
    fault: TopicFault
    span: TimeSpan


def _scale_friction(shape: Shape, factor: float) -> Shape:
    contact = msgspec.structs.replace(
        shape.contact, friction_across=shape.contact.friction_across * factor
    )
    return msgspec.structs.replace(shape, friction=shape.friction * factor, contact=contact)


def _break_off(link: Link) -> Link:
    return msgspec.structs.replace(link, collisions=(), visuals=())


def _replace_link(model: Model, number: int, change: Callable[[Link], Link]) -> Model:
    links = list(model.links)
    links[number] = change(links[number])
    return msgspec.structs.replace(model, links=tuple(links))


def _replace_joint(model: Model, number: int, change: Callable[[Joint], Joint]) -> Model:
    joints = list(model.joints)
    joints[number] = change(joints[number])
    return msgspec.structs.replace(model, joints=tuple(joints))


ReplaceModel = Callable[[str, Model], None]


class InjectedFaults:
    """All faults that act, and the models without them."""

    def __init__(self) -> None:
        self._bodies: list[BodyFault] = []
        self._whole: dict[str, Model] = {}
        """Model of each entity without its faults, by name."""
        self._topics: list[TimedTopicFault] = []
        self.topic_faults: tuple[TopicFault, ...] = ()
        """Faults that act now."""

    def __len__(self) -> int:
        return len(self._bodies) + len(self._topics)

    @property
    def is_in_models(self) -> bool:
        """Whether all faults are in the models of entities for ever: none of topics, none ends."""
        return not self._topics and all(one.span.end_ns is None for one in self._bodies)

    def add_body_fault(self, fault: BodyFault, model: Model, replace: ReplaceModel) -> None:
        """Let a part of a body fail.

        Args:
            fault: Of an entity.
            model: That it has now.
            replace: Replaces the model of an entity.

        Raises:
            RequestRefused: There are too many.
            EngineRefused: The engine cannot simulate it.
        """
        self._require_room()
        whole = self._whole.get(fault.entity, model)
        own = [one for one in self._bodies if one.entity == fault.entity]
        replace(fault.entity, _apply_all(whole, [*own, fault]))
        self._whole[fault.entity] = whole
        self._bodies.append(fault)

    def add_topic_fault(self, fault: TimedTopicFault) -> None:
        """Let topics of an entity fail.

        Raises:
            RequestRefused: There are too many.
        """
        self._require_room()
        self._topics.append(fault)
        self._list_topic_faults()

    def end_due(self, time_ns: int, replace: ReplaceModel) -> None:
        """End the faults that are over."""
        over = {one.entity for one in self._bodies if one.span.is_over(time_ns)}
        self._bodies = [one for one in self._bodies if not one.span.is_over(time_ns)]
        for entity in sorted(over):
            own = [one for one in self._bodies if one.entity == entity]
            whole = self._whole[entity] if own else self._whole.pop(entity)
            replace(entity, _apply_all(whole, own))
        if any(one.span.is_over(time_ns) for one in self._topics):
            self._topics = [one for one in self._topics if not one.span.is_over(time_ns)]
            self._list_topic_faults()

    def forget(self, entity: str) -> None:
        """Drop the faults of an entity that is gone."""
        self._bodies = [one for one in self._bodies if one.entity != entity]
        self._whole.pop(entity, None)
        self._topics = [one for one in self._topics if one.entity != entity]
        self._list_topic_faults()

    def end_all(self, replace: ReplaceModel) -> None:
        """End all faults; entities that are left get their models back."""
        for entity, model in self._whole.items():
            replace(entity, model)
        self.forget_all()

    def forget_all(self) -> None:
        """Drop all faults; their entities are gone."""
        self._bodies, self._topics, self.topic_faults = [], [], ()
        self._whole.clear()

    def _list_topic_faults(self) -> None:
        self.topic_faults = tuple(one.fault for one in self._topics)

    def _require_room(self) -> None:
        if len(self) >= MAX_INJECTED_FAULTS:
            raise RequestRefused(
                ResultCode.OPERATION_FAILED,
                f"{MAX_INJECTED_FAULTS} faults act already; wait for the end of some, or reset",
            )


def _apply_all(model: Model, faults: Sequence[BodyFault]) -> Model:
    for fault in faults:
        model = fault.apply(model)
    return model
