"""Sensors of a description: <sensor> elements and plug-ins that are sensors, and their report."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.messages.drive_messages import RosBlock
from zensim.proto.messages.model_messages import (
    Frame,
    Model,
    Origin,
    Parameter,
    ReportEntry,
    Sensor,
    Vec3,
)
from zensim.proto.messages.sensor_messages import (
    CameraSensor,
    ContactSensor,
    RaySensor,
    SensorSettings,
)
from zensim.proto.names import InvalidName, check_frame
from zensim.proto.rigid_transforms import OPTICAL_AXES, compose, conjugate, multiply, rotate
from zensim.sim_server.description.collision_names import find_collisions, find_collisions_of_link
from zensim.sim_server.description.model_geometry import make_origin
from zensim.sim_server.description.plugins.drive_plugin import SUBSTITUTION
from zensim.sim_server.description.plugins.plugin_tags import PluginTags, read_ros_block
from zensim.sim_server.description.plugins.sensor_settings import READERS, read_settings
from zensim.sim_server.description.plugins.sensor_tags import (
    PLUGIN_TAG,
    SensorElement,
    SensorSource,
    UnusableSensor,
    describe_sensor,
    list_sensor_plugin_tags,
    list_sensor_tags,
    list_settings,
    read_value,
)
from zensim.sim_server.description.plugins.sensor_topics import (
    describe_topic,
    list_topics,
    make_topics_unique,
)
from zensim.sim_server.description.report import ParseReport
from zensim.sim_server.description.strict_parsing import quote, read_numbers
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from lxml.etree import _Element as Element

    from zensim.proto.messages.drive_messages import Compat
    from zensim.sim_server.description.joint_reduction import LumpedModel

MAX_SENSORS = 200
"""Sensors of one robot."""
MAX_PARAMETERS = 200
MAX_VALUE_LENGTH = 1000
NOT_SIMULATED = (
    "air_speed", "boundingbox", "custom", "environmental_sensor", "force_torque",
    "logical_camera", "rfid", "segmentation", "thermal",
    "wireless_receiver", "wireless_transmitter", "dvl",
)  # fmt: skip
"""Prefixes of Gazebo's other sensor types."""
SENSOR_PLUGINS = (
    "gazebo_ros_ray_sensor", "gazebo_ros_imu_sensor", "gazebo_ros_camera", "gazebo_ros_bumper",
    "gazebo_ros_gps_sensor", "gazebo_ros_laser", "gazebo_ros_gpu_laser", "gazebo_ros_block_laser",
    "gazebo_ros_velodyne", "gazebo_ros_range", "gazebo_ros_depth_camera", "gazebo_ros_imu",
    "gazebo_ros_openni_kinect", "gazebo_ros_multicamera", "gazebo_ros_triggered", "hector_gazebo",
)  # fmt: skip
"""Parts of the file names of plug-ins of <sensor> that are read."""
MODEL_PLUGINS = {
    "hector_gazebo_ros_imu": "imu",
    "gazebo_ros_imu": "imu",
    "hector_gazebo_ros_gps": "gps",
    "hector_gazebo_ros_magnetic": "magnetometer",
}
"""Kind of sensor that a plug-in of a model is, by part of its file name; of ROS 1."""
_ALWAYS = "every sensor publishes while it has a subscriber"
_NAMESPACE = "the namespace is set by the spawn request"
BODY_TAGS = ("bodyName", "body_name")
ALWAYS_ON_TAGS = ("always_on", "alwaysOn")
UNUSED_TAGS = {
    **dict.fromkeys(ALWAYS_ON_TAGS, _ALWAYS),
    "visualize": "the viewer draws sensors on request",
    "enable_metrics": "`zensim sensors` shows rates",
    "camera/save/path": "pictures are not saved",
    "camera/visibility_mask": "cameras see everything",
    "ray/visibility_mask": "rays hit every collision",
    "lidar/visibility_mask": "rays hit every collision",
    "camera/distortion/center": "images are not distorted",
    "camera/vertical_fov": "found from <horizontal_fov> and the size",
    "baseline": "disparities are not published",
    "camera/image/anti_aliasing": "not simulated",
    "camera/trigger_topic": "the camera is not triggered",
    "topic": "the plug-in names the topic",
    "gps/topic": "the plug-in names the topic",
    "imu/topic": "the plug-in names the topic",
    "ignition_frame_id": "another tag names the frame",
    "gz_frame_id": "another tag names the frame",
    "frame_id": "another tag names the frame",
    "camera/optical_frame_id": "another tag names the frame",
}
"""Known tags of <sensor> without effect, and the reason."""
UNUSED_PLUGIN_TAGS = {
    **dict.fromkeys(ALWAYS_ON_TAGS, _ALWAYS),
    **dict.fromkeys(("robotNamespace", "robot_namespace"), _NAMESPACE),
    **dict.fromkeys(
        ("serviceName", "service", "status", "interface:imu", "interface", "setIMURate"),
        "not simulated",
    ),
    **dict.fromkeys(
        (
            *("referenceLatitude", "referenceLongitude", "referenceHeading", "referenceAltitude"),
            *("magnitude", "declination", "inclination"),
        ),
        "the world says where it is and what its field is",
    ),
    **dict.fromkeys(
        (
            *("focal_length", "focalLength", "cx", "cy", "Cx", "Cy", "CxPrime", "cx_prime"),
            *("border_crop", "borderCrop", "autoDistortion", "auto_distortion"),
            *("Fx", "Fy", "fx", "fy"),
        ),
        "found from <horizontal_fov> and the size; images are not distorted",
    ),
    **dict.fromkeys(
        ("headingGaussianNoise", "headingDrift", "headingDriftFrequency", "headingOffset"),
        "orientation has no noise",
    ),
    **dict.fromkeys(("triggered", "triggerTopicName"), "only cameras are triggered"),
    **dict.fromkeys(("hokuyoMinIntensity", "organize_cloud"), "not simulated"),
    "baseline": "disparities are not published",
    **dict.fromkeys(BODY_TAGS, "the sensor is on the link of its element"),
    "fov": "the rays are those of <scan>",
    "depthImageTopicType": "depths are 32FC1",
}
FRAME_TAGS = ("frame_name", "frameName", "frameId", "frame_id")
"""Tags of plug-ins."""
FRAME_PATHS = ("camera/optical_frame_id", "frame_id", "gz_frame_id", "ignition_frame_id")
"""Paths of sensors."""
RATE_TAGS = ("updateRate", "update_rate", "updateRateHZ")
WORLD_FRAME = "world"
FOREIGN_FRAMES = (WORLD_FRAME, "map", "odom")
"""Frames of which a sensor's cannot be a child."""


