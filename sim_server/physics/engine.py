"""The Engine protocol and its optional capabilities: array-based physics without names, time or network."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Protocol, cast, runtime_checkable

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Model, TierName
from zensim.proto.messages.result_messages import ResultCode
from zensim.sim_server.errors import SimError

FloatArray = npt.NDArray[np.float64]

MIN_MASS_KG = 1e-4
"""What a moving link weighs at least: engines take 0 for 'never moves'."""
MIN_INERTIA = 1e-8
"""Least principal moment [kg m^2] of a moving link."""


class EngineRefused(SimError):
    """The engine cannot simulate this."""

    code = ResultCode.OPERATION_FAILED
    slug = "engine.refused"


@dataclass(frozen=True)
class BodyStates:
    """State of some bodies, in the order asked for.

    Attributes:
        base: (n, 13): root link frame in the world: position, quaternion xyzw, linear, angular.
        joint_positions: (k,) all joints of all bodies, in the order of `Model.joints`.
        joint_velocities: (k,) likewise.
    """

    base: FloatArray
    joint_positions: FloatArray
    joint_velocities: FloatArray


class Engine(Protocol):
    """Steps bodies through time."""

    @property
    def name(self) -> str:
        """Which engine this is."""

    def prepare(self, model: Model) -> bool:
        """Make a part of what `add` needs for a model, as much as fits between two steps.

        Returns:
            Whether nothing is left to be made, or `add` is to say what is wrong.
        """

    def add(self, model: Model, base: FloatArray) -> int:
        """Make a body of a model with its root link at `base` (13,), joints at zero.

        Raises:
            EngineRefused: The engine cannot simulate the model.
        """

    def remove(self, body: int) -> None:
        """Take a body out; its number may be used again."""

    def forget_removed(self) -> None:
        """Keep nothing of what was taken out: bodies made from now on repeat a fresh run's bits."""

    def find_overlaps(self, body: int) -> Sequence[int]:
        """Name the other bodies that a body reaches into; the ground is none."""

    def read(self, bodies: Sequence[int]) -> BodyStates:
        """Read bodies back."""

    def place(self, body: int, base: FloatArray) -> None:
        """Put the root link at `base` (13,) and keep the joints."""

    def rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """Put the root link at `base` (13,), joints still at `positions` or zero, targets at zero.

        A twist is imposed no more, until it is commanded again.
        """

    def put(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """Give a body a whole state; its targets stay as commanded, and one that sleeps wakes.

        Args:
            body: What is put there.
            base: (13,) of its root link.
            positions: Of its joints, in the order of `Model.joints`.
            velocities: Likewise.
        """

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """Set the targets of `Model.actuators`, body by body; they hold until set again.

        Speeds and angles are reached with the effort that each motor has. A twist is imposed before
        each step on what the body does in the plane: heights and tilts remain the engine's.
        """

    def push_link(self, body: int, link: int, wrench: FloatArray) -> None:
        """Push a link in the next step, beside what else pushes it.

        Args:
            body: What is pushed; one that never moves does not mind.
            link: Index among `Model.links`.
            wrench: (6,) force [N] and torque [N m] at its centre of mass, in the world's axes.
        """

    def push_joint(self, body: int, joint: int, effort: float) -> None:
        """Push a joint along its axis in the next step, beside its motor [N m or N]."""

    def step(self) -> bool:
        """Advance by one step.

        Returns:
            Whether all is well as far as a glance tells; if not, a body has gone bad, and is to be
            read and removed before the next step.
        """

    def close(self) -> None:
        """Free the engine."""


@runtime_checkable
class SupportsTiers(Protocol):
    """An engine in which bodies may move by other means than forces and contacts."""

    @property
    def kinematic_count(self) -> int:
        """How many bodies are in the kinematic tier."""

    def tier_of(self, body: int) -> TierName:
        """Say by which dynamics a body moves now."""


@runtime_checkable
class SupportsHiding(Protocol):
    """An engine that can keep bodies out of the world until others are made too."""

    def hide(self, body: int) -> None:
        """Let a body that was just added neither move nor touch anything."""

    def show(self, bodies: Sequence[int]) -> None:
        """Let concealed bodies take part from the next step on."""


@runtime_checkable
class SupportsSleep(Protocol):
    """An engine in which bodies can sleep: they stay where they are, and cost next to nothing."""

    def sleep(self, bodies: Sequence[int]) -> None:
        """Let bodies sleep that hardly move; what awake ones do to them is the caller's care."""

    def wake(self, bodies: Sequence[int]) -> None:
        """Wake bodies at rest: they move from the step after the next on."""

    def find_contacts(self, body: int) -> Sequence[int]:
        """Name the other bodies that a body touched in the last step; the ground is none."""


@runtime_checkable
class SupportsAsync(Protocol):
    """An engine that other processes work for, and that need not wait for them."""

    def skip_validation(self, model: Model) -> None:
        """Note that an engine alike has taken a model, so that adding it need not be waited for."""

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        """Begin to find what `find_overlaps` names; what is returned waits for it."""

    def is_idle(self) -> bool:
        """Whether nothing that was begun is still under way; asked at every turn of the loop."""


def as_hiding(engine: Engine) -> SupportsHiding | None:
    """Take an engine as one that conceals, if it does."""
    return cast("SupportsHiding", engine) if _supports_hiding(type(engine)) else None


def as_async(engine: Engine) -> SupportsAsync | None:
    """Take an engine as one that need not wait, if it is."""
    return cast("SupportsAsync", engine) if _supports_async(type(engine)) else None


@cache
def _supports_async(kind: type) -> bool:
    return issubclass(kind, SupportsAsync)


@cache
def _supports_hiding(kind: type) -> bool:
    # Asked of an object, a protocol looks all its methods up: 65 us for each body of a fleet.
    return issubclass(kind, SupportsHiding)
