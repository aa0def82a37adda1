"""Many robots in one simulated world, on a Zenoh network, without ROS or Gazebo."""

from typing import TYPE_CHECKING

from zensim.public_names import find_public_name, list_public_names

if TYPE_CHECKING:
    from zensim.api.api_errors import (
        Closed,
        ConnectionLost,
        Denied,
        Error,
        Invalid,
        NotFound,
        SpawnRefused,
        SteppedElsewhere,
        Timeout,
        Unreachable,
        Unsupported,
    )
    from zensim.api.connections import connect, launch, servers
    from zensim.api.entity_values import RobotPose, RobotTwist, SpawnReport, deg
    from zensim.api.fleet import Fleet
    from zensim.api.in_process_world import World
    from zensim.api.odometry_table import FleetOdometryRows
    from zensim.api.recording_file import Recording
    from zensim.api.robot import EntityHandle, Robot
    from zensim.api.sim import Sim
    from zensim.api.simulation import Simulation
    from zensim.api.topic import Topic, TopicCallback
    from zensim.api.world_page import WorldPage
    from zensim.api.world_picture import WorldPicture
    from zensim.api.world_view import WorldView
    from zensim.scenario.scenario_loading import load
    from zensim.scenario.world_export import export

__all__ = [
    "Closed",
    "ConnectionLost",
    "Denied",
    "EntityHandle",
    "Error",
    "Fleet",
    "FleetOdometryRows",
    "Invalid",
    "NotFound",
    "Recording",
    "Robot",
    "RobotPose",
    "RobotTwist",
    "Sim",
    "Simulation",
    "SpawnRefused",
    "SpawnReport",
    "SteppedElsewhere",
    "Timeout",
    "Topic",
    "TopicCallback",
    "Unreachable",
    "Unsupported",
    "World",
    "WorldPage",
    "WorldPicture",
    "WorldView",
    "connect",
    "deg",
    "export",
    "launch",
    "load",
    "servers",
]


def __getattr__(name: str) -> object:
    """Import a public name when it is first used."""
    found = globals()[name] = find_public_name(name)
    return found


def __dir__() -> list[str]:
    return list_public_names()