def is_sensor_plugin(plugin: Element) -> bool:
    """Whether a plug-in of a model is a sensor."""
    return _find_plugin_kind(plugin) != ""


def read_sensors(
    tags: Iterable[SensorElement],
    plugins: Iterable[Element],
    lumped: LumpedModel,
    report: ParseReport,
) -> tuple[Sensor, ...]:
    """Read sensors; each is placed in the moving link that its link was merged into.

    `complete_sensors` adds what needs the whole model.

    Raises:
        ModelError: There are too many, or a value is not a number.
    """
    places = {link.name: (link.name, Origin()) for link in lumped.links}
    places |= {frame.name: (frame.parent, frame.origin) for frame in lumped.frames}
    given = [*tags, *_place_plugins(plugins, lumped, report)]
    if len(given) > MAX_SENSORS:
        raise ModelError(
            f"{len(given)} sensors; use at most {MAX_SENSORS} on one robot", slug="sensor.count"
        )
    found = [
        _read_sensor(tag, source, camera, places[tag.link])
        for tag in given
        for source, camera in _list_sources(tag, report)
    ]
    return make_topics_unique(found, report)


def _place_plugins(
    plugins: Iterable[Element], lumped: LumpedModel, report: ParseReport
) -> Iterator[SensorElement]:
    links = {link.name for link in lumped.links} | {frame.name for frame in lumped.frames}
    for plugin in plugins:
        body = next(filter(None, (plugin.findtext(tag) for tag in BODY_TAGS)), "").strip()
        if body and body not in links:
            report.suspicious(
                f"plugin {quote(plugin.get('name'))}", f"no sensor: {quote(body)} is not a link"
            )
        else:
            yield SensorElement(body or lumped.links[0].name, plugin)


