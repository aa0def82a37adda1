"""Options that set the pose and velocity of an entity, and how both are printed."""

from dataclasses import dataclass
from functools import partial
from typing import Annotated, TypeVar

import typer
from msgspec.structs import astuple

from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.standard_messages import (
    NANOSECONDS,
    Header,
    Point,
    Pose,
    Twist,
    Vector3,
    ns_from_time,
)
from zensim.proto.rigid_transforms import to_rpy
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn.spawn_poses import make_pose

FrameOption = Annotated[
    str,
    typer.Option(
        "--frame",
        metavar="FRAME",
        help="Reference frame: world, ENTITY, ENTITY::LINK or NAMESPACE/LINK.",
        show_default="world",
    ),
]
Vector = tuple[float, float, float]
Component = TypeVar("Component")
_pose = partial(
    typer.Option, metavar="NUMBER", show_default="unchanged", rich_help_panel="Pose and velocity"
)


@dataclass(frozen=True, kw_only=True)
class NewStateOptions:
    """Pose and velocity to set; None = unchanged."""

    x: Annotated[float | None, _pose("-x", help=r"Position along x \[m].")] = None
    y: Annotated[float | None, _pose("-y", help=r"Position along y \[m].")] = None
    z: Annotated[float | None, _pose("-z", help=r"Position along z \[m].")] = None
    roll: Annotated[float | None, _pose("-R", "--roll", help=r"Roll \[rad].")] = None
    pitch: Annotated[float | None, _pose("-P", "--pitch", help=r"Pitch \[rad].")] = None
    yaw: Annotated[float | None, _pose("-Y", "--yaw", help=r"Yaw \[rad].")] = None
    linear: Annotated[
        Vector | None, _pose("--linear", metavar="X Y Z", help=r"Linear velocity \[m/s].")
    ] = None
    angular: Annotated[
        Vector | None, _pose("--angular", metavar="X Y Z", help=r"Angular velocity \[rad/s].")
    ] = None
    frame: FrameOption = ""

    @property
    def has_pose(self) -> bool:
        """Whether a part of the pose is given."""
        parts = (self.x, self.y, self.z, self.roll, self.pitch, self.yaw)
        return any(number is not None for number in parts)

    @property
    def has_twist(self) -> bool:
        """Whether a velocity is given."""
        return self.linear is not None or self.angular is not None


def change_state(client: SimClient, name: str, new: NewStateOptions) -> None:
    """Set what is given of pose and velocity, and keep the rest."""
    old = client.entity_state(name, new.frame)
    state = EntityState(
        Header(frame_id=new.frame),
        _merge_pose(old.pose, (new.x, new.y, new.z), (new.roll, new.pitch, new.yaw)),
        _merge_twist(old.twist, new.linear, new.angular),
    )
    client.set_entity_state(name, state, has_pose=new.has_pose, has_twist=new.has_twist)


def _merge_pose(
    old: Pose,
    position: tuple[float | None, float | None, float | None],
    angles: tuple[float | None, float | None, float | None],
) -> Pose:
    old_position = (old.position.x, old.position.y, old.position.z)
    x, y, z = map(_or_old, position, old_position)
    if angles == (None, None, None):
        # Unchanged: a conversion to angles and back would add rounding errors.
        return Pose(Point(x, y, z), old.orientation)
    roll, pitch, yaw = map(_or_old, angles, to_rpy(astuple(old.orientation)))
    return make_pose((x, y, z), (roll, pitch, yaw))


def _merge_twist(old: Twist, linear: Vector | None, angular: Vector | None) -> Twist:
    return Twist(
        old.linear if linear is None else Vector3(*linear),
        old.angular if angular is None else Vector3(*angular),
    )


def _or_old(new: Component | None, old: Component) -> Component:
    return old if new is None else new


def format_state(name: str, state: EntityState) -> list[str]:
    """Format pose and velocity, one line each."""
    position, twist = state.pose.position, state.twist
    when_s = ns_from_time(state.header.stamp) / NANOSECONDS
    figures = {
        "position [m]": (position.x, position.y, position.z),
        "roll pitch yaw [rad]": to_rpy(astuple(state.pose.orientation)),
        "linear [m/s]": (twist.linear.x, twist.linear.y, twist.linear.z),
        "angular [rad/s]": (twist.angular.x, twist.angular.y, twist.angular.z),
    }
    return [
        f"{name} in {state.header.frame_id} at {when_s:.3f} s",
        *(_format_row(title, numbers) for title, numbers in figures.items()),
    ]


def _format_row(title: str, numbers: Vector) -> str:
    # Adding 0.0 removes the sign of -0.0.
    columns = (f"{round(number, 4) + 0.0:10.4f}" for number in numbers)
    return f"  {title:<20}" + " ".join(columns)
