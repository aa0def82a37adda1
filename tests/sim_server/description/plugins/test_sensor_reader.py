"""Sensors keep their settings, are placed in moving links, and are reported."""

import re

import pytest

from tests.contract.repository import ROOT
from tests.sim_server.description.plugins.sensor_samples import (
    MAST_HEIGHT_M,
    a_model,
    a_model_with,
    a_sensor,
    a_sensor_plugin,
    the_sensor,
    topics_of,
)
from tests.sim_server.description.robots import (
    a_joint,
    a_link,
    a_reference,
    an_inertial,
    mentions,
    subjects,
)
from zensim.proto.messages.drive_messages import RosBlock
from zensim.proto.messages.model_messages import Frame, Origin, Parameter
from zensim.proto.messages.sensor_messages import CameraSensor, ContactSensor, ImuSensor, RaySensor
from zensim.sim_server.description.plugins.sensor_reader import (
    MAX_PARAMETERS,
    MAX_SENSORS,
    find_data_origin,
)
from zensim.sim_server.errors import ModelError

SUBJECT = "sensor 's' on 'mast'"
LIDAR = """
<sensor type="gpu_ray" name="lidar">
  <pose>0 0 0.1 0 0 0</pose><update_rate>5</update_rate><always_on>true</always_on>
  <ray><scan><horizontal><samples>360</samples><min_angle>-3</min_angle><max_angle>3</max_angle>
  </horizontal></scan><range><min>0.1</min><max>8</max></range></ray>
  <plugin name="scan" filename="libgazebo_ros_ray_sensor.so">
    <ros><namespace>/r1</namespace><remapping>~/out:=scan</remapping></ros>
    <output_type>sensor_msgs/LaserScan</output_type><frame_name>lidar_link</frame_name>
  </plugin>
</sensor>
"""


def test_sensor_is_placed_in_the_merged_link() -> None:
    lidar = the_sensor(LIDAR)

    assert (lidar.name, lidar.kind, lidar.update_rate_hz) == ("lidar", "gpu_ray", 5.0)
    assert (lidar.link, lidar.frame) == ("base", "mast")
    assert lidar.origin == Origin((1.0, 0.0, MAST_HEIGHT_M + 0.1))


def test_sensor_keeps_its_plugin_and_every_setting() -> None:
    lidar = the_sensor(LIDAR)

    assert lidar.plugin == "libgazebo_ros_ray_sensor.so"
    assert lidar.ros == RosBlock("r1", ("~/out:=scan",))
    assert Parameter("ray/scan/horizontal/samples", "360") in lidar.parameters
    assert Parameter("plugin/frame_name", "lidar_link") in lidar.parameters


def test_report_says_topic_type_frame_rate_and_cost_of_a_sensor() -> None:
    report = a_model_with(LIDAR).report

    assert mentions(
        report, "applied", "sensor 'lidar'", "LaserScan on <namespace>/scan", "'lidar_link'",
        "5 Hz", "% of a core", "collisions, not visuals",
    )  # fmt: skip


@pytest.mark.parametrize(
    "kind",
    [
        *("ray", "gpu_ray", "lidar", "gpu_lidar", "sonar", "imu", "contact", "gps", "navsat"),
        *(
            "altimeter",
            "magnetometer",
            "air_pressure",
            "camera",
            "depth",
            "depth_camera",
            "rgbd_camera",
        ),
    ],
)
def test_kind_of_sensor_gets_topics_and_a_frame(kind: str) -> None:
    sensor = the_sensor(a_sensor(kind))

    assert sensor.settings is not None
    assert sensor.topics
    assert sensor.frame_id == ("world" if kind == "contact" else "mast")


@pytest.mark.parametrize("kind", ["air_speed", "force_torque", "logical_camera", "thermal"])
def test_kind_that_is_not_simulated_is_reported(kind: str) -> None:
    model = a_model_with(a_sensor(kind, "<update_rate>5</update_rate><any/>"))

    assert subjects(model.report, "ignored") == [SUBJECT]
    assert [(one.kind, one.settings, one.topics) for one in model.sensors] == [(kind, None, ())]