def _list_sources(
    tag: SensorElement, report: ParseReport
) -> Iterator[tuple[SensorSource, Element | None]]:
    """List the tags of a sensor; of each of its cameras, if it has several."""
    element = tag.element
    cameras = element.findall("camera")
    if (element.get("type") or "") != "multicamera" or not cameras[1:]:
        yield _make_source(tag, None, report), None
        return
    for camera in cameras:
        yield _make_source(tag, camera, report), camera


def _make_source(tag: SensorElement, camera: Element | None, report: ParseReport) -> SensorSource:
    element = tag.element
    is_plugin = element.tag == PLUGIN_TAG
    kind = _find_plugin_kind(element) if is_plugin else element.get("type") or ""
    name = element.get("name") or kind
    if camera is not None:
        name = f"{name}/{camera.get('name') or 'camera'}"
    subject = describe_sensor(name, tag.link)
    plugin = element if is_plugin else _choose_plugin(element, subject, report)
    written = list_sensor_tags(tag, subject, camera)
    if is_plugin:
        written = written._replace(texts=(), bare=())
    return SensorSource(
        name=name[:MAX_VALUE_LENGTH],
        kind=kind[:MAX_VALUE_LENGTH],
        link=tag.link,
        tags=PluginTags(written, slug="sensor", aliases={}, report=report),
        plugin=None
        if plugin is None
        else PluginTags(
            list_sensor_plugin_tags(plugin, subject), slug="sensor", aliases={}, report=report
        ),
        node="" if plugin is None else plugin.get("name") or "",
    )


def _find_plugin_kind(plugin: Element) -> str:
    filename = plugin.get("filename") or ""
    return next((kind for part, kind in MODEL_PLUGINS.items() if part in filename), "")


def _choose_plugin(element: Element, subject: str, report: ParseReport) -> Element | None:
    """Choose the first plug-in that is known; others do not affect the sensor."""
    chosen = None
    for plugin in element.findall(PLUGIN_TAG):
        filename = plugin.get("filename") or ""
        if not any(known in filename for known in SENSOR_PLUGINS):
            report.unknown(
                f"{subject}: <plugin>", f"no plug-in has the file name {quote(filename)}"
            )
        elif chosen is None:
            chosen = plugin
        else:
            report.suspicious(f"{subject}: <plugin>", "a second one; the first is used")
    return chosen


def _read_sensor(
    tag: SensorElement, source: SensorSource, camera: Element | None, place: tuple[str, Origin]
) -> Sensor:
    link, origin = place
    if tag.element.tag == PLUGIN_TAG:
        for name in BODY_TAGS:  # They were read to place it.
            source.written(name)
    ros = _read_ros(tag.element, source)
    sensor = Sensor(
        name=source.name,
        kind=source.kind,
        link=link,
        frame=tag.link,
        origin=compose(origin, _read_origin(tag, source, camera)),
        update_rate_hz=_read_rate(source),
        plugin=source.plugin.filename[:MAX_VALUE_LENGTH] if source.plugin else "",
        ros=ros,
        parameters=_read_parameters(tag.element, source),
    )
    try:
        settings = read_settings(source)
        topics = list_topics(source, settings, ros) if settings else ()
    except UnusableSensor as fault:
        source.report.suspicious(source.subject, f"not simulated: {fault}")
        return sensor
    if settings is None:
        _report_not_simulated(source)
        return sensor
    frame = _read_frame(source, settings)
    _report_unread(source)
    return msgspec.structs.replace(sensor, settings=settings, topics=topics, frame_id=frame)


def _report_not_simulated(source: SensorSource) -> None:
    if source.kind.startswith(NOT_SIMULATED):
        source.report.ignored(source.subject, f"{quote(source.kind)} is known, not simulated")
    else:
        source.report.unknown(
            source.subject,
            f"unknown sensor type {quote(source.kind)}; known are {', '.join(READERS)}",
        )


def _report_unread(source: SensorSource) -> None:
    given = [tags for tags in (source.tags, source.plugin) if tags is not None]
    for tags in given:
        _take_always_on(tags)
    lenses = (name for name in source.tags.names() if name.startswith("camera/lens/"))
    source.tags.report_unread(UNUSED_TAGS | dict.fromkeys(lenses, "a pinhole is simulated"))
    if source.plugin is not None:
        source.plugin.report_unread(UNUSED_PLUGIN_TAGS)


