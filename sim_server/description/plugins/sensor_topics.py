"""Topics of sensors: names by plug-in, by gz-sim's rules, or by default; remapping rules."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.sensor_messages import (
    CameraSensor,
    RaySensor,
    SensorSettings,
    SensorTopic,
)
from zensim.proto.names import RESERVED_NAMES
from zensim.proto.topic_catalog import TOPICS
from zensim.sim_server.description.plugins.drive_plugin import SUBSTITUTION
from zensim.sim_server.description.plugins.sensor_settings import TOPIC_OF_SETTINGS
from zensim.sim_server.description.plugins.sensor_tags import UnusableSensor, describe_sensor
from zensim.sim_server.description.strict_parsing import quote

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zensim.proto.messages.drive_messages import RosBlock
    from zensim.proto.messages.model_messages import Sensor
    from zensim.sim_server.description.plugins.sensor_tags import SensorSource
    from zensim.sim_server.description.report import ParseReport

TOPIC_OF_OUTPUT = {
    "LaserScan": "scan",
    "PointCloud2": "points",
    "PointCloud": "point_cloud",
    "Range": "range",
}
OUT = "~/out"
"""Name of the main topic of plug-ins of gazebo_ros."""
TOPIC_TAGS = ("topicName", "topic_name")
DRIVE_TOPICS = ("cmd_vel", "odom", "tf", "tf_static", "joint_states", "robot_description")
MAX_TOPIC_LENGTH = 100
_NO_LETTER = re.compile(r"[^A-Za-z0-9_]")
Named = tuple[str, str]
"""Topic of the catalog, and name, in which `~` is the node of the plug-in."""


def list_topics(
    source: SensorSource, settings: SensorSettings, ros: RosBlock
) -> tuple[SensorTopic, ...]:
    """List the topics of a sensor, below the namespace of its robot; no name means the default."""
    if isinstance(settings, CameraSensor):
        named = _list_camera_names(source, settings)
    elif isinstance(settings, RaySensor):
        named = _list_ray_names(source, settings)
    else:
        named = _list_plain_names(source, settings)
    return tuple(_name_topic(topic, name, source, ros) for topic, name in named)


def _name_topic(topic: str, name: str, source: SensorSource, ros: RosBlock) -> SensorTopic:
    resolved = _resolve(name or topic, source, ros)
    if not name and resolved == topic:
        return SensorTopic(topic, "")
    return SensorTopic(topic, _to_valid_name(resolved, source))


def find_message(topic: SensorTopic) -> str:
    """Find the type of the messages of a topic."""
    return TOPICS[topic.topic].messages[0].__name__


def describe_topic(topic: SensorTopic, namespace: str) -> str:
    """Write type and name of a topic of a sensor."""
    return f"{find_message(topic)} on {namespace}/{topic.name}"


def make_topics_unique(sensors: Sequence[Sensor], report: ParseReport) -> tuple[Sensor, ...]:
    """Name all topics, each once: those that the description names first, then defaults.

    A default name is that of the catalog, or below the sensor's name where several have it. A name
    that is given twice is below the sensor's name, too, and reported.
    """
    taken = set(DRIVE_TOPICS)
    named = [_keep_given_names(sensor, taken, report) for sensor in sensors]
    shared = Counter(one.topic for sensor in named for one in sensor.topics if not one.name)
    plain = {topic for topic, count in shared.items() if count == 1} - taken
    return tuple(_add_default_names(sensor, plain, taken) for sensor in named)


def _keep_given_names(sensor: Sensor, taken: set[str], report: ParseReport) -> Sensor:
    topics = []
    for topic in sensor.topics:
        name = topic.name
        if name in taken:
            name = _find_free_name(f"{to_path(sensor.name)}/{name}", taken)
            report.suspicious(
                describe_sensor(sensor.name, sensor.frame),
                f"topic {quote(topic.name)} is taken; {quote(name)} is used",
            )
        taken |= {name} - {""}
        topics.append(SensorTopic(topic.topic, name))
    return msgspec.structs.replace(sensor, topics=tuple(topics))


def _add_default_names(sensor: Sensor, plain: set[str], taken: set[str]) -> Sensor:
    topics = []
    for topic in sensor.topics:
        name = topic.name or (
            topic.topic
            if topic.topic in plain
            else _find_free_name(f"{to_path(sensor.name)}/{topic.topic}", taken)
        )
        taken.add(name)
        topics.append(SensorTopic(topic.topic, name))
    return msgspec.structs.replace(sensor, topics=tuple(topics))


def _find_free_name(name: str, taken: set[str]) -> str:
    numbered = (f"{name}_{number}" for number in range(1, len(taken) + 2))
    return name if name not in taken else next(one for one in numbered if one not in taken)


def _list_ray_names(source: SensorSource, settings: RaySensor) -> list[Named]:
    topic = TOPIC_OF_OUTPUT[settings.output]
    if source.plugin is not None:
        return [(topic, source.written(*TOPIC_TAGS, default=_default_of_plugin(source)))]
    name = _read_gz_topic(source)
    if settings.output == "PointCloud2":
        return [("scan", name), (topic, f"{name}/points" if name else "")]
    return [(topic, name)]


def _list_plain_names(source: SensorSource, settings: SensorSettings) -> list[Named]:
    topic = TOPIC_OF_SETTINGS[type(settings)]
    if source.plugin is None:
        name = _read_gz_topic(source)
        return [(topic, name), ("vel", "")] if topic == "fix" and not name else [(topic, name)]
    default = _default_of_plugin(source)
    name = source.written(*TOPIC_TAGS, "bumperTopicName", default=default)
    if topic != "fix":
        return [(topic, name)]
    speed = source.written("velocityTopicName", default="~/vel" if default else "")
    return [(topic, name), ("vel", speed)]


def _default_of_plugin(source: SensorSource) -> str:
    """Find the name where a plug-in names none: `~/out` for some of ROS 2, else the default."""
    filename = source.plugin.filename if source.plugin else ""
    uses_out = ("gazebo_ros_ray_sensor", "gazebo_ros_imu_sensor", "gazebo_ros_gps_sensor")
    return OUT if any(name in filename for name in uses_out) else ""


def _read_gz_topic(source: SensorSource) -> str:
    paths = ("topic", f"{source.kind}/topic", "contact/topic", "ray/topic", "lidar/topic")
    return next((text for path in paths if (text := source.tags.text(path, ""))), "")


def _list_camera_names(source: SensorSource, settings: CameraSensor) -> list[Named]:
    if source.plugin is None:
        name = _read_gz_topic(source)
        names = _name_gz_camera(source, settings, name) if name else _name_camera(source, settings)
    else:
        names = _name_plugin_camera(source, settings)
    wanted = {"rgb": COLOUR_TOPICS, "depth": DEPTH_TOPICS, "rgbd": COLOUR_TOPICS + DEPTH_TOPICS}
    shown = (*wanted[settings.kind], "labels", *(["image_trigger"] * settings.is_triggered))
    return [(topic, names[topic]) for topic in shown if topic in names]


COLOUR_TOPICS = ("image_raw", "image_compressed", "camera_info")
DEPTH_TOPICS = ("depth_image", "depth_camera_info", "depth_points")


def _name_camera(source: SensorSource, settings: CameraSensor) -> dict[str, str]:
    """Name the topics as gazebo_ros does, below the camera's name."""
    del settings
    trigger = source.tags.text("camera/trigger_topic", "image_trigger")
    return _join_names(to_path(source.name), trigger=trigger)