def test_unknown_sensor_is_reported() -> None:
    model = a_model_with(a_sensor("crystal_ball"))

    assert subjects(model.report, "unknown") == [SUBJECT]
    assert mentions(model.report, "unknown", "'crystal_ball'")
    assert [sensor.kind for sensor in model.sensors] == ["crystal_ball"]


@pytest.mark.parametrize(
    ("inside", "slug"),
    [
        ("<update_rate>fast</update_rate>", "sensor.update_rate"),
        ("<update_rate>nan</update_rate>", "sensor.update_rate"),
        ("<pose>0 0 0</pose>", "sensor.pose"),
        ("<pose>0 0 0 0 0 nan</pose>", "sensor.pose"),
        ("<ray><range><min>near</min></range></ray>", "sensor.min"),
    ],
)
def test_sensor_is_refused_when_a_number_is_invalid(inside: str, slug: str) -> None:
    with pytest.raises(ModelError, match="sensor 's'") as caught:
        a_model_with(a_sensor("ray", inside))

    assert caught.value.slug == slug


@pytest.mark.parametrize(
    "inside",
    [
        "<samples>0</samples>",
        "<samples>-5</samples>",
        "<samples>1e9</samples>",
        "<samples>inf</samples>",
        "<samples>nan</samples>",
        "<samples>2.5</samples>",
        "<resolution>0</resolution>",
        "<min_angle>-1</min_angle><max_angle>inf</max_angle>",
        "<min_angle>-100</min_angle><max_angle>100</max_angle>",
    ],
)
def test_impossible_rays_leave_a_sensor_out(inside: str) -> None:
    sweep = f"<ray><scan><horizontal>{inside}</horizontal></scan></ray>"

    model = a_model_with(a_sensor("ray", sweep))

    assert subjects(model.report, "suspicious") == [SUBJECT]
    assert [(one.settings, one.topics) for one in model.sensors] == [(None, ())]


@pytest.mark.parametrize(
    ("kind", "inside"),
    [
        ("ray", "<ray><range><min>3</min><max>2</max></range></ray>"),
        ("ray", "<ray><range><min>-1</min><max>2</max></range></ray>"),
        ("camera", "<camera><image><width>0</width></image></camera>"),
        ("camera", "<camera><image><width>1e6</width><height>1e6</height></image></camera>"),
        ("camera", "<camera><clip><near>2</near><far>1</far></clip></camera>"),
        ("camera", "<camera><horizontal_fov>4</horizontal_fov></camera>"),
        ("sonar", "<sonar><min>2</min><max>1</max><radius>0.1</radius></sonar>"),
        ("imu", "<imu><angular_velocity><x><noise type='gaussian'><stddev>nan</stddev></noise></x>"
         "</angular_velocity></imu>"),
    ],
)  # fmt: skip
def test_impossible_settings_leave_a_sensor_out(kind: str, inside: str) -> None:
    model = a_model_with(a_sensor(kind, inside))

    assert SUBJECT in subjects(model.report, "suspicious")
    assert model.sensors[0].settings is None


def test_negative_rate_is_reported() -> None:
    model = a_model_with(a_sensor("imu", "<update_rate>-5</update_rate>"))

    assert model.sensors[0].update_rate_hz == 0.0
    assert mentions(model.report, "suspicious", "<update_rate>", "-5")


def test_sensor_keeps_a_limited_number_of_settings() -> None:
    model = a_model_with(a_sensor("imu", "<a/>" * 500))

    assert len(model.sensors[0].parameters) == MAX_PARAMETERS
    assert mentions(model.report, "suspicious", "sensor 's'", "500", str(MAX_PARAMETERS))


def test_robot_with_a_thousand_sensors_is_refused_by_a_limit() -> None:
    with pytest.raises(ModelError, match=str(MAX_SENSORS)) as caught:
        a_model_with(a_sensor("imu") * 1000)

    assert caught.value.slug == "sensor.count"


