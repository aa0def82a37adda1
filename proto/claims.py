"""How an agent drives entities: claim, drive state in, drive command out. zensim's own.

Arrays travel as little-endian bytes: `<f8` for numbers, `<u4` for claim ids.
"""

from typing import ClassVar, Literal

import msgspec

from proto.model import Model
from proto.result import Result
from proto.widths import UInt32, UInt64

STATE_COLUMNS = 13
"""Position x y z, quaternion x y z w, linear x y z, angular x y z: all in the world frame."""

OnRelease = Literal["stop", "keep", "delete"]


class ClaimEntityRequest(msgspec.Struct, frozen=True):
    """Ask to be the only driver of these entities, all or none of them."""

    ros_type: ClassVar[str] = "zensim/srv/ClaimEntity_Request"

    agent: str = ""
    """Unique; its liveliness token must be up."""
    entities: tuple[str, ...] = ()
    on_release: OnRelease = "stop"


class Claim(msgspec.Struct, frozen=True):
    """What an agent needs to know of one entity that it drives."""

    claim: UInt32
    """Never used twice by one server: a command under an old claim is dropped."""
    entity: str
    namespace: str
    model: Model
    robot_description: str = ""
    spawn_state: tuple[float, ...] = ()
    """State at spawn, `STATE_COLUMNS` numbers."""


class ClaimEntityResponse(msgspec.Struct, frozen=True):
    """The claims, and the clock that the drive runs by."""

    ros_type: ClassVar[str] = "zensim/srv/ClaimEntity_Response"

    result: Result = Result()
    claims: tuple[Claim, ...] = ()
    step_ns: UInt64 = 0
    control_steps: UInt32 = 0
    """Steps between two drive states."""


class DriveState(msgspec.Struct, frozen=True):
    """Everything that one agent drives, at one step."""

    ros_type: ClassVar[str] = "zensim/msg/DriveState"

    epoch: UInt32
    step: UInt64
    time_ns: UInt64
    claims: bytes
    """`<u4`, (n,)."""
    base: bytes
    """`<f8`, (n, STATE_COLUMNS), in the order of `claims`."""
    joint_positions: bytes
    """`<f8`, all joints of all claims, model by model in the order of `Model.joints`."""
    joint_velocities: bytes
    newest_claim: UInt32 = 0
    """The newest of all claims when this was told: an older state says nothing of a newer claim."""
    is_awaited: bool = False
    """Time stands until the answer comes: what the state makes due is published before it."""


class DriveCommand(msgspec.Struct, frozen=True):
    """Targets for everything that one agent drives; the newest wins.

    An awaited state is answered by the command of its own epoch, step and claims, by no other.
    """

    ros_type: ClassVar[str] = "zensim/msg/DriveCommand"

    epoch: UInt32
    step: UInt64
    """Of the drive state that it answers."""
    claims: bytes
    """`<u4`, (n,)."""
    targets: bytes
    """`<f8`, for each of `Model.actuators` as many numbers as its width, claim by claim."""
