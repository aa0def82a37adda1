"""`zensim state get` and `set`."""

from functools import partial
from typing import Annotated, TypeVar

import msgspec
import typer
from msgspec.structs import astuple

from zensim.proto.cli_options import ClientOptions, JsonOption, expand_options, make_app
from zensim.proto.exit_codes import exit_on_failure
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
from zensim.spawner.cli.command_session import EntityName, open_client, print_json
from zensim.spawner.spawn.spawn_poses import make_pose

app = make_app("state")

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


@app.command("get")
@expand_options
def get_state(
    name: EntityName,
    *,
    frame: FrameOption = "",
    as_json: JsonOption = False,
    server: ClientOptions,
) -> None:
    """Print the pose and velocity of an entity."""
    with open_client("state get", server) as client:
        state = client.entity_state(name, frame)
    if as_json:
        print_json({"entity": name, **msgspec.to_builtins(state)})
        return
    typer.echo("\n".join(_format_state(name, state)))


@app.command(
    "set",
    epilog="""Examples:
  zensim state set r1 -x 1 -Y 0.5
  zensim state set r1 --linear 0.2 0 0 --frame r2""",
)
@expand_options
def set_state(
    name: EntityName,
    *,
    x: Annotated[float | None, _pose("-x", help=r"Position along x \[m].")] = None,
    y: Annotated[float | None, _pose("-y", help=r"Position along y \[m].")] = None,
    z: Annotated[float | None, _pose("-z", help=r"Position along z \[m].")] = None,
    roll: Annotated[float | None, _pose("-R", help=r"Roll \[rad].")] = None,
    pitch: Annotated[float | None, _pose("-P", help=r"Pitch \[rad].")] = None,
    yaw: Annotated[float | None, _pose("-Y", help=r"Yaw \[rad].")] = None,
    linear: Annotated[
        Vector | None, _pose(metavar="X Y Z", help=r"Linear velocity \[m/s].")
    ] = None,
    angular: Annotated[
        Vector | None, _pose(metavar="X Y Z", help=r"Angular velocity \[rad/s].")
    ] = None,
    frame: FrameOption = "",
    server: ClientOptions,
) -> None:
    """Set the pose or velocity of an entity, and print the result."""
    position, angles = (x, y, z), (roll, pitch, yaw)
    has_pose = any(number is not None for number in (*position, *angles))
    has_twist = linear is not None or angular is not None
    with exit_on_failure("state set"):
        if not (has_pose or has_twist):
            raise ValueError("nothing to set; give -x -y -z -R -P -Y, --linear or --angular")
    with open_client("state set", server) as client:
        old = client.entity_state(name, frame)
        new = EntityState(
            Header(frame_id=frame),
            _merge_pose(old.pose, position, angles),
            _merge_twist(old.twist, linear, angular),
        )
        client.set_entity_state(name, new, has_pose=has_pose, has_twist=has_twist)
        typer.echo("\n".join(_format_state(name, client.entity_state(name, frame))))


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


def _format_state(name: str, state: EntityState) -> list[str]:
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