@pytest.mark.parametrize(
    ("tag", "value"), [("always_on", "0"), ("visualize", "1"), ("enable_metrics", "true")]
)
def test_known_tag_without_effect_is_ignored(tag: str, value: str) -> None:
    report = a_model_with(a_sensor("imu", f"<{tag}>{value}</{tag}>")).report

    assert subjects(report, "ignored") == [f"{SUBJECT}: <{tag}>"]


def test_sensor_that_is_always_on_is_as_asked_for() -> None:
    report = a_model_with(a_sensor("imu", "<always_on>true</always_on>")).report

    assert subjects(report, "ignored") == []


def test_unknown_tag_is_reported() -> None:
    report = a_model_with(a_sensor("imu", "<update_rte>1</update_rte><zebra>1</zebra>")).report

    assert subjects(report, "suspicious") == [f"{SUBJECT}: <update_rte>"]
    assert subjects(report, "unknown") == [f"{SUBJECT}: <zebra>"]


def test_unknown_plugin_of_a_sensor_is_reported_and_the_sensor_works() -> None:
    model = a_model_with(a_sensor("imu", plugin=a_sensor_plugin("my_imu")))

    assert mentions(model.report, "unknown", SUBJECT, "libmy_imu.so")
    assert topics_of(model.sensors[0]) == {"imu": "imu"}


FRAME = "<frame_name>{}</frame_name>"


def with_frame(name: str, kind: str = "imu", inside: str = "") -> str:
    plugin = a_sensor_plugin("gazebo_ros_imu_sensor", FRAME.format(name))
    return a_sensor(kind, inside, plugin=plugin)


def test_frame_of_the_plugin_comes_before_others() -> None:
    inside = "<frame_id>base</frame_id>"

    assert the_sensor(with_frame("optical", inside=inside)).frame_id == "optical"
    assert the_sensor(a_sensor("imu", inside)).frame_id == "base"
    assert the_sensor(a_sensor("imu", "<gz_frame_id>base</gz_frame_id>")).frame_id == "base"


def test_frame_is_the_link_of_the_description_and_with_compat_the_moving_one() -> None:
    assert the_sensor(a_sensor("imu")).frame_id == "mast"
    assert the_sensor(a_sensor("imu"), compat="gazebo11").frame_id == "base"


def test_frame_that_no_link_has_is_a_static_transform_at_the_sensor() -> None:
    model = a_model_with(with_frame("imu_frame", inside="<pose>0 0 0.1 0 0 0</pose>"))

    at = Origin((1.0, 0.0, MAST_HEIGHT_M + 0.1))
    assert model.sensors[0].frame_id == "imu_frame"
    assert Frame("imu_frame", "base", at) in model.frames
    assert mentions(model.report, "suspicious", "'imu_frame'")


def test_frame_that_no_link_has_is_only_reported_with_compat() -> None:
    model = a_model_with(with_frame("imu_frame"), compat="gazebo11")

    assert "imu_frame" not in {frame.name for frame in model.frames}
    assert mentions(model.report, "suspicious", "'imu_frame'")


def test_two_sensors_with_one_unknown_frame_add_it_once() -> None:
    model = a_model_with(with_frame("imu_frame"), with_frame("imu_frame"))

    assert [frame.name for frame in model.frames].count("imu_frame") == 1


@pytest.mark.parametrize("frame", ["/mast", "r1/mast", "$(arg prefix)mast", "${ns}/mast"])
def test_prefix_of_a_frame_is_left_out(frame: str) -> None:
    assert the_sensor(with_frame(frame)).frame_id == "mast"


@pytest.mark.parametrize("frame", ["world", "odom", "map"])
def test_frame_of_a_world_is_not_a_frame_of_a_sensor(frame: str) -> None:
    model = a_model_with(with_frame(frame))

    assert model.sensors[0].frame_id == "mast"
    assert mentions(model.report, "suspicious", f"'{frame}'")


def test_sensor_with_a_pose_whose_frame_is_its_link_is_suspicious() -> None:
    report = a_model_with(a_sensor("imu", "<pose>0 0 0.1 0 0 0</pose>")).report

    assert mentions(report, "suspicious", SUBJECT, "0 0 0.1 m")


