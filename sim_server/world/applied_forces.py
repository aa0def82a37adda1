"""Wrenches on links and efforts on joints that act for a span of simulation time."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from zensim.proto.messages.result_messages import ResultCode
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.physics.engine import Engine, FloatArray
from zensim.sim_server.world.entity import Entity

MAX_APPLIED_FORCES = 4096
"""That last at one time."""


@dataclass(frozen=True)
class TimeSpan:
    """From a time to another, the end not in it; None = for ever."""

    start_ns: int
    end_ns: int | None

    def holds(self, time_ns: int) -> bool:
        """Whether a time is in it."""
        return self.start_ns <= time_ns and not self.is_over(time_ns)

    def is_over(self, time_ns: int) -> bool:
        """Whether it has ended."""
        return self.end_ns is not None and time_ns >= self.end_ns


@dataclass(frozen=True)
class LinkWrench:
    """A wrench (6,) [N, N m] in the world's axes at the centre of mass of a link.

    Attributes:
        link: Index among `Model.links`.
    """

    entity: str
    link: int
    wrench: FloatArray
    span: TimeSpan

    def apply(self, engine: Engine, body: int) -> None:
        """Push for one step."""
        engine.apply_link_wrench(body, self.link, self.wrench)


@dataclass(frozen=True)
class JointEffort:
    """An effort [N m or N] on a joint.

    Attributes:
        joint: Index among `Model.joints`.
    """

    entity: str
    joint: int
    effort: float
    span: TimeSpan

    def apply(self, engine: Engine, body: int) -> None:
        """Push for one step."""
        engine.apply_joint_effort(body, self.joint, self.effort)


AppliedForce = LinkWrench | JointEffort


def make_time_span(
    *, now_ns: int, start_ns: int, duration_ns: int, step_ns: int
) -> TimeSpan | None:
    """Find when a push acts: at once if its start is over, for a step at least; None = never.

    Args:
        now_ns: Simulation time.
        start_ns: When it is to begin.
        duration_ns: Negative = for ever, 0 = not at all.
        step_ns: Length of a step.
    """
    if duration_ns == 0:
        return None
    start_ns = max(start_ns, now_ns)
    return TimeSpan(start_ns, None if duration_ns < 0 else start_ns + max(duration_ns, step_ns))


class AppliedForces:
    """All that last or are still to come, in the order of asking."""

    def __init__(self) -> None:
        self._pushes: list[AppliedForce] = []

    def __len__(self) -> int:
        return len(self._pushes)

    def add(self, push: AppliedForce) -> None:
        """Begin one, beside the others.

        Raises:
            Refused: There are too many.
        """
        if len(self._pushes) >= MAX_APPLIED_FORCES:
            raise RequestRefused(
                ResultCode.OPERATION_FAILED,
                f"{MAX_APPLIED_FORCES} wrenches and efforts last already; clear some first",
            )
        self._pushes.append(push)

    def apply(self, engine: Engine, entities: Mapping[str, Entity], time_ns: int) -> None:
        """Push what is to be pushed in the step that begins now, and forget what is over."""
        self._pushes = [push for push in self._pushes if not push.span.is_over(time_ns)]
        for push in self._pushes:
            if push.span.holds(time_ns):
                push.apply(engine, entities[push.entity].body)

    def clear_link(self, entity: str, link: int) -> int:
        """End all wrenches on a link; say how many there were."""
        return self._keep(
            lambda push: (
                not (isinstance(push, LinkWrench) and (push.entity, push.link) == (entity, link))
            )
        )

    def clear_joint(self, entity: str, joint: int) -> int:
        """End all efforts on a joint; say how many there were."""
        return self._keep(
            lambda push: (
                not (isinstance(push, JointEffort) and (push.entity, push.joint) == (entity, joint))
            )
        )

    def forget(self, entity: str) -> None:
        """End all on an entity."""
        self._keep(lambda push: push.entity != entity)

    def forget_all(self) -> None:
        """End all."""
        self._pushes = []

    def _keep(self, is_kept: Callable[[AppliedForce], bool]) -> int:
        before = len(self._pushes)
        self._pushes = [push for push in self._pushes if is_kept(push)]
        return before - len(self._pushes)
