"""Names of the topics of sensors: defaults, remapping, rules of gz-sim and of ROS 1."""

import pytest

from tests.sim_server.description.plugins.sensor_samples import (
    a_model_with,
    a_sensor,
    a_sensor_plugin,
    the_sensor,
    topics_of,
)
from tests.sim_server.description.robots import mentions
from zensim.sim_server.description.plugins.sensor_settings import READERS

ROWS = "<lidar><scan><vertical><samples>4</samples></vertical></scan></lidar>"


def remapping(*rules: str) -> str:
    return f"<ros>{''.join(f'<remapping>{rule}</remapping>' for rule in rules)}</ros>"


def topics(kind: str, inside: str = "", plugin: str = "") -> dict[str, str]:
    return topics_of(the_sensor(a_sensor(kind, inside, plugin=plugin)))


@pytest.mark.parametrize(
    ("kind", "inside", "expected"),
    [
        ("ray", "", {"scan": "scan"}),
        ("gpu_lidar", "<topic>front/scan</topic>", {"scan": "front/scan"}),
        ("gpu_lidar", ROWS, {"scan": "scan", "points": "points"}),
        ("gpu_lidar", f"{ROWS}<topic>top</topic>", {"scan": "top", "points": "top/points"}),
        ("sonar", "", {"range": "range"}),
        ("imu", "", {"imu": "imu"}),
        ("imu", "<topic>imu/data</topic>", {"imu": "imu/data"}),
        ("contact", "", {"bumper_states": "bumper_states"}),
        ("contact", "<contact><topic>touch</topic></contact>", {"bumper_states": "touch"}),
        ("gps", "", {"fix": "fix", "vel": "vel"}),
        ("navsat", "<topic>navsat</topic>", {"fix": "navsat"}),
        ("altimeter", "", {"altimeter": "altimeter"}),
        ("magnetometer", "", {"magnetic_field": "magnetic_field"}),
        ("air_pressure", "<topic>barometer</topic>", {"air_pressure": "barometer"}),
    ],
)
def test_sensor_without_plugin_has_the_topic_that_gz_names(
    kind: str, inside: str, expected: dict[str, str]
) -> None:
    assert topics(kind, inside) == expected


def test_camera_without_plugin_publishes_below_its_name() -> None:
    assert topics("camera") == {
        "image_raw": "s/image_raw",
        "image_compressed": "s/image_raw/compressed",
        "camera_info": "s/camera_info",
        "labels": "s/labels",
    }


def test_camera_of_gz_publishes_beside_its_topic() -> None:
    assert topics("camera", "<topic>cam/image</topic>") == {
        "image_raw": "cam/image",
        "image_compressed": "cam/image/compressed",
        "camera_info": "cam/camera_info",
        "labels": "cam/labels",
    }
    named = "<topic>cam/image</topic><camera><camera_info_topic>cam/k</camera_info_topic></camera>"
    assert topics("camera", named)["camera_info"] == "cam/k"


def test_depth_cameras_of_gz_publish_below_their_topic() -> None:
    assert topics("rgbd_camera", "<topic>kinect</topic>") == {
        "image_raw": "kinect/image",
        "image_compressed": "kinect/image/compressed",
        "camera_info": "kinect/camera_info",
        "depth_image": "kinect/depth_image",
        "depth_points": "kinect/points",
        "labels": "kinect/labels",
    }
    assert topics("depth_camera", "<topic>depth</topic>") == {
        "depth_image": "depth",
        "depth_camera_info": "camera_info",
        "depth_points": "depth/points",
        "labels": "labels",
    }


@pytest.mark.parametrize(
    ("filename", "kind", "expected"),
    [
        ("gazebo_ros_ray_sensor", "ray", {"points": "driver/out"}),
        ("gazebo_ros_imu_sensor", "imu", {"imu": "driver/out"}),
        ("gazebo_ros_gps_sensor", "gps", {"fix": "driver/out", "vel": "driver/vel"}),
        ("gazebo_ros_bumper", "contact", {"bumper_states": "bumper_states"}),
    ],
)
def test_plugin_publishes_below_its_name(
    filename: str, kind: str, expected: dict[str, str]
) -> None:
    assert topics(kind, plugin=a_sensor_plugin(filename)) == expected