def test_depth_camera_whose_frame_is_not_optical_is_suspicious() -> None:
    optical = "<camera><optical_frame_id>optical</optical_frame_id></camera>"

    assert mentions(a_model_with(a_sensor("rgbd_camera")).report, "suspicious", "optical axes")
    assert subjects(a_model_with(a_sensor("rgbd_camera", optical)).report, "suspicious") == []


def test_frame_behind_a_kept_fixed_joint_does_not_move() -> None:
    kept = a_reference("o", "<preserveFixedJoint>true</preserveFixedJoint>")
    optical = "<camera><optical_frame_id>optical</optical_frame_id></camera>"

    model = a_model(kept, a_reference("mast", a_sensor("rgbd_camera", optical)))

    assert "optical" in {link.name for link in model.links}
    assert not mentions(model.report, "suspicious", SUBJECT)


def test_frame_that_moves_relative_to_the_sensor_is_suspicious() -> None:
    arm = a_link("arm", an_inertial()) + a_joint("a", ("base", "arm"), "continuous")

    model = a_model(arm, a_reference("mast", a_sensor("imu", "<frame_id>arm</frame_id>")))

    assert mentions(model.report, "suspicious", SUBJECT, "'arm' moves")


def test_lens_of_a_wide_angle_camera_is_reported() -> None:
    lens = "<camera><lens><type>gnomonical</type></lens></camera>"

    report = a_model_with(a_sensor("wideanglecamera", lens)).report

    assert mentions(report, "suspicious", SUBJECT, "lens")
    assert mentions(report, "ignored", "<camera/lens/type>")


def test_frame_that_no_link_has_of_a_camera_is_optical() -> None:
    inside = "<camera><optical_frame_id>lens</optical_frame_id></camera>"

    model = a_model_with(a_sensor("camera", inside))

    (lens,) = (frame for frame in model.frames if frame.name == "lens")
    assert lens.origin == find_data_origin(model.sensors[0])
    assert lens.origin.orientation == pytest.approx((-0.5, 0.5, -0.5, 0.5))


def test_ray_sees_its_own_robot_when_asked_to_and_with_compat() -> None:
    asked = a_sensor("ray", "<sees_itself>true</sees_itself>")

    for sensor, compat, expected in (
        (a_sensor("ray"), "fixed", False),
        (asked, "fixed", True),
        (a_sensor("ray"), "gazebo11", True),
        (a_sensor("gpu_ray"), "gazebo11", False),
    ):
        settings = the_sensor(sensor, compat=compat).settings
        assert isinstance(settings, RaySensor)
        assert settings.sees_itself is expected


@pytest.mark.parametrize("tag", ["zensim:sees_itself", "sees_itself"])
def test_tag_of_the_zensim_namespace_is_read(tag: str) -> None:
    settings = the_sensor(a_sensor("ray", f"<{tag}>1</{tag}>")).settings

    assert isinstance(settings, RaySensor)
    assert settings.sees_itself


def test_lidar_of_the_documentation_is_read() -> None:
    page = (ROOT / "docs" / "sensors.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```xml\n(.*?)```", page, re.DOTALL)
    assert len(block.splitlines()) == 5

    model = a_model(block.replace("laser_link", "mast"))

    assert isinstance(found := model.sensors[0].settings, RaySensor)
    assert (found.horizontal.count, found.range_max_m) == (360, 12.0)
    assert topics_of(model.sensors[0]) == {"scan": "scan"}
    assert subjects(model.report, "suspicious") == []


@pytest.mark.parametrize("compat", ["fixed", "gazebo11"])
def test_sensor_keeps_compat(compat: str) -> None:
    assert the_sensor(a_sensor("imu"), compat=compat).compat == compat


HECTOR_IMU = """<gazebo><plugin name="imu_plugin" filename="libhector_gazebo_ros_imu.so">
<bodyName>mast</bodyName><topicName>imu/data</topicName><updateRate>50</updateRate>
<accelGaussianNoise>0.1 0.2 0.3</accelGaussianNoise><rateGaussianNoise>0.01</rateGaussianNoise>
<accelDrift>0.5</accelDrift><accelDriftFrequency>0.1</accelDriftFrequency>
<xyzOffset>0 0 0.1</xyzOffset></plugin></gazebo>"""