def _join_names(
    camera: str,
    image: str = "image_raw",
    info: str = "camera_info",
    depth: tuple[str, str, str] = ("depth/image_raw", "depth/camera_info", "points"),
    *,
    trigger: str = "image_trigger",
) -> dict[str, str]:
    names = {
        "image_raw": image,
        "image_compressed": f"{image}/compressed",
        "camera_info": info,
        "depth_image": depth[0],
        "depth_camera_info": depth[1],
        "depth_points": depth[2],
        "labels": "labels",
        "image_trigger": trigger,
    }
    return {
        topic: name if name.startswith("/") else f"{camera}/{name}".strip("/")
        for topic, name in names.items()
    }


def _name_plugin_camera(source: SensorSource, settings: CameraSensor) -> dict[str, str]:
    """Name the topics below `camera_name`; those of ROS 1 have tags for each."""
    del settings
    camera = source.written("camera_name", "cameraName") or source.name.partition("/")[0]
    if source.kind == "multicamera":
        camera = f"{camera}/{source.name.rpartition('/')[2]}"
    return _join_names(
        to_path(SUBSTITUTION.sub("", camera)),
        source.written("imageTopicName", default="image_raw"),
        source.written("cameraInfoTopicName", default="camera_info"),
        (
            source.written("depthImageTopicName", default="depth/image_raw"),
            source.written(
                "depthImageCameraInfoTopicName",
                "depthImageInfoTopicName",
                default="depth/camera_info",
            ),
            source.written("pointCloudTopicName", default="points"),
        ),
        trigger=source.written("triggerTopicName", default="image_trigger"),
    )