@pytest.mark.parametrize(
    ("rule", "expected"),
    [
        ("~/out:=scan", "scan"),
        ("~/out:=front/scan", "front/scan"),
        ("driver/out:=scan", "scan"),
        ("~/other:=scan", "driver/out"),
    ],
)
def test_remapping_names_the_topic(rule: str, expected: str) -> None:
    plugin = a_sensor_plugin("gazebo_ros_ray_sensor", remapping(rule))

    assert topics("ray", plugin=plugin) == {"points": expected}


def test_first_matching_rule_is_applied() -> None:
    plugin = a_sensor_plugin("gazebo_ros_imu_sensor", remapping("~/out:=first", "~/out:=second"))

    assert topics("imu", plugin=plugin) == {"imu": "first"}


def test_depth_camera_of_gazebo_ros_publishes_below_its_camera_name() -> None:
    tags = "<camera_name>front</camera_name>" + remapping("front/points:=cloud")

    assert topics("depth", plugin=a_sensor_plugin("gazebo_ros_camera", tags)) == {
        "image_raw": "front/image_raw",
        "image_compressed": "front/image_raw/compressed",
        "camera_info": "front/camera_info",
        "depth_image": "front/depth/image_raw",
        "depth_camera_info": "front/depth/camera_info",
        "depth_points": "cloud",
        "labels": "front/labels",
    }


def test_camera_name_is_by_default_that_of_the_sensor() -> None:
    assert (
        topics("camera", plugin=a_sensor_plugin("gazebo_ros_camera"))["image_raw"] == "s/image_raw"
    )


def test_camera_of_ros_1_has_a_tag_for_each_topic() -> None:
    tags = """<cameraName>kinect</cameraName><imageTopicName>rgb/image_raw</imageTopicName>
    <cameraInfoTopicName>rgb/camera_info</cameraInfoTopicName>
    <depthImageTopicName>depth/image</depthImageTopicName>
    <depthImageCameraInfoTopicName>depth/info</depthImageCameraInfoTopicName>
    <pointCloudTopicName>cloud</pointCloudTopicName>"""

    found = topics("depth", plugin=a_sensor_plugin("gazebo_ros_openni_kinect", tags))

    assert [found[one] for one in ("image_raw", "camera_info", "depth_image")] == [
        "kinect/rgb/image_raw",
        "kinect/rgb/camera_info",
        "kinect/depth/image",
    ]
    assert (found["depth_camera_info"], found["depth_points"]) == (
        "kinect/depth/info",
        "kinect/cloud",
    )


@pytest.mark.parametrize(
    ("filename", "kind", "tags", "expected"),
    [
        ("gazebo_ros_laser", "ray", "<topicName>front/scan</topicName>", {"scan": "front/scan"}),
        ("gazebo_ros_gpu_laser", "gpu_ray", "<topicName>scan</topicName>", {"scan": "scan"}),
        ("gazebo_ros_block_laser", "ray", "<topicName>cloud</topicName>", {"point_cloud": "cloud"}),
        ("gazebo_ros_velodyne_laser", "ray", "<topicName>velo</topicName>", {"points": "velo"}),
        ("gazebo_ros_range", "ray", "<topicName>sonar</topicName>", {"range": "sonar"}),
        ("hector_gazebo_ros_sonar", "ray", "<topicName>sonar</topicName>", {"range": "sonar"}),
        ("gazebo_ros_imu_sensor", "imu", "<topicName>imu/data</topicName>", {"imu": "imu/data"}),
        (
            "gazebo_ros_bumper",
            "contact",
            "<bumperTopicName>hit</bumperTopicName>",
            {"bumper_states": "hit"},
        ),
    ],
)  # fmt: skip
def test_plugin_of_ros_1_names_its_topic(
    filename: str, kind: str, tags: str, expected: dict[str, str]
) -> None:
    assert topics(kind, plugin=a_sensor_plugin(filename, tags)) == expected


def test_topic_of_gz_is_ignored_where_a_plugin_names_it() -> None:
    model = a_model_with(
        a_sensor("imu", "<topic>other</topic>", plugin=a_sensor_plugin("gazebo_ros_imu_sensor"))
    )

    assert topics_of(model.sensors[0]) == {"imu": "driver/out"}
    assert mentions(model.report, "ignored", "<topic>", "plug-in")


@pytest.mark.parametrize("topic", ["/scan", "/robot/scan"])
def test_absolute_topic_is_read_below_the_namespace_with_a_warning(topic: str) -> None:
    model = a_model_with(a_sensor("ray", f"<topic>{topic}</topic>"))

    assert topics_of(model.sensors[0]) == {"scan": topic[1:]}
    assert mentions(model.report, "suspicious", f"'{topic}'", "namespace")