def _take_always_on(tags: PluginTags) -> None:
    """Read the tag where it is true: it is as asked for."""
    for name in ALWAYS_ON_TAGS:
        if tags.is_true(name):
            tags.text(name, "")


def _read_ros(element: Element, source: SensorSource) -> RosBlock:
    plugin = element if element.tag == PLUGIN_TAG else element.find(PLUGIN_TAG)
    ros = plugin.find("ros") if plugin is not None else None
    if ros is None:
        return RosBlock()
    return read_ros_block(ros, subject=source.subject, report=source.report)


def _read_rate(source: SensorSource) -> float:
    """Read the rate [Hz]; that of a plug-in of ROS 1 limits that of the sensor."""
    given = [_read_number(source.tags, "update_rate")]
    if source.plugin is not None:
        given += [_read_number(source.plugin, tag) for tag in RATE_TAGS if source.plugin.has(tag)]
    for rate in given:
        if rate < 0.0:
            source.report.suspicious(
                f"{source.subject}: <update_rate>", f"{rate:g} is negative; every control step"
            )
    limits = [rate for rate in given if rate > 0.0]
    return min(limits, default=0.0)


def _read_number(tags: PluginTags, tag: str) -> float:
    try:
        found = read_value(tags, tag, 0.0)
    except UnusableSensor as fault:
        raise ModelError(f"{tags.subject}: {fault}", slug="sensor.update_rate") from fault
    return 0.0 if math.isinf(found) else found


def _read_origin(tag: SensorElement, source: SensorSource, camera: Element | None) -> Origin:
    """Read the pose in the link, and that of the camera in the sensor."""
    where, element, origin = f"{source.subject}, pose", tag.element, tag.origin
    if origin is None:
        origin = _to_origin(element.findtext("pose"), where)
    inner = element.find("camera") if camera is None else camera
    source.tags.text("camera/pose", "")
    if inner is not None:
        origin = compose(origin, _to_origin(inner.findtext("pose"), where))
    shift = source.written("xyzOffset", "xyzOffsets", "offset")
    turn = source.written("rpyOffset", "rpyOffsets")
    if element.tag == PLUGIN_TAG or shift or turn:
        origin = compose(origin, _to_origin(f"{shift or '0 0 0'} {turn or '0 0 0'}", where))
    return origin


def _to_origin(text: str | None, where: str) -> Origin:
    written = (text or "").strip() or "0 0 0 0 0 0"
    x, y, z, *rpy = read_numbers(written, counts=(6,), where=where, slug="sensor.pose")
    return make_origin((x, y, z), tuple(rpy))


def _read_frame(source: SensorSource, settings: SensorSettings) -> str:
    """Read the frame of the messages; empty where nothing names it."""
    texts = [source.written(*FRAME_TAGS), *(source.tags.text(path, "") for path in FRAME_PATHS)]
    text = next((one for one in texts if one), "")
    if not text and isinstance(settings, ContactSensor):
        return WORLD_FRAME
    bare = SUBSTITUTION.sub("", text).strip("/")
    if not bare:
        return ""
    try:
        return check_frame(bare)
    except InvalidName as error:
        source.report.suspicious(
            f"{source.subject}: <frame_name>", f"{error}; {quote(source.link)} is used"
        )
        return ""


def _read_parameters(element: Element, source: SensorSource) -> tuple[Parameter, ...]:
    found = list(list_settings(element))
    if len(found) > MAX_PARAMETERS:
        source.report.suspicious(
            source.subject, f"has {len(found)} settings; the first {MAX_PARAMETERS} are kept"
        )
    return tuple(
        Parameter(path[:MAX_VALUE_LENGTH], text[:MAX_VALUE_LENGTH])
        for path, text in found[:MAX_PARAMETERS]
    )


def complete_sensors(model: Model, compat: Compat) -> Model:
    """Complete the sensors of a model whose meshes are converted, and report each.

    Adds frames, collisions of contact sensors, and what `compat` changes.
    """
    if not model.sensors:
        return model
    report, frames, sensors = ParseReport(), list(model.frames), []
    for sensor in model.sensors:
        if sensor.settings is None:
            sensors.append(msgspec.structs.replace(sensor, compat=compat))
            continue
        completed = _complete_sensor(sensor, model, compat, report)
        if frame := _make_missing_frame(completed, model, frames, report):
            frames.append(frame)
        entry = make_sensor_entry(completed)
        report.applied(entry.subject, entry.reason)
        sensors.append(completed)
    return msgspec.structs.replace(
        model,
        sensors=tuple(sensors),
        frames=tuple(frames),
        report=(*model.report, *report.entries()),
    )