def _name_gz_camera(source: SensorSource, settings: CameraSensor, name: str) -> dict[str, str]:
    """Name the topics as gz-sensors does."""
    above = name.rpartition("/")[0]
    beside = f"{above}/" if above else ""
    info = source.tags.text("camera/camera_info_topic", f"{beside}camera_info")
    trigger = source.tags.text("camera/trigger_topic", f"{name}/trigger")
    if settings.kind == "rgbd":
        return {
            "image_raw": f"{name}/image",
            "image_compressed": f"{name}/image/compressed",
            "camera_info": source.tags.text("camera/camera_info_topic", f"{name}/camera_info"),
            "depth_image": f"{name}/depth_image",
            "depth_points": f"{name}/points",
            "labels": f"{name}/labels",
            "image_trigger": trigger,
        }
    if settings.kind == "depth":
        return {
            "depth_image": name,
            "depth_camera_info": info,
            "depth_points": f"{name}/points",
            "labels": f"{beside}labels",
            "image_trigger": trigger,
        }
    return {
        "image_raw": name,
        "image_compressed": f"{name}/compressed",
        "camera_info": info,
        "labels": f"{beside}labels",
        "image_trigger": trigger,
    }


def _resolve(name: str, source: SensorSource, ros: RosBlock) -> str:
    """Apply the first matching rule, as the node of the plug-in would."""
    wanted = _expand(name, source.node)
    for rule in ros.remappings:
        old, _, new = (part.strip() for part in rule.partition(":="))
        if _expand(old, source.node) == wanted:
            return _expand(new, source.node)
    return wanted


def _expand(name: str, node: str) -> str:
    if name.startswith("~"):
        return f"{node}/{name[1:].lstrip('/')}".strip("/")
    return name


def _to_valid_name(name: str, source: SensorSource) -> str:
    """Make a name valid below the robot's namespace, and report what is changed."""
    written = SUBSTITUTION.sub("", name)
    valid = to_path(written) or to_path(source.name)
    if len(valid) > MAX_TOPIC_LENGTH:
        raise UnusableSensor(
            f"topic {quote(name)} has {len(valid)} characters; use at most {MAX_TOPIC_LENGTH}"
        )
    if written.startswith("/") and not name.startswith(("$", "{")):
        source.report.suspicious(
            source.subject,
            f"topic {quote(name)} is read as {quote(valid)} below the robot's namespace, so that "
            "robots do not share it",
        )
    elif valid != written.strip("/"):
        source.report.suspicious(
            source.subject, f"topic {quote(name)} is not a ROS name; {quote(valid)} is used"
        )
    return valid


def to_path(text: str) -> str:
    """Make chunks of a topic of any text valid."""
    return "/".join(to_chunk(chunk) for chunk in text.split("/") if chunk)


def to_chunk(text: str) -> str:
    """Make a valid chunk of a topic from any text."""
    chunk = _NO_LETTER.sub("_", text)[:64]
    if not chunk[:1].isalpha() or chunk in RESERVED_NAMES:
        chunk = f"s_{chunk}"[:64]
    return chunk
