"""Sensors keep their settings and are placed in moving links."""

import pytest

from tests.sim_server.description.robots import (
    a_joint,
    a_link,
    a_reference,
    a_robot,
    an_inertial,
    mentions,
    subjects,
)
from zensim.proto.messages.model_messages import Model, Origin, Parameter, RosBlock
from zensim.sim_server.description.plugins.sensor_tags import MAX_PARAMETERS, MAX_SENSORS
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError

LIDAR = """
<sensor type="gpu_ray" name="lidar">
  <pose>0 0 0.1 0 0 0</pose><update_rate>5</update_rate><always_on>true</always_on>
  <ray><scan><horizontal><samples>360</samples></horizontal></scan></ray>
  <plugin name="scan" filename="libgazebo_ros_ray_sensor.so">
    <ros><namespace>/r1</namespace><remapping>~/out:=scan</remapping></ros>
    <frame_name>lidar_link</frame_name>
  </plugin>
</sensor>
"""


def a_robot_with(sensor: str, on: str = "mast") -> Model:
    mast = a_joint("m", ("base", "mast"), "fixed", '<origin xyz="1 0 0"/>')
    text = a_robot(a_link("base", an_inertial()), a_link("mast"), mast, a_reference(on, sensor))
    return read_urdf(text)


def test_sensor_is_placed_in_the_merged_link() -> None:
    (lidar,) = a_robot_with(LIDAR).sensors

    assert (lidar.name, lidar.kind, lidar.update_rate_hz) == ("lidar", "gpu_ray", 5.0)
    assert (lidar.link, lidar.frame, lidar.origin) == ("base", "mast", Origin((1.0, 0.0, 0.1)))


def test_sensor_keeps_its_plugin_and_every_setting() -> None:
    (lidar,) = a_robot_with(LIDAR).sensors

    assert lidar.plugin == "libgazebo_ros_ray_sensor.so"
    assert lidar.ros == RosBlock("r1", ("~/out:=scan",))
    assert Parameter("ray/scan/horizontal/samples", "360") in lidar.parameters
    assert Parameter("plugin/frame_name", "lidar_link") in lidar.parameters


@pytest.mark.parametrize("kind", ["imu", "ray", "contact", "camera", "depth", "depth_camera"])
def test_known_sensor_is_reported(kind: str) -> None:
    report = a_robot_with(f'<sensor type="{kind}" name="s"/>').report

    assert subjects(report, "ignored") == ["sensor 's' on 'mast'"]
    assert mentions(report, "ignored", f"'{kind}'")


def test_unknown_sensor_is_reported() -> None:
    model = a_robot_with('<sensor type="crystal_ball" name="s"/>')

    assert subjects(model.report, "unknown") == ["sensor 's' on 'mast'"]
    assert mentions(model.report, "unknown", "'crystal_ball'")
    assert [sensor.kind for sensor in model.sensors] == ["crystal_ball"]


@pytest.mark.parametrize(
    "inside",
    ["<update_rate>fast</update_rate>", "<pose>0 0 0</pose>", "<pose>0 0 0 0 0 nan</pose>"],
)
def test_sensor_is_refused_when_a_number_is_invalid(inside: str) -> None:
    with pytest.raises(ModelError, match="sensor 's'") as caught:
        a_robot_with(f'<sensor type="imu" name="s">{inside}</sensor>')

    assert caught.value.slug == "urdf.sensor"


def test_sensor_keeps_a_limited_number_of_settings() -> None:
    model = a_robot_with('<sensor type="imu" name="s">' + "<a/>" * 500 + "</sensor>")

    assert len(model.sensors[0].parameters) == MAX_PARAMETERS
    assert mentions(model.report, "suspicious", "sensor 's'", "500", str(MAX_PARAMETERS))


def test_sensors_beyond_five_hundred_are_left_out() -> None:
    model = a_robot_with('<sensor name="s" type="imu"/>' * 503)

    assert len(model.sensors) == MAX_SENSORS
    assert subjects(model.report, "suspicious") == ["sensors"]
    assert mentions(model.report, "suspicious", "503", "500")
