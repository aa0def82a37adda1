"""The format of scenario files as types: keys, units, ranges, defaults and what each means.

Help, JSON Schema, reference and errors are made from these types. A number with a unit may be a
draw in the file; here, draws are resolved.
"""

from typing import Annotated, Any, Literal

import msgspec

from zensim.scenario.fault_sections import Fault, Selected
from zensim.scenario.quantities import described, quantity
from zensim.scenario.setting_sections import (
    AgentsSection,
    EngineSection,
    Name,
    NetworkSection,
    RosSection,
    SensorsSection,
    TimeSection,
    ViewerSection,
    WorldSection,
)

FORMAT_VERSION = 1

FloorPoint = tuple[Annotated[float, quantity("m", "x.")], Annotated[float, quantity("m", "y.")]]
"""x, y in the world."""
FloorPath = Annotated[
    tuple[FloorPoint, ...], msgspec.Meta(min_length=1, description="Points x, y in the world.")
]


class LayoutSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Places of the robots of a group."""

    kind: Annotated[
        Literal["row", "grid", "circle", "random"],
        described("row = along x; circle = facing outward; random = in a square."),
    ] = "row"
    spacing: Annotated[
        float, quantity("m", "Distance between neighbours; random: the least.", above=0.0)
    ] = 1.0
    radius: (
        Annotated[
            float, quantity("m", "Radius of the circle, or half of the square's side.", above=0.0)
        ]
        | None
    ) = None
    x: Annotated[float, quantity("m", "Position of the layout's origin.")] = 0.0
    y: Annotated[float, quantity("m", "Position of the layout's origin.")] = 0.0


class PlaceSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One pose; without z on the ground."""

    x: Annotated[float, quantity("m", "Position.")] = 0.0
    y: Annotated[float, quantity("m", "Position.")] = 0.0
    z: Annotated[float, quantity("m", "Height; null = on the ground.")] | None = None
    roll: Annotated[float, quantity("rad", "Angle about x.")] = 0.0
    pitch: Annotated[float, quantity("rad", "Angle about y.")] = 0.0
    yaw: Annotated[float, quantity("rad", "Angle about z.")] = 0.0
    name: Annotated[str, described("Name of the robot; empty = group and number.")] = ""


class RobotsSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A group of robots of one model."""

    name: Annotated[Name, described("Name of a single robot; prefix of several.")]
    model: Annotated[str, described("Shipped model, or path of a URDF, xacro or SDF file.")]
    count: (
        Annotated[int, msgspec.Meta(ge=1, le=10000, description="Number; null = number of poses.")]
        | None
    ) = None
    layout: Annotated[LayoutSection, described("Places of the robots.")] | None = None
    poses: Annotated[
        tuple[PlaceSection, ...] | str | None,
        described(
            "Poses, or a file of them: CSV with a head line name,x,y,z,yaw, JSON, or YAML, also "
            "with x_pose, y_pose, z_pose, as launch files have it."
        ),
    ] = None
    yaw: Annotated[float, quantity("rad", "Heading, added to that of layout or pose.")] = 0.0
    agent: Annotated[
        Literal["pool", "none"], described("pool = driven by a pool; none = by nothing.")
    ] = "pool"
    xacro: Annotated[dict[str, str], described("Arguments of xacro.")] = {}
    package_paths: Annotated[
        tuple[str, ...],
        described("Folders with packages, models or meshes, besides those of ROS_PACKAGE_PATH."),
    ] = ()
    controllers: Annotated[tuple[str, ...], described("Files of ros2_control.")] = ()
    drive: Annotated[str, described("Drive in place of that of the description.")] = ""
    namespace: Annotated[
        str, described("Prefix of topics and frames of a single robot; empty = its name.")
    ] = ""
    compat: Annotated[
        Literal["fixed", "gazebo11"],
        described("gazebo11 = drives with the documented errors of Gazebo 11."),
    ] = "fixed"
    strict: Annotated[bool, described("Refuse a description with suspicious entries.")] = False
    allow_missing: Annotated[bool, described("Leave out collisions whose mesh is missing.")] = False
    tags: Annotated[tuple[str, ...], described("Tags of the entities.")] = ()


class BehaviourSection(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="do"
):
    """Keys of every behaviour."""

    name: Annotated[Name, described("Name, for checks and faults.")]
    robots: Selected
    at: Annotated[float, quantity("s", "Start.", at_least=0.0)] = 0.0
    duration: Annotated[float, quantity("s", "Length; null = to the end.", above=0.0)] | None = (
        msgspec.field(default=None, name="for")
    )
    hold: Annotated[
        bool, described("Go on commanding a robot of `zensim up` that others command, too.")
    ] = False


class Stand(BehaviourSection, frozen=True, tag="stand"):
    """Stand still."""


class DriveAhead(BehaviourSection, frozen=True, tag="drive"):
    """Drive with a constant twist."""

    v: Annotated[float, quantity("m/s", "Speed ahead.")] = 0.0
    w: Annotated[float, quantity("rad/s", "Turn to the left.")] = 0.0


class CircleAround(BehaviourSection, frozen=True, tag="circle"):
    """Drive a circle to the left; to the right with a negative radius."""

    speed: Annotated[float, quantity("m/s", "Speed on the circle.", above=0.0)] = 0.3
    radius: Annotated[float, quantity("m", "Radius, not 0.")] = 0.4


class FollowWaypoints(BehaviourSection, frozen=True, tag="waypoints"):
    """Drive from point to point, and stop at the last."""

    points: FloorPath
    speed: Annotated[float, quantity("m/s", "Speed.", above=0.0)] = 0.3
    tolerance: Annotated[
        float, quantity("m", "A point is reached at this distance.", above=0.0)
    ] = 0.1
    loop: Annotated[bool, described("Begin again after the last point.")] = False


class Patrol(BehaviourSection, frozen=True, tag="patrol"):
    """Drive from point to point there and back, with a pause at both ends."""

    points: FloorPath
    speed: Annotated[float, quantity("m/s", "Speed.", above=0.0)] = 0.3
    tolerance: Annotated[
        float, quantity("m", "A point is reached at this distance.", above=0.0)
    ] = 0.1
    pause: Annotated[float, quantity("s", "Stop at both ends.", at_least=0.0)] = 0.0


class RandomWalk(BehaviourSection, frozen=True, tag="random_walk"):
    """Drive ahead, and choose another turn now and then."""

    speed: Annotated[float, quantity("m/s", "Speed.", above=0.0)] = 0.3
    turn: Annotated[float, quantity("rad/s", "Largest turn to either side.", above=0.0)] = 1.0
    turn_every: Annotated[float, quantity("s", "Time between choices.", above=0.0)] = 2.0


class Navigate(BehaviourSection, frozen=True, tag="navigate"):
    """Drive from point to point, again and again, around what rays in front of the robot hit."""

    points: FloorPath
    speed: Annotated[float, quantity("m/s", "Largest speed.", above=0.0)] = 0.3
    tolerance: Annotated[
        float, quantity("m", "A point is reached at this distance.", above=0.0)
    ] = 0.4


class ReplayCommands(BehaviourSection, frozen=True, tag="replay"):
    """Repeat recorded commands."""

    file: Annotated[
        str, described("CSV with a head line time,v,w, or time,robot,v,w; SI, times increase.")
    ]
    loop: Annotated[bool, described("Begin again after the last command.")] = False


class CarryOutOrders(BehaviourSection, frozen=True, tag="orders"):
    """Carry out orders of VDA 5050: each when the one before is finished, updates at once."""

    file: Annotated[
        str,
        described("JSON: an order or a list of orders; `serialNumber` is the robot, or it is all."),
    ]
    speed: Annotated[float, quantity("m/s", "Largest speed.", above=0.0)] = 1.0


class FollowRobot(BehaviourSection, frozen=True, tag="follow"):
    """Follow another robot at a distance."""

    target: Annotated[Name, described("The robot to follow.")]
    distance: Annotated[float, quantity("m", "Distance to keep.", above=0.0)] = 1.0
    speed: Annotated[float, quantity("m/s", "Largest speed.", above=0.0)] = 0.5


class PythonBehaviour(BehaviourSection, frozen=True, tag="python"):
    """A class of the author: `__init__(sim, robots, **args)`, `step(now, state) -> (n, 2)`."""

    call: Annotated[
        str,
        msgspec.Meta(
            pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$", description="module:Class, or file's module."
        ),
    ]
    args: Annotated[dict[str, Any], described("Keyword arguments of the class.")] = {}
    rate: (
        Annotated[float, quantity("Hz", "Calls; null = every control step.", above=0.0)] | None
    ) = None


Behaviour = (
    Stand
    | DriveAhead
    | CircleAround
    | FollowWaypoints
    | Patrol
    | RandomWalk
    | FollowRobot
    | Navigate
    | ReplayCommands
    | CarryOutOrders
    | PythonBehaviour
)


class CheckSection(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="that"
):
    """Keys of every check: at which times it has to be true.

    Always, unless `by` (once until then) or `after` (once `within` a time after each start of a
    fault or behaviour).
    """

    name: Annotated[Name, described("Name, for reports.")]
    severity: Annotated[Literal["fail", "warn"], described("warn = reported, but no failure.")] = (
        "fail"
    )
    start: Annotated[float, quantity("s", "Not looked at before.", at_least=0.0)] = msgspec.field(
        default=0.0, name="from"
    )
    to: Annotated[float, quantity("s", "Not looked at after.", above=0.0)] | None = None
    by: Annotated[float, quantity("s", "True once until then.", above=0.0)] | None = None
    after: Annotated[str, described("A fault or behaviour after each start of which to look.")] = ""
    within: (
        Annotated[float, quantity("s", "True once within this time of `after`.", above=0.0)] | None
    ) = None
    hold: Annotated[float, quantity("s", "And then true for this time.", at_least=0.0)] = 0.0
    until: Annotated[str, described("Not looked at after the start of this.")] = ""
    excluded: Annotated[str, described("Not looked at during this fault or behaviour.")] = (
        msgspec.field(default="", name="except")
    )


class CheckOfRobots(CheckSection, frozen=True, kw_only=True):
    """A check of robots; each of them has to pass."""

    robots: Selected = "*"


class NoCollisionCheck(CheckOfRobots, frozen=True, kw_only=True, tag="no_collision"):
    """The outlines of robots touch neither each other nor walls: rectangles around collisions."""

    radius: (
        Annotated[float, quantity("m", "Radius of round outlines; null = rectangles.", above=0.0)]
        | None
    ) = None
    walls: Annotated[
        bool, described("Nor do they touch the world's own static entities, meshes excepted.")
    ] = True


class DistanceCheck(CheckOfRobots, frozen=True, kw_only=True, tag="distance"):
    """Distance of the origins of all pairs of robots."""

    above: Annotated[float, quantity("m", "Least distance.")] | None = None
    below: Annotated[float, quantity("m", "Largest distance.")] | None = None


class SpeedCheck(CheckOfRobots, frozen=True, kw_only=True, tag="speed"):
    """Speed over the ground."""

    above: Annotated[float, quantity("m/s", "Least speed.")] | None = None
    below: Annotated[float, quantity("m/s", "Largest speed.")] | None = None


class AccelerationCheck(CheckOfRobots, frozen=True, kw_only=True, tag="acceleration"):
    """Change of the speed over the ground in a control step."""

    below: Annotated[float, quantity("m/s^2", "Largest acceleration.", above=0.0)]


class ReachedCheck(CheckOfRobots, frozen=True, kw_only=True, tag="reached"):
    """The robot is at a point; needs `by`, or `after` and `within`."""

    point: Annotated[FloorPoint, described("x, y in the world.")]
    tolerance: Annotated[float, quantity("m", "Distance to it.", above=0.0)] = 0.1


class InsideCheck(CheckOfRobots, frozen=True, kw_only=True, tag="inside"):
    """The robot is inside of a polygon; margin: distance to its border."""

    polygon: Annotated[
        tuple[FloorPoint, ...], msgspec.Meta(min_length=3, description="Corners x, y.")
    ]


class OutsideCheck(CheckOfRobots, frozen=True, kw_only=True, tag="outside"):
    """The robot is outside of a polygon; margin: distance to its border."""

    polygon: Annotated[
        tuple[FloorPoint, ...], msgspec.Meta(min_length=3, description="Corners x, y.")
    ]


class UprightCheck(CheckOfRobots, frozen=True, kw_only=True, tag="upright"):
    """The robot's z axis is near the vertical."""

    below: Annotated[float, quantity("rad", "Largest tilt.", above=0.0)] = 0.5


