"""`zensim state get` and `set`."""

from typing import Annotated, TypeVar

import msgspec
import typer
from msgspec.structs import astuple

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
from zensim.spawner.cli.command_session import (
    AsJson,
    Connect,
    EntityName,
    Timeout,
    WorldName,
    open_client,
)
from zensim.spawner.spawn.spawn_client import make_pose

app = typer.Typer(
    name="state", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)

FrameOption = Annotated[
    str, typer.Option("--frame", help="world, an entity, entity::link or namespace/link.")
]
Vector = tuple[float, float, float]
Given = TypeVar("Given")


@app.command("get")
def get_state(
    name: EntityName,
    *,
    frame: FrameOption = "",
    as_json: AsJson = False,
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Tell where an entity is and how it moves."""
    with open_client("state get", connect, world_name, timeout) as client:
        state = client.entity_state(name, frame)
    if as_json:
        facts = {"entity": name, **msgspec.to_builtins(state)}
        typer.echo(msgspec.json.encode(facts).decode())
        return
    typer.echo("\n".join(_format_state(name, state)))


@app.command("set")
def set_state(
    name: EntityName,
    *,
    x: Annotated[float | None, typer.Option("-x", help="Metres; as it is unless given.")] = None,
    y: Annotated[float | None, typer.Option("-y", help="Metres.")] = None,
    z: Annotated[float | None, typer.Option("-z", help="Metres.")] = None,
    roll: Annotated[float | None, typer.Option("-R", help="Radians.")] = None,
    pitch: Annotated[float | None, typer.Option("-P", help="Radians.")] = None,
    yaw: Annotated[float | None, typer.Option("-Y", help="Radians.")] = None,
    linear: Annotated[Vector | None, typer.Option(metavar="X Y Z", help="Velocity [m/s].")] = None,
    angular: Annotated[
        Vector | None, typer.Option(metavar="X Y Z", help="Turning [rad/s].")
    ] = None,
    frame: FrameOption = "",
    timeout: Timeout = 10.0,
    connect: Connect = "",
    world_name: WorldName = "default",
) -> None:
    """Put an entity somewhere, or set it in motion; what is not given stays as it is."""
    place, turn = (x, y, z), (roll, pitch, yaw)
    has_pose = any(number is not None for number in (*place, *turn))
    has_twist = linear is not None or angular is not None
    with exit_on_failure("state set"):
        if not (has_pose or has_twist):
            raise ValueError("nothing to set; give -x -y -z -R -P -Y, --linear or --angular")
    with open_client("state set", connect, world_name, timeout) as client:
        now = client.entity_state(name, frame)
        wanted = EntityState(
            Header(frame_id=frame),
            _merge_pose(now.pose, place, turn),
            _merge_twist(now.twist, linear, angular),
        )
        client.set_entity_state(name, wanted, has_pose=has_pose, has_twist=has_twist)
        typer.echo("\n".join(_format_state(name, client.entity_state(name, frame))))


def _merge_pose(
    now: Pose,
    place: tuple[float | None, float | None, float | None],
    turn: tuple[float | None, float | None, float | None],
) -> Pose:
    here = (now.position.x, now.position.y, now.position.z)
    x, y, z = map(_or_current, place, here)
    if turn == (None, None, None):
        # As it came: angles there and back would move it by a rounding.
        return Pose(Point(x, y, z), now.orientation)
    roll, pitch, yaw = map(_or_current, turn, to_rpy(astuple(now.orientation)))
    return make_pose((x, y, z), (roll, pitch, yaw))


def _merge_twist(now: Twist, linear: Vector | None, angular: Vector | None) -> Twist:
    return Twist(
        now.linear if linear is None else Vector3(*linear),
        now.angular if angular is None else Vector3(*angular),
    )


def _or_current(given: Given | None, otherwise: Given) -> Given:
    return otherwise if given is None else given


def _format_state(name: str, state: EntityState) -> list[str]:
    place, twist = state.pose.position, state.twist
    when_s = ns_from_time(state.header.stamp) / NANOSECONDS
    figures = {
        "position [m]": (place.x, place.y, place.z),
        "roll pitch yaw [rad]": to_rpy(astuple(state.pose.orientation)),
        "linear [m/s]": (twist.linear.x, twist.linear.y, twist.linear.z),
        "angular [rad/s]": (twist.angular.x, twist.angular.y, twist.angular.z),
    }
    return [
        f"{name} in {state.header.frame_id} at {when_s:.3f} s",
        *(_format_row(title, numbers) for title, numbers in figures.items()),
    ]


def _format_row(title: str, numbers: Vector) -> str:
    # A zero has no sign for people.
    columns = (f"{round(number, 4) + 0.0:10.4f}" for number in numbers)
    return f"  {title:<20}" + " ".join(columns)
