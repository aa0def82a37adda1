"""The Engine interface and its optional capabilities."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Model, TierName
from zensim.proto.messages.result_messages import ResultCode
from zensim.sim_server.errors import SimError
from zensim.sim_server.physics.body_table import BodyNumbers

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]
Place = tuple[float, float]
"""x and y [m] of a root link."""
SleepScope = Literal["none", "loose", "all"]
"""Which bodies an engine can put to sleep; loose ones have neither joints nor actuators."""

MIN_MASS_KG = 1e-4
"""Least mass of a moving link: engines treat mass 0 as immovable."""
MIN_INERTIA = 1e-8
"""Least principal moment [kg m^2] of a moving link."""


def can_move(model: Model) -> bool:
    """Whether any part of a model moves."""
    return not model.is_static or any(joint.kind != "fixed" for joint in model.joints)


class EngineRefused(SimError):
    """The engine cannot simulate this."""

    code = ResultCode.OPERATION_FAILED
    slug = "engine.refused"


class EngineLost(RuntimeError):
    """The engine, or a process of it, ended: all its bodies are lost."""


@contextmanager
def refuse_faults(subject: str) -> Iterator[None]:
    """Turn an unexpected exception about one model into a refusal.

    Args:
        subject: What was attempted, such as "model 'arm'".

    Raises:
        EngineRefused: Anything but a refusal or a lost engine was raised.
    """
    try:
        yield
    except (SimError, EngineLost):
        raise
    except Exception as error:
        raise EngineRefused(f"{subject}: the engine failed: {describe_fault(error)}") from error


def describe_fault(error: BaseException) -> str:
    """Describe an exception in one line; SystemError of C extensions has its reason as cause."""
    cause = f" ({describe_fault(error.__cause__)})" if error.__cause__ is not None else ""
    return f"{type(error).__name__}: {error}{cause}"


@dataclass(frozen=True)
class BodyStates:
    """State of some bodies, in the order requested.

    Attributes:
        base: (n, 13): root link frame in the world: position, quaternion xyzw, linear, angular.
        joint_positions: (k,) all joints of all bodies, in the order of `Model.joints`.
        joint_velocities: (k,) likewise.
    """

    base: FloatArray
    joint_positions: FloatArray
    joint_velocities: FloatArray


def make_unknown_efforts(count: int) -> FloatArray:
    """Make the efforts (count,) of joints whose forces are not computed: NaN."""
    return np.full(count, np.nan)


def concatenate_states(states: Sequence[BodyStates]) -> BodyStates:
    """Concatenate the states of bodies."""
    if len(states) == 1:
        return states[0]
    return BodyStates(
        np.concatenate([np.zeros((0, 13)), *(one.base for one in states)]),
        np.concatenate([np.zeros(0), *(one.joint_positions for one in states)]),
        np.concatenate([np.zeros(0), *(one.joint_velocities for one in states)]),
    )


GROUND = -1
"""Stands for the ground among the numbers of bodies."""
SUPPORT_NORMAL_Z = 0.7
"""Upward share of a normal from which something fixed carries a robot, as a floor or ramp."""
MAX_PENETRATION_RECOVERY_MPS = 0.2
"""Limit of the speed that corrects a penetration, such as ODE's `contact_max_correcting_vel`."""
CONTACT_BODIES, CONTACT_NUMBERS = 4, 10


@dataclass(frozen=True)
class ContactPoints:
    """Points at which some bodies touched something in the last step, as these bodies feel it.

    Attributes:
        bodies: (n, 4): the body and its link, the other body or `GROUND`, and its link.
        points: (n, 10) in the world: position [m], unit normal towards the body, depth [m]
            (positive when overlapping), force on the body [N]; 0 where only motion is blocked.
    """

    bodies: IntArray
    points: FloatArray

    def __len__(self) -> int:
        """Number of points."""
        return len(self.bodies)

    def select(self, rows: IntArray) -> "ContactPoints":
        """Select some points."""
        return ContactPoints(self.bodies[rows], self.points[rows])


def concatenate_contacts(parts: Sequence[ContactPoints]) -> ContactPoints:
    """Concatenate contact points."""
    if len(parts) == 1:
        return parts[0]
    return ContactPoints(
        np.concatenate([NO_CONTACTS.bodies, *(one.bodies for one in parts)]),
        np.concatenate([NO_CONTACTS.points, *(one.points for one in parts)]),
    )


def make_contact_points(
    bodies: Sequence[Sequence[int]], points: Sequence[Sequence[float]]
) -> ContactPoints:
    """Make contact points from rows."""
    return ContactPoints(
        np.array(bodies, dtype=np.intp).reshape(-1, CONTACT_BODIES),
        np.array(points, dtype=np.float64).reshape(-1, CONTACT_NUMBERS),
    )