@pytest.mark.parametrize(
    ("topic", "name"),
    [("scan-front", "scan_front"), ("1st/scan", "s_1st/scan"), ("a//b", "a/b"), ("x y", "x_y")],
)
def test_invalid_topic_is_made_valid_and_reported(topic: str, name: str) -> None:
    model = a_model_with(a_sensor("ray", f"<topic>{topic}</topic>"))

    assert topics_of(model.sensors[0]) == {"scan": name}
    assert mentions(model.report, "suspicious", f"'{topic}'", f"'{name}'")


def test_topic_that_is_too_long_leaves_the_sensor_out() -> None:
    model = a_model_with(a_sensor("ray", f"<topic>{'/'.join(['abcdefgh'] * 12)}</topic>"))

    assert model.sensors[0].settings is None
    assert mentions(model.report, "suspicious", "characters")


def test_arguments_of_launch_files_are_left_out() -> None:
    assert topics("ray", "<topic>$(arg ns)/scan</topic>") == {"scan": "scan"}


def test_sensors_without_names_publish_below_their_names() -> None:
    model = a_model_with(*(a_sensor("contact", name=f"bumper_{side}") for side in ("l", "r")))

    assert [topics_of(one)["bumper_states"] for one in model.sensors] == [
        "bumper_l/bumper_states",
        "bumper_r/bumper_states",
    ]
    assert not mentions(model.report, "suspicious", "topic")


def test_sensor_that_is_named_has_its_name_before_others_have_defaults() -> None:
    named = a_sensor("ray", "<topic>scan</topic>", name="laser")

    model = a_model_with(a_sensor("ray", name="cliff"), named)

    assert [topics_of(one)["scan"] for one in model.sensors] == ["cliff/scan", "scan"]


def test_topic_that_is_named_twice_is_used_once() -> None:
    sensors = [a_sensor("ray", "<topic>scan</topic>", name=name) for name in ("front", "rear")]

    model = a_model_with(*sensors)

    assert [topics_of(one)["scan"] for one in model.sensors] == ["scan", "rear/scan"]
    assert mentions(model.report, "suspicious", "'scan'", "'rear/scan'")


def test_sensors_of_one_name_never_share_a_topic() -> None:
    model = a_model_with(*[a_sensor("imu")] * 4)

    assert len({topics_of(one)["imu"] for one in model.sensors}) == 4


def test_rule_renames_the_topic_of_a_bumper() -> None:
    plugin = a_sensor_plugin("gazebo_ros_bumper", remapping("bumper_states:=hits"))

    assert topics("contact", plugin=plugin) == {"bumper_states": "hits"}


@pytest.mark.parametrize("topic", ["odom", "cmd_vel", "tf", "joint_states"])
def test_sensor_leaves_the_topics_of_a_drive_alone(topic: str) -> None:
    assert topics("ray", f"<topic>{topic}</topic>") == {"scan": f"s/{topic}"}


@pytest.mark.parametrize("kind", READERS)
def test_names_are_unique_within_a_sensor(kind: str) -> None:
    found = the_sensor(a_sensor(kind)).topics

    assert len({one.name for one in found}) == len(found)


@pytest.mark.parametrize(
    ("inside", "plugin", "expected"),
    [
        ("<camera><triggered>true</triggered></camera>", "", "s/image_trigger"),
        (
            "<camera><triggered>1</triggered><trigger_topic>shoot</trigger_topic></camera>",
            "",
            "s/shoot",
        ),
        (
            "<topic>cam/image</topic><camera><triggered>true</triggered></camera>",
            "",
            "cam/image/trigger",
        ),
        (
            "",
            a_sensor_plugin(
                "gazebo_ros_camera", "<camera_name>front</camera_name><triggered>true</triggered>"
            ),
            "front/image_trigger",
        ),
        (
            "",
            a_sensor_plugin(
                "gazebo_ros_triggered_camera", "<triggerTopicName>shoot</triggerTopicName>"
            ),
            "s/shoot",
        ),
    ],
)
def test_triggered_camera_has_a_topic_for_its_trigger(
    inside: str, plugin: str, expected: str
) -> None:
    assert topics("camera", inside, plugin=plugin)["image_trigger"] == expected


def test_camera_that_is_not_triggered_has_no_topic_for_triggers() -> None:
    assert "image_trigger" not in topics("camera", "<camera><triggered>0</triggered></camera>")