def _complete_sensor(sensor: Sensor, model: Model, compat: Compat, report: ParseReport) -> Sensor:
    settings = sensor.settings
    if isinstance(settings, ContactSensor):
        settings = _find_contact_collisions(sensor, settings, model, report)
    is_classic_ray = isinstance(settings, RaySensor) and not sensor.kind.startswith("gpu_")
    if isinstance(settings, RaySensor) and is_classic_ray and compat == "gazebo11":
        settings = msgspec.structs.replace(settings, sees_itself=True)
    return msgspec.structs.replace(
        sensor,
        settings=settings,
        frame_id=_find_frame(sensor, model, compat, report),
        compat=compat,
    )


def _find_contact_collisions(
    sensor: Sensor, settings: ContactSensor, model: Model, report: ParseReport
) -> ContactSensor:
    found: dict[tuple[int, int], None] = {}
    subject = describe_sensor(sensor.name, sensor.frame)
    for name in settings.names:
        indices = find_collisions(model, name)
        if not indices:
            known = ", ".join(
                quote(shape.name) for link in model.links for shape in link.collisions
            )
            report.suspicious(
                f"{subject}: <collision>", f"{quote(name)} is no collision; known are {known[:200]}"
            )
        found |= dict.fromkeys(indices)
    if not settings.names:
        found = dict.fromkeys(find_collisions_of_link(model, sensor.frame))
        if not found:
            report.suspicious(subject, f"link {quote(sensor.frame)} has no collision: no contacts")
    names = tuple(
        f"{model.links[link].name}::{model.links[link].collisions[at].name}" for link, at in found
    )
    return ContactSensor(collisions=tuple(found), names=names)


def _find_frame(sensor: Sensor, model: Model, compat: Compat, report: ParseReport) -> str:
    default = sensor.link if compat == "gazebo11" else sensor.frame
    if not sensor.frame_id or isinstance(sensor.settings, ContactSensor):
        return sensor.frame_id or default
    known = {link.name for link in model.links} | {frame.name for frame in model.frames}
    if sensor.frame_id in known:
        return sensor.frame_id
    bare = sensor.frame_id.rpartition("/")[2]
    if bare in known:
        return bare
    if bare in FOREIGN_FRAMES:
        report.suspicious(
            f"{describe_sensor(sensor.name, sensor.frame)}: <frame_name>",
            f"{quote(sensor.frame_id)} is not a frame of the robot; {quote(default)} is used",
        )
        return default
    return sensor.frame_id


def _make_missing_frame(
    sensor: Sensor, model: Model, frames: list[Frame], report: ParseReport
) -> Frame | None:
    """Make the frame that no link has, at the sensor; report a frame that is somewhere else."""
    subject = describe_sensor(sensor.name, sensor.frame)
    if isinstance(sensor.settings, ContactSensor):
        return None
    known = {link.name for link in model.links} | {frame.name for frame in frames}
    if sensor.frame_id in known:
        _check_frame_place(sensor, model, frames, report)
        return None
    drive = model.drive
    if drive is not None and sensor.frame_id in (drive.odometry_frame, drive.robot_base_frame):
        return None
    added = sensor.compat != "gazebo11"
    report.suspicious(
        f"{subject}: <frame_name>",
        f"no link is named {quote(sensor.frame_id)}; "
        + ("a static transform at the sensor is added" if added else "it is in no TF tree"),
    )
    return Frame(sensor.frame_id, sensor.link, find_data_origin(sensor)) if added else None


PLACE_TOLERANCE_M = 1e-3
TURN_TOLERANCE = 1e-5
"""1 - cos of half the angle: 0.5 degrees."""


def find_data_origin(sensor: Sensor) -> Origin:
    """Find where the axes of a sensor's messages are, in its link."""
    if isinstance(sensor.settings, CameraSensor):
        return compose(sensor.origin, OPTICAL_AXES)
    return sensor.origin


