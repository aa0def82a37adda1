"""Built-in robots and worlds can be read, and no other files."""

import math
from collections.abc import Callable

import pytest

from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.sensor_messages import ContactSensor, RaySensor
from zensim.sim_server.description.builtin_models import (
    list_builtin_models,
    list_builtin_worlds,
    read_builtin_model,
    read_builtin_world,
)
from zensim.sim_server.description.plugins.sensor_reader import complete_sensors
from zensim.sim_server.description.sdf.sdf_world import read_world
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError


def test_built_in_names_include_the_tutorials_robot_and_world() -> None:
    assert "box_bot" in list_builtin_models()
    assert "empty" in list_builtin_worlds()


@pytest.mark.parametrize("name", sorted({*list_builtin_models()} - {"box_bot_legacy"}))
def test_built_in_robot_has_only_applied_entries(name: str) -> None:
    model = complete_sensors(read_urdf(read_builtin_model(name)), "fixed")

    assert [entry for entry in model.report if entry.status != "applied"] == []


@pytest.mark.parametrize(
    ("name", "topics"),
    [
        ("box_bot_lidar", {"scan", "imu", "bumper_states"}),
        (
            "box_bot_camera",
            {
                "camera/image_raw",
                "camera/image_raw/compressed",
                "camera/camera_info",
                "camera/depth/image_raw",
                "camera/depth/camera_info",
                "camera/points",
                "camera/labels",
            },
        ),
    ],
)
def test_built_in_robot_has_the_topics_of_its_sensors(name: str, topics: set[str]) -> None:
    model = complete_sensors(read_urdf(read_builtin_model(name)), "fixed")

    assert {topic.name for sensor in model.sensors for topic in sensor.topics} == topics


def test_scan_of_the_built_in_lidar_has_the_count_that_slam_toolbox_expects() -> None:
    (lidar,) = (
        sensor.settings
        for sensor in read_urdf(read_builtin_model("box_bot_lidar")).sensors
        if isinstance(sensor.settings, RaySensor)
    )
    axis = lidar.horizontal
    increment = (axis.high_rad - axis.low_rad) / (axis.count - 1)

    assert round((axis.high_rad - axis.low_rad) / increment) + 1 == axis.count == 360
    assert math.isclose(axis.high_rad + increment, axis.low_rad + 2.0 * math.pi)


def test_bumper_of_the_built_in_robot_watches_its_box() -> None:
    model = complete_sensors(read_urdf(read_builtin_model("box_bot_lidar")), "fixed")
    (bumper,) = (one.settings for one in model.sensors if isinstance(one.settings, ContactSensor))

    ((link, collision),) = bumper.collisions
    assert model.links[link].collisions[collision].size == (0.1, 0.1, 0.1)


@pytest.mark.parametrize("name", list_builtin_worlds())
def test_built_in_world_has_only_applied_entries(name: str) -> None:
    report = read_world(read_builtin_world(name)).report

    assert [entry for entry in report if entry.status != "applied"] == []


@pytest.mark.parametrize("name", ["", "nobody", "../models/box_bot", "box_bot.urdf", "/etc/passwd"])
@pytest.mark.parametrize(
    ("read", "shipped"), [(read_builtin_model, "box_bot"), (read_builtin_world, "empty")]
)
def test_error_lists_the_built_in_names(
    read: Callable[[str], str], shipped: str, name: str
) -> None:
    with pytest.raises(ModelError, match=shipped) as caught:
        read(name)

    assert caught.value.code == ResultCode.NOT_FOUND
