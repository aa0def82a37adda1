"""What the state of a world may name: classes of listed modules, some functions and methods.

A snapshot is read by these names alone, so that no bytes can name anything else.
"""

from collections.abc import Callable
from functools import cache
from importlib import import_module
from types import FunctionType
from typing import Final

MESSAGES: Final = "zensim.proto.messages."
"""Package of messages; each is written and read as MessagePack of its own."""
STATE_MODULES: Final = frozenset(
    f"zensim.{name}"
    for name in (
        "proto.memory_bus",
        "api.world_host",
        "api.world_session",
        "proto.codec.cdr_batch",
        "proto.codec.cdr_template",
        "proto.drives.ackermann_steering",
        "proto.drives.array_math",
        "proto.drives.column_math",
        "proto.drives.differential_drive",
        "proto.drives.measured_joints",
        "proto.drives.planar_motion",
        "proto.drives.rate_steering",
        "proto.drives.roller_wheels",
        "proto.drives.tricycle_steering",
        "proto.fleet_topics.attachment_rows",
        "proto.fleet_topics.fleet_publisher",
        "proto.fleet_topics.matched_publishers",
        "proto.fleet_topics.ros_fleet_publisher",
        "proto.fleet_topics.topic_members",
        "proto.joint_transforms",
        "proto.network_protocols",
        "proto.path_following",
        "proto.rate_limiter",
        "proto.ros2.node_services",
        "proto.ros2.ros_settings",
        "proto.sensor_noise",
        "proto.topic_endpoints",
        "proto.topic_faults",
        "robot_agent.base_controller",
        "robot_agent.bumpers",
        "robot_agent.joint_commands",
        "robot_agent.joint_control",
        "robot_agent.joint_trajectory",
        "robot_agent.link_motion",
        "robot_agent.message_templates",
        "robot_agent.mounted_sensors",
        "robot_agent.odometry",
        "robot_agent.pool.group_bases",
        "robot_agent.pool.group_key",
        "robot_agent.pool.group_sensors",
        "robot_agent.pool.group_telemetry",
        "robot_agent.pool.pooled_bumpers",
        "robot_agent.pool.pooled_robots",
        "robot_agent.pool.static_topics",
        "robot_agent.robot_frames",
        "robot_agent.robot_rows",
        "robot_agent.state_sensors",
        "robot_agent.topic_remapping",
        "robot_agent.trajectory_follower",
        "robot_agent.true_odometry",
        "sim_server.description.world_model",
        "sim_server.physics.actuation",
        "sim_server.physics.blueprint",
        "sim_server.physics.body_reach",
        "sim_server.physics.body_table",
        "sim_server.physics.cells.cell_assignment",
        "sim_server.physics.cells.cell_bodies",
        "sim_server.physics.cells.cell_executor",
        "sim_server.physics.cells.cell_map",
        "sim_server.physics.cells.celled_engine",
        "sim_server.physics.command_cache",
        "sim_server.physics.driven_wheels",
        "sim_server.physics.engine",
        "sim_server.physics.engine_config",
        "sim_server.physics.engine_factory",
        "sim_server.physics.isolating_engine",
        "sim_server.physics.joint_inertia",
        "sim_server.physics.link_forces",
        "sim_server.physics.sleeping_engine",
        "sim_server.runtime.contact_telemetry",
        "sim_server.runtime.world_telemetry",
        "sim_server.scene.footprints",
    )
)
"""Modules of which a state may have objects."""
STATE_PACKAGES: Final = tuple(
    f"zensim.sim_server.{name}."
    for name in ("physics.bullet", "physics.kinematic", "physics.mujoco", "world")
)
"""Packages of which it may have, too: they start nothing, and have no network and clock."""
FUNCTIONS: Final = frozenset(
    {
        "pybullet:createCollisionShapeArray",
        "zensim.sim_server.physics.bullet.pybullet_engine:_arrange",
        "zensim.sim_server.physics.kinematic.planar_vehicle:_read_mesh",
    }
)
"""Functions that a state refers to."""
CALLED: Final = frozenset(
    {
        "zensim.proto.topic_catalog:find_topic",
        "zensim.sim_server.physics.bullet.pybullet_engine:BareModels",
        "zensim.sim_server.physics.bullet.pybullet_engine:_find_origin",
    }
)
"""What `__reduce__` of a class has named to find or make its value; it changes nothing."""
METHODS: Final = frozenset(
    {
        "_find_publisher",
        "_find_states",
        "_find_width",
        "_make_static_factory",
        "_take_margin",
        "find_motions",
        "find_numbers",
        "make",
        "of",
    }
)
"""Methods of these classes that a state refers to."""


class NotState(Exception):
    """A name or value that no state of a world has."""


def name_of(value: type | Callable[..., object]) -> str:
    """Name a class or function by its module."""
    return f"{value.__module__}:{value.__qualname__}"


@cache
def find_class(name: str) -> type:
    """Find a class of the state.

    Raises:
        NotState: It is none.
    """
    module, _, qualname = name.partition(":")
    if module in STATE_MODULES or module.startswith((*STATE_PACKAGES, MESSAGES)):
        found = _find(module, qualname)
        if isinstance(found, type) and not issubclass(found, BaseException):
            return found
    raise NotState(f"class {name[:100]!r}")


@cache
def find_function(name: str, listed: frozenset[str] = FUNCTIONS) -> Callable[..., object]:
    """Find a function that the state refers to.

    Raises:
        NotState: It is none.
    """
    module, _, qualname = name.partition(":")
    if name in listed and callable(found := _find(module, qualname)):
        return found
    raise NotState(f"function {name[:100]!r}")


def find_method(owner: object, name: str) -> Callable[..., object]:
    """Find a method of an object of the state.

    Raises:
        NotState: It is none.
    """
    function = getattr(type(owner), name, None)
    if name not in METHODS or not isinstance(function, FunctionType):
        raise NotState(f"method {name[:100]!r} of {type(owner).__name__}")
    found: Callable[..., object] = getattr(owner, name)
    return found


def _find(module: str, qualname: str) -> object:
    """Find what a module itself defines."""
    try:
        found = vars(import_module(module)).get(qualname)
    except (ImportError, ValueError):  # of an engine that is not installed here
        return None
    return found if getattr(found, "__module__", "") in (module, None) else None
