"""The layout for Foxglove that `zensim foxglove --layout` prints. Pure."""

import json
from typing import Any, Final

from zensim.foxglove.live_topics import SCENE_TOPIC
from zensim.foxglove.scene_entities import WORLD_FRAME
from zensim.proto.topic_catalog import CMD_VEL, IMAGE_COMPRESSED, ODOM, SCAN, STATS

SCENE_PANEL: Final = "3D!zensim"
SPEED_PANEL: Final = "Plot!speed"
PACE_PANEL: Final = "Plot!pace"
TELEOP_PANEL: Final = "Teleop!zensim"
IMAGE_PANEL: Final = "Image!zensim"
CALL_PANEL: Final = "CallService!zensim"
CAMERA: Final = "camera"
"""Namespace of the camera of built-in robots, below that of the robot."""
LINEAR_MPS: Final = 0.5
ANGULAR_RADPS: Final = 1.0


def write_layout(world: str, robot: str) -> str:
    """Write a layout: 3D scene, plots, image, teleop and services.

    Args:
        world: Name of the world, whose statistics are plotted.
        robot: Namespace of the robot that is plotted and driven.
    """
    camera = f"{robot}/{CAMERA}"
    layout = {
        "configById": {
            SCENE_PANEL: _configure_scene(robot),
            SPEED_PANEL: _configure_plot(
                "Velocity of the robot",
                f"{ODOM.key(robot)}.twist.twist.linear.x",
                f"{ODOM.key(robot)}.twist.twist.angular.z",
            ),
            PACE_PANEL: _configure_plot("Pace", f"{STATS.key(world)}.real_time_factor"),
            TELEOP_PANEL: _configure_teleop(robot),
            IMAGE_PANEL: {"imageMode": {"imageTopic": f"/{IMAGE_COMPRESSED.key(camera)}"}},
            CALL_PANEL: {"serviceName": "/pause_physics", "requestPayload": "{}"},
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": SCENE_PANEL,
            "second": {
                "direction": "column",
                "first": {"direction": "column", "first": SPEED_PANEL, "second": PACE_PANEL},
                "second": {
                    "direction": "column",
                    "first": IMAGE_PANEL,
                    "second": {"direction": "row", "first": TELEOP_PANEL, "second": CALL_PANEL},
                },
            },
            "splitPercentage": 65,
        },
    }
    return json.dumps(layout, indent=2)


def _configure_scene(robot: str) -> dict[str, Any]:
    return {
        "followTf": WORLD_FRAME,
        "followMode": "follow-none",
        "cameraState": {
            "perspective": True,
            "distance": 20,
            "phi": 55,
            "thetaOffset": 45,
            "targetOffset": [0, 0, 0],
        },
        "topics": {
            SCENE_TOPIC: {"visible": True},
            f"/{SCAN.key(robot)}": {"visible": True, "pointSize": 3},
        },
        "layers": {
            "grid": {"layerId": "foxglove.Grid", "visible": True, "size": 40, "divisions": 40}
        },
        "scene": {"transforms": {"visible": False}},
    }


def _configure_plot(title: str, *paths: str) -> dict[str, Any]:
    return {
        "title": title,
        "paths": [
            {"value": f"/{path}", "enabled": True, "timestampMethod": "receiveTime"}
            for path in paths
        ],
        "showLegend": True,
        "xAxisVal": "timestamp",
        "followingViewWidth": 30,
    }


def _configure_teleop(robot: str) -> dict[str, Any]:
    return {
        "topic": f"/{CMD_VEL.key(robot)}",
        "publishRate": 10,
        "upButton": {"field": "linear-x", "value": LINEAR_MPS},
        "downButton": {"field": "linear-x", "value": -LINEAR_MPS},
        "leftButton": {"field": "angular-z", "value": ANGULAR_RADPS},
        "rightButton": {"field": "angular-z", "value": -ANGULAR_RADPS},
    }