class TrackingCheck(CheckOfRobots, frozen=True, kw_only=True, tag="tracking"):
    """The robot is near a path."""

    path: FloorPath
    below: Annotated[float, quantity("m", "Largest distance.", above=0.0)]


class RateCheck(CheckSection, frozen=True, kw_only=True, tag="rate"):
    """Messages of a topic, by simulated time."""

    topic: Annotated[str, described("Key, such as cart0/scan.")]
    above: Annotated[float, quantity("Hz", "Least rate.")] | None = None
    below: Annotated[float, quantity("Hz", "Largest rate.")] | None = None
    window: Annotated[float, quantity("s", "Time over which it is counted.", above=0.0)] = 1.0


class NoEventCheck(CheckSection, frozen=True, kw_only=True, tag="no_event"):
    """A fault or behaviour does not start."""

    event: Annotated[str, described("Name of a fault or behaviour.")]


class RealTimeFactorCheck(CheckSection, frozen=True, kw_only=True, tag="real_time_factor"):
    """The run is fast enough: simulated time by wall time since its start."""

    above: Annotated[float, quantity("1", "Least factor.", above=0.0)]


class PythonCheck(CheckOfRobots, frozen=True, kw_only=True, tag="python"):
    """A class of the author: `__init__(robots, **args)`, `update(now, state) -> margin`."""

    call: Annotated[
        str, msgspec.Meta(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$", description="module:Class.")
    ]
    args: Annotated[dict[str, Any], described("Keyword arguments of the class.")] = {}


class AllOfCheck(CheckSection, frozen=True, kw_only=True, tag="all_of"):
    """All of the named checks are true at the same time."""

    checks: Annotated[tuple[str, ...], msgspec.Meta(min_length=1, description="Names of checks.")]


class AnyOfCheck(CheckSection, frozen=True, kw_only=True, tag="any_of"):
    """One of the named checks is true."""

    checks: Annotated[tuple[str, ...], msgspec.Meta(min_length=1, description="Names of checks.")]


Check = (
    NoCollisionCheck
    | DistanceCheck
    | SpeedCheck
    | AccelerationCheck
    | ReachedCheck
    | InsideCheck
    | OutsideCheck
    | UprightCheck
    | TrackingCheck
    | RateCheck
    | NoEventCheck
    | RealTimeFactorCheck
    | PythonCheck
    | AllOfCheck
    | AnyOfCheck
)


class RecordSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A recording of the run, from the first spawn on, in place of that of an earlier run."""

    to: Annotated[
        str, described("File .mcap, or folder, from this file; with {name} and {seed} of the run.")
    ]
    topics: Annotated[tuple[str, ...], described("Topics; empty = all.")] = ()
    keep: Annotated[Literal["always", "on_failure"], described("When to keep it.")] = "always"


class EndCondition(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Checks whose success ends the run."""

    all: Annotated[tuple[str, ...], described("Checks that all have passed.")] = ()
    any: Annotated[tuple[str, ...], described("Checks of which one has passed.")] = ()


class EndSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The end of the run, whichever comes first."""

    at: (
        Annotated[float, quantity("s", "Simulated time; null = 10 s in `zensim test`.", above=0.0)]
        | None
    ) = None
    when: Annotated[EndCondition, described("End as soon as checks have passed.")] | None = None
    on_failure: Annotated[Literal["stop", "continue"], described("What a failed check does.")] = (
        "continue"
    )
    timeout: Annotated[float, quantity("s", "Wall time of the whole run.", above=0.0)] = 600.0


class ScenarioFormat(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A scenario file."""

    zensim: Annotated[Literal[1], described("Version of the format; the only required key.")]
    name: Annotated[str, described("Name of the run; empty = name of the file.")] = ""
    description: Annotated[str, described("What the run shows.")] = ""
    include: Annotated[
        tuple[str, ...], described("Files that this one completes; maps and named entries merge.")
    ] = ()
    world: Annotated[WorldSection, described("The world.")] = WorldSection()
    engine: Annotated[EngineSection, described("The physics engine.")] = EngineSection()
    time: Annotated[TimeSection, described("Time and random numbers.")] = TimeSection()
    network: Annotated[NetworkSection, described("Zenoh and the server.")] = NetworkSection()
    ros: Annotated[RosSection, described("Keys of ROS 2.")] = RosSection()
    viewer: Annotated[ViewerSection, described("The page of `zensim up`.")] = ViewerSection()
    sensors: Annotated[SensorsSection, described("Sensor processes.")] = SensorsSection()
    robots: Annotated[tuple[RobotsSection, ...], described("Groups of robots.")] = ()
    agents: Annotated[tuple[AgentsSection, ...], described("Who drives; default: a pool.")] = ()
    behaviours: Annotated[tuple[Behaviour, ...], described("What robots do.")] = ()
    faults: Annotated[tuple[Fault, ...], described("What goes wrong.")] = ()
    checks: Annotated[tuple[Check, ...], described("What has to be true.")] = ()
    record: Annotated[RecordSection, described("A recording.")] | None = None
    end: Annotated[EndSection, described("The end of the run.")] = EndSection()
    vary: Annotated[
        dict[str, Any],
        described("Values by key path for sweeps; `random`, `list`, `seeds`, `repeats`."),
    ] = {}