def test_plugin_of_a_model_that_is_a_sensor_is_read() -> None:
    model = a_model(HECTOR_IMU)

    (imu,) = model.sensors
    assert (imu.kind, imu.frame, imu.update_rate_hz) == ("imu", "mast", 50.0)
    assert imu.origin == Origin((1.0, 0.0, MAST_HEIGHT_M + 0.1))
    assert topics_of(imu) == {"imu": "imu/data"}
    assert subjects(model.report, "unknown") == []


def test_noise_of_hector_is_read() -> None:
    (imu,) = a_model(HECTOR_IMU).sensors

    assert isinstance(imu.settings, ImuSensor)
    x, _, z = imu.settings.linear_acceleration
    assert (x.kind, x.stddev, z.stddev) == ("gaussian", 0.1, 0.3)
    assert x.dynamic_bias_correlation_time_s == pytest.approx(10.0)
    # The stationary spread of the walk is the drift: sigma^2 tau / 2.
    assert x.dynamic_bias_stddev**2 * 10.0 / 2.0 == pytest.approx(0.5**2)
    assert [one.stddev for one in imu.settings.angular_velocity] == [0.01] * 3


def test_plugin_of_a_model_on_a_link_that_does_not_exist_is_reported() -> None:
    model = a_model(HECTOR_IMU.replace("<bodyName>mast", "<bodyName>moon"))

    assert model.sensors == ()
    assert mentions(model.report, "suspicious", "'moon'")


def test_contact_sensor_without_names_watches_its_link() -> None:
    settings = the_sensor(a_sensor("contact")).settings

    assert settings == ContactSensor(
        collisions=((0, 1), (0, 2)),
        names=(
            "base::base_fixed_joint_lump__mast_collision",
            "base::base_fixed_joint_lump__mast_collision_1",
        ),
    )


def test_contact_sensor_with_an_unknown_collision_is_suspicious() -> None:
    contact = "<contact><collision>moon_collision</collision></contact>"

    model = a_model_with(a_sensor("contact", contact))

    assert model.sensors[0].settings == ContactSensor()
    assert mentions(model.report, "suspicious", "'moon_collision'", "mast_collision")


def test_sensor_of_a_world_frame_keeps_no_static_transform() -> None:
    plugin = a_sensor_plugin("gazebo_ros_bumper", "<frame_name>map</frame_name>")

    model = a_model_with(a_sensor("contact", plugin=plugin))

    assert model.sensors[0].frame_id == "map"
    assert "map" not in {frame.name for frame in model.frames}


def test_stereo_camera_is_two_sensors() -> None:
    cameras = "".join(
        f'<camera name="{side}"><pose>0 {y} 0 0 0 0</pose><image><width>64</width>'
        f"<height>48</height></image></camera>"
        for side, y in (("left", 0.1), ("right", -0.1))
    )
    tags = "<camera_name>stereo</camera_name><hackBaseline>0.2</hackBaseline>"
    plugin = a_sensor_plugin("gazebo_ros_multicamera", tags)

    model = a_model_with(a_sensor("multicamera", cameras, plugin=plugin))

    assert [one.name for one in model.sensors] == ["s/left", "s/right"]
    assert [one.origin.position[1] for one in model.sensors] == [0.1, -0.1]
    settings = [one.settings for one in model.sensors if isinstance(one.settings, CameraSensor)]
    assert [one.stereo_baseline_m for one in settings] == [0.0, 0.2]
    assert [topics_of(one)["image_raw"] for one in model.sensors] == [
        "stereo/left/image_raw",
        "stereo/right/image_raw",
    ]


def test_model_without_sensors_has_no_entries_of_sensors() -> None:
    report = a_model(a_reference("mast", "<mu1>1</mu1>")).report

    assert not any(entry.subject.startswith("sensor") for entry in report)