NO_CONTACTS = make_contact_points((), ())


def make_invalid_state(model: Model) -> BodyStates:
    """Make the state of a body that is set aside: NaN throughout."""
    joints = np.full(len(model.joints), np.nan)
    return BodyStates(np.full((1, 13), np.nan), joints, joints.copy())


@dataclass(frozen=True)
class EngineCapabilities:
    """Which optional methods of `Engine` have an effect.

    Attributes:
        hides: `hide` and `show`.
        sleeps: `sleep`, `wake` and `find_contacts`, of which bodies.
        is_remote: Another process does the work: `skip_validation`, `find_overlaps_async` and
            `is_idle` avoid waiting for it.
        copies: A saved state can be used in another engine, beside this one.
    """

    hides: bool = False
    sleeps: SleepScope = "none"
    is_remote: bool = False
    copies: bool = False


class Engine(ABC):
    """Physics of bodies: arrays in and out; no names, time or network.

    The outermost engine numbers bodies, by `add` and `remove`; all engines and cells within use the
    same numbers. Methods that are not abstract are optional; their defaults have no effect.
    """

    capabilities = EngineCapabilities()

    @cached_property
    def _body_numbers(self) -> BodyNumbers:
        return BodyNumbers()

    def add(self, model: Model, base: FloatArray) -> int:
        """Make a body as `insert` does, and number it; raises what it raises."""
        body = self._body_numbers.take()
        try:
            self.insert(body, model, base)
        except BaseException:
            self._body_numbers.give_back(body)
            raise
        return body

    def remove(self, body: int) -> None:
        """Remove a body; its number may be used again."""
        self.discard(body)
        self._body_numbers.give_back(body)

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the engine, as `--engine` takes it."""

    @abstractmethod
    def prepare(self, model: Model) -> bool:
        """Make a part of what `insert` needs for a model, as much as fits between two steps.

        Returns:
            Whether nothing is left to make, or `insert` will raise.
        """

    @abstractmethod
    def insert(self, body: int, model: Model, base: FloatArray) -> None:
        """Make a body of a model with its root link at `base` (13,), joints at zero.

        Args:
            body: Number that no other body of this engine has.
            model: Of the body.
            base: State of its root link.

        Raises:
            EngineRefused: The engine cannot simulate the model.
        """

    @abstractmethod
    def discard(self, body: int) -> None:
        """Remove a body from this engine only; another one may have it."""

    @abstractmethod
    def forget_removed(self) -> None:
        """Drop caches of removed bodies, so that new bodies give the same bits as a fresh run."""

    @abstractmethod
    def find_overlaps(self, body: int) -> Sequence[int]:
        """Find the other bodies that a body penetrates, the ground excepted."""

    @abstractmethod
    def read(self, bodies: Sequence[int]) -> BodyStates:
        """Read the states of bodies."""

    @abstractmethod
    def read_joint_efforts(self, bodies: Sequence[int]) -> FloatArray:
        """Read the efforts (k,) [N m or N] of the joints of bodies in the last step, as in `read`.

        An effort is what the motor exerts on the child link along the axis of the joint; of a joint
        without a motor its friction, and its spring. NaN where no forces are computed.
        """

    @abstractmethod
    def set_base_state(self, body: int, base: FloatArray) -> None:
        """Set the state of the root link to `base` (13,); joints stay as they are."""

    @abstractmethod
    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """Set the root link to `base` (13,), stop the joints at `positions` or zero, clear targets.

        A planar twist is not imposed again until the next command.
        """

    @abstractmethod
    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """Set the whole state of a body; targets stay, and a sleeping body wakes.

        Args:
            body: Number of the body.
            base: (13,) of its root link.
            positions: Of its joints, in the order of `Model.joints`.
            velocities: Likewise.
        """

    @abstractmethod
    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """Set the targets of `Model.actuators`, body by body; they hold until set again.

        Motors reach speeds and angles within their effort limits. A planar twist is imposed before
        each step on vx, vy and wz only; height and tilt follow the dynamics.
        """

    @abstractmethod
    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        """Add a wrench to a link in the next step.

        Args:
            body: Number of the body; no effect on one that never moves.
            link: Index in `Model.links`.
            wrench: (6,) force [N] and torque [N m] at its centre of mass, in the world's axes.
        """

    @abstractmethod
    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        """Add an effort [N m or N] along the axis of a joint in the next step."""

    @abstractmethod
    def step(self) -> bool:
        """Advance by one step.

        Returns:
            False if a body diverged or failed: read all and remove it before the next step.
        """

    @abstractmethod
    def close(self) -> None:
        """Free the engine."""

    def resume(self) -> None:  # noqa: B027
        """Finish the restoring of an engine that was read from a saved state.

        The engine that it replaces is closed afterwards.
        """

    @property
    def kinematic_count(self) -> int:
        """Number of bodies in the kinematic tier."""
        return 0

    def tier_of(self, body: int) -> TierName:  # noqa: ARG002
        """Find the dynamics that a body has now."""
        return "full"

    def expect(self, models: Sequence[Model], places: Sequence[Place] = ()) -> None:  # noqa: B027
        """Announce the models of all bodies that come next, in place of those announced before.

        An engine may then make room for all of them at once. Nothing is due: bodies may come in
        another order, or not at all.

        Args:
            models: Of the bodies.
            places: Where each of them will be, if known.
        """

    def hide(self, body: int) -> None:  # noqa: B027
        """Keep a body that was just added from moving and touching anything."""

    def show(self, bodies: Sequence[int]) -> None:  # noqa: B027
        """Let hidden bodies take part from the next step on."""

    def sleep(self, bodies: Sequence[int]) -> None:  # noqa: B027
        """Put bodies at rest to sleep: they keep their state; the caller wakes them on contact."""

    def wake(self, bodies: Sequence[int]) -> None:  # noqa: B027
        """Wake bodies at rest: they move from the step after the next on."""

    def find_contacts(self, body: int) -> Sequence[int]:  # noqa: ARG002
        """Find the other bodies that a body touched in the last step, the ground excepted."""
        return ()

    def read_contacts(self, bodies: Sequence[int]) -> ContactPoints:  # noqa: ARG002
        """Read the points at which bodies touched something in the last step, the ground included.

        A body that sleeps has those of the step in which it fell asleep.
        """
        return NO_CONTACTS

    def take_faults(self) -> Mapping[int, str]:
        """Take the bodies that were set aside since the last call, each with the reason.

        Such a body is read as NaN, and calls for it have no effect until it is removed.
        """
        return {}

    def skip_validation(self, model: Model) -> None:  # noqa: B027
        """Let `insert` return before the model is validated: an equal engine has accepted it."""

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        """Start `find_overlaps`; the returned function waits for the result."""
        found = self.find_overlaps(body)
        return lambda: found

    def is_idle(self) -> bool:
        """Whether no started call is unfinished; polled in each iteration of the loop."""
        return True

    def replicate(self, bodies: Sequence[int], count: int) -> "EngineReplicas":  # noqa: ARG002
        """Copy the engine as it is, with all bodies; the copies have nothing to do with it.

        Args:
            bodies: That are read and commanded; what moves without them is stepped, too.
            count: Number of copies; > 0.

        Raises:
            EngineRefused: The engine cannot be copied, or not as it is.
        """
        raise EngineRefused(f"{self.name} cannot step many worlds together; use MuJoCo")


class SteppedTogether(Protocol):
    """An engine, or several that make their steps together."""

    def step(self) -> bool:
        """Advance by one step; see `Engine.step`. Copies that have diverged rest."""


class EngineReplicas(ABC):
    """Copies of an engine, each a world of its own; arrays have a row for each copy.

    A body that diverges ends its copy until that is restored: it is read as NaN.
    """

    @abstractmethod
    def make_groups(self, least: int) -> Sequence["SteppedTogether"]:
        """Divide the copies into groups, `least` or more if there are so many copies."""

    @abstractmethod
    def read(self) -> BodyStates:
        """Read the bodies copy by copy: base (copies * n, 13), joints (copies * k,)."""

    @abstractmethod
    def command(self, targets: FloatArray) -> None:
        """Set targets (copies, t) of the bodies; see `Engine.command`."""

    @abstractmethod
    def restore(self, copies: Iterable[int]) -> None:
        """Put some copies into the state in which they were made."""

    def save(self) -> tuple[FloatArray, ...]:
        """Copy the states and targets of all copies.

        Raises:
            EngineRefused: The engine has no such arrays.
        """
        raise EngineRefused("full dynamics are not saved as arrays; use kinematic robots")

    def load(self, saved: tuple[FloatArray, ...]) -> None:  # noqa: ARG002
        """Put all copies into the states that `save` returned; raises what it raises."""
        self.save()

    @abstractmethod
    def find_touching(self) -> BoolArray:
        """Find which bodies (copies, n) touch another body; what carries them does not count.

        What carries a body is the ground, and whatever is fixed and below it.
        """