def _find_carrier(
    name: str, model: Model, frames: Iterable[Frame], origin: Origin
) -> tuple[str, Origin]:
    """Find the link that carries a frame, over fixed joints, and a pose in it."""
    frame = next((one for one in frames if one.name == name), None)
    if frame is not None:
        return _find_carrier(frame.parent, model, (), compose(frame.origin, origin))
    joint = next((one for one in model.joints if one.child == name and one.kind == "fixed"), None)
    if joint is None:
        return name, origin
    return _find_carrier(joint.parent, model, (), compose(joint.origin, origin))


def _check_frame_place(
    sensor: Sensor, model: Model, frames: Iterable[Frame], report: ParseReport
) -> None:
    subject = describe_sensor(sensor.name, sensor.frame)
    link, origin = _find_carrier(sensor.frame_id, model, frames, Origin())
    carrier, data = _find_carrier(sensor.link, model, (), find_data_origin(sensor))
    if link != carrier:
        report.suspicious(
            subject, f"frame {quote(sensor.frame_id)} moves relative to the sensor's link"
        )
        return
    x, y, z = _find_offset(origin, data.position)
    turn = multiply(conjugate(origin.orientation), data.orientation)
    is_turned = 1.0 - abs(turn[3]) > TURN_TOLERANCE
    if isinstance(sensor.settings, CameraSensor) and sensor.settings.kind == "rgb":
        is_turned = False  # A picture has no axes that a user transforms.
    if math.hypot(x, y, z) > PLACE_TOLERANCE_M:
        report.suspicious(
            subject,
            f"data are {x:.3g} {y:.3g} {z:.3g} m from the origin of frame "
            f"{quote(sensor.frame_id)}; name a frame at the sensor",
        )
    elif is_turned:
        axes = "optical axes (z forward)" if isinstance(sensor.settings, CameraSensor) else "axes"
        report.suspicious(
            subject,
            f"data are in the sensor's {axes}, and frame {quote(sensor.frame_id)} is turned "
            "against them; name a frame with the same axes",
        )


def _find_offset(frame: Origin, position: Vec3) -> Vec3:
    x, y, z = (a - b for a, b in zip(position, frame.position, strict=True))
    return rotate(conjugate(frame.orientation), (x, y, z))


def make_sensor_entry(
    sensor: Sensor, namespace: str = "<namespace>", true_hz: float | None = None
) -> ReportEntry:
    """Report topics, frame, rate and estimated cost of a sensor.

    Args:
        sensor: With settings.
        namespace: Of the robot.
        true_hz: Rate in a world; None = as the description says.
    """
    settings = sensor.settings
    assert settings is not None
    topics = ", ".join(describe_topic(topic, namespace) for topic in sensor.topics)
    rate_hz = sensor.update_rate_hz if true_hz is None else true_hz
    rate = f"{rate_hz:g} Hz" if rate_hz else "every control step"
    sees = "; of collisions, not visuals" if sensor.kind in ("gpu_ray", "gpu_lidar") else ""
    return ReportEntry(
        "applied",
        describe_sensor(sensor.name, sensor.frame),
        f"{topics}; frame {quote(sensor.frame_id)}, {rate}, "
        f"{describe_cost(settings, rate_hz)}{sees}",
    )


SCAN_S, RAY_S = 3e-5, 3.5e-7
PIXEL_S = {"rgb": 2e-8, "depth": 4e-8, "rgbd": 4.5e-8}
MESSAGE_S = 1e-5
"""CPU time of a scan, a ray, a pixel (all topics subscribed) and another message, each one of
many, measured on one core of a server."""
SHOWN_COST = 1e-5


def estimate_cost_s(settings: SensorSettings) -> float:
    """Estimate the CPU time of one message [s]."""
    if isinstance(settings, RaySensor):
        return SCAN_S + RAY_S * settings.horizontal.count * settings.vertical.count
    if isinstance(settings, CameraSensor):
        return PIXEL_S[settings.kind] * settings.width * settings.height
    return MESSAGE_S


def describe_cost(settings: SensorSettings, rate_hz: float) -> str:
    """Describe the CPU time with a subscriber."""
    each_s = estimate_cost_s(settings)
    if not rate_hz:
        return f"about {each_s * 1e3:.2g} ms of CPU each"
    share = each_s * rate_hz
    return f"about {100.0 * share:.2g} % of a core" if share > SHOWN_COST else "hardly any CPU"
