"""Wrenches on links and efforts on joints that act for a span of simulation time."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from zensim.proto.messages.result_messages import ResultCode
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.physics.engine import Engine, FloatArray
from zensim.sim_server.world.entity import Entity

MAX_APPLIED_FORCES = 4096
"""Most forces that are active or pending."""


@dataclass(frozen=True)
class TimeSpan:
    """Simulation time from start to end, the end excluded; None = for ever."""

    start_ns: int
    end_ns: int | None

    def find_share(self, time_ns: int, step_ns: int) -> float:
        """Find the share of a step that begins at a time, 0 to 1."""
        begin_ns, end_ns = max(self.start_ns, time_ns), time_ns + step_ns
        if self.end_ns is not None:
            end_ns = min(end_ns, self.end_ns)
        return max(0, end_ns - begin_ns) / step_ns

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

    def apply(self, engine: Engine, body: int, share: float) -> None:
        """Apply it for a share of the next step."""
        engine.apply_link_wrench(body, self.link, share * self.wrench)


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

    def apply(self, engine: Engine, body: int, share: float) -> None:
        """Apply it for a share of the next step."""
        engine.apply_joint_effort(body, self.joint, share * self.effort)


AppliedForce = LinkWrench | JointEffort


def make_time_span(*, now_ns: int, start_ns: int, duration_ns: int) -> TimeSpan | None:
    """Find when a force acts: from now on if its start is past; None = never.

    Args:
        now_ns: Simulation time.
        start_ns: Requested start.
        duration_ns: Negative = for ever, 0 = not at all.
    """
    if duration_ns == 0:
        return None
    start_ns = max(start_ns, now_ns)
    return TimeSpan(start_ns, None if duration_ns < 0 else start_ns + duration_ns)


class AppliedForces:
    """Active and pending forces, in the order of requests."""

    def __init__(self) -> None:
        self._forces: list[AppliedForce] = []

    def __len__(self) -> int:
        return len(self._forces)

    def add(self, force: AppliedForce) -> None:
        """Add a force.

        Raises:
            RequestRefused: There are too many.
        """
        if len(self._forces) >= MAX_APPLIED_FORCES:
            raise RequestRefused(
                ResultCode.OPERATION_FAILED,
                f"{MAX_APPLIED_FORCES} wrenches and efforts are active already; clear some first",
            )
        self._forces.append(force)

    def has_left(self, time_ns: int) -> bool:
        """Whether a force acts at a time, or will."""
        return any(not one.span.is_over(time_ns) for one in self._forces)

    def apply(
        self, engine: Engine, entities: Mapping[str, Entity], time_ns: int, step_ns: int
    ) -> None:
        """Apply the active forces in the next step, and drop those that have ended.

        What acts for a share of the step has that share of the force: the impulse is exact.
        """
        self._forces = [force for force in self._forces if not force.span.is_over(time_ns)]
        for force in self._forces:
            if share := force.span.find_share(time_ns, step_ns):
                force.apply(engine, entities[force.entity].body, share)

    def clear_link(self, entity: str, link: int) -> int:
        """Remove all wrenches on a link; return their number."""
        return self._keep(
            lambda one: (
                not (isinstance(one, LinkWrench) and (one.entity, one.link) == (entity, link))
            )
        )

    def clear_joint(self, entity: str, joint: int) -> int:
        """Remove all efforts on a joint; return their number."""
        return self._keep(
            lambda one: (
                not (isinstance(one, JointEffort) and (one.entity, one.joint) == (entity, joint))
            )
        )

    def forget(self, entity: str) -> None:
        """Remove all forces on an entity."""
        self._keep(lambda force: force.entity != entity)

    def forget_all(self) -> None:
        """Remove all forces."""
        self._forces = []

    def _keep(self, is_kept: Callable[[AppliedForce], bool]) -> int:
        before = len(self._forces)
        self._forces = [force for force in self._forces if is_kept(force)]
        return before - len(self._forces)
