"""What the page shows of sensors: points of lidars and pictures of cameras. NumPy only."""

from typing import Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.model_messages import Model, Origin
from zensim.proto.messages.sensing_messages import Contacts
from zensim.proto.messages.standard_messages import Image, LaserScan, PointCloud2
from zensim.proto.rigid_transforms import OPTICAL_AXES, compose
from zensim.proto.se3 import FloatArray
from zensim.proto.topic_catalog import DEPTH_IMAGE, DEPTH_POINTS, IMAGE_RAW, POINTS, SCAN

Picture = NDArray[np.uint8]
"""(height, width, 3), red, green, blue."""
MAX_POINTS: Final = 20_000
"""Most points shown of one sensor; of more, every k-th is shown."""
MAX_SHOWN_RANGE_M: Final = 10_000.0
CLOUD_GRID_M: Final = 0.05
CELL_FACTORS: Final = np.array((1, 1 << 20, 1 << 40))
"""Give each cell of the grid a number of its own."""
MAX_ANGLE_RAD: Final = 1e6
"""Bound of the angles of rays: float32 has steps of 0.06 rad there."""
MAX_PICTURE_SIDE: Final = 480
"""The panel is narrower; of larger pictures, every k-th row and column is shown."""
MAX_SCAN_BYTES: Final = 4 << 20
"""Largest LaserScan: a million rays, whose ranges become a tuple of floats."""
MAX_ARRAY_BYTES: Final = 64 << 20
"""Largest Image or PointCloud2, whose data are read as they are."""
FLOAT32: Final = 7
"""`PointField.datatype`."""
DEPTHS: Final = "32FC1"
CONTACT_COLUMNS: Final = 10
"""Columns of `Contacts.points`."""
MAX_CONTACTS: Final = 2000
PIXEL_BYTES: Final = {"rgb8": 3, DEPTHS: 4}
"""Bytes of a pixel by `Image.encoding`."""
LEAST_DEPTH_M: Final = 1e-3
"""White is at least this much nearer than black."""
PICTURES: Final = (IMAGE_RAW.name, DEPTH_IMAGE.name)
SHOWN_TOPICS: Final = (SCAN.name, POINTS.name, DEPTH_POINTS.name, *PICTURES)


class SensorChoice(msgspec.Struct, frozen=True):
    """A sensor of an entity that a client shows."""

    entity: str
    topic: str
    """See `SensorTopic.name`."""


class SensorView(msgspec.Struct, frozen=True):
    """A topic of a sensor that the page can show."""

    title: str
    """Name of the sensor."""
    topic: str
    """See `SensorTopic.name`."""
    content: Literal["scan", "points", "depth_points", "image_raw", "depth_image"]
    """Name in the topic catalog."""
    link: int
    """Index in `Model.links`."""
    origin: Origin
    """Pose of the axes of its points in the link."""

    @property
    def is_picture(self) -> bool:
        """Whether it is shown in the panel, not in the scene."""
        return self.content in PICTURES


class SensedFrame(msgspec.Struct, frozen=True, eq=False):
    """What has been received of the shown sensors since the last frame."""

    points: dict[SensorChoice, FloatArray] = {}
    """(n, 3) in the world frame [m]."""
    pictures: dict[SensorChoice, Picture] = {}


def list_sensor_views(model: Model) -> tuple[SensorView, ...]:
    """List what can be shown of the sensors of a model, in their order."""
    links = {link.name: number for number, link in enumerate(model.links)}
    return tuple(
        SensorView(
            sensor.name,
            topic.name,
            topic.topic,  # type: ignore[arg-type]
            links[sensor.link],
            _find_axes(sensor.origin, topic.topic),
        )
        for sensor in model.sensors
        for topic in sensor.topics
        if topic.topic in SHOWN_TOPICS and sensor.link in links
    )


def _find_axes(origin: Origin, content: str) -> Origin:
    return compose(origin, OPTICAL_AXES) if content == DEPTH_POINTS.name else origin


def read_points(view: SensorView, payload: bytes, encoding: str = "") -> FloatArray:
    """Read the points (n, 3) of a scan or cloud in its axes [m].

    Raises:
        MalformedPayload: It has another type, or its numbers contradict each other.
    """
    _check_size(payload, MAX_SCAN_BYTES if view.content == SCAN.name else MAX_ARRAY_BYTES)
    if view.content == SCAN.name:
        points = _place_ranges(decode(LaserScan, payload, encoding))
    else:
        points = _read_cloud(decode(PointCloud2, payload, encoding))
    near = points[(np.abs(points) <= MAX_SHOWN_RANGE_M).all(axis=1)]
    shown = near[:: _find_stride(len(near), MAX_POINTS)]
    return shown if view.content == SCAN.name else thin_out(shown)


def thin_out(points: FloatArray) -> FloatArray:
    """Keep a point of the points (n, 3) in each cell of a grid: closer ones hide what they hit."""
    cells = np.floor(points / CLOUD_GRID_M).astype(np.int64)
    _, first = np.unique(cells @ CELL_FACTORS, return_index=True)
    return points[np.sort(first)]


def read_contacts(message: Contacts) -> FloatArray:
    """Read positions and forces (n, 2, 3) of contacts in the world [m, N].

    Raises:
        MalformedPayload: Its numbers are not whole rows, or not finite.
    """
    if len(message.points) % (8 * CONTACT_COLUMNS):
        raise MalformedPayload(f"Contacts has {len(message.points)} bytes of points")
    rows = np.frombuffer(message.points, "<f8").reshape(-1, CONTACT_COLUMNS)[:MAX_CONTACTS]
    finite = rows[np.isfinite(rows).all(axis=1)]
    return np.stack((finite[:, :3], finite[:, 7:10]), axis=1)


def read_picture(payload: bytes, encoding: str = "") -> Picture:
    """Read an image of encoding rgb8 or 32FC1, thinned out to `MAX_PICTURE_SIDE`.

    Depths become greys: white is near, black is the farthest point of the image, or nothing.

    Raises:
        MalformedPayload: It is no such image, or its sizes contradict each other.
    """
    _check_size(payload, MAX_ARRAY_BYTES)
    image = decode(Image, payload, encoding)
    pixel = PIXEL_BYTES.get(image.encoding, 0)
    size, width = image.step * image.height, pixel * image.width
    if not 0 < width <= image.step or not 0 < size == len(image.data):
        raise MalformedPayload(
            f"Image of encoding {image.encoding[:20]!r}, {image.width} x {image.height}, "
            f"{len(image.data)} bytes is not {' or '.join(PIXEL_BYTES)} of that size"
        )
    stride = _find_stride(max(image.width, image.height), MAX_PICTURE_SIDE)
    rows = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)[::stride, :width]
    pixels = rows.reshape(len(rows), image.width, pixel)[:, ::stride]
    if image.encoding == DEPTHS:
        number = ">f4" if image.is_bigendian else "<f4"
        return _shade_depths(np.ascontiguousarray(pixels).view(number)[:, :, 0])
    return pixels


def _check_size(payload: bytes, limit: int) -> None:
    if len(payload) > limit:
        raise MalformedPayload(f"{len(payload)} bytes; the page reads at most {limit}")


def _shade_depths(depths: NDArray[np.float32]) -> Picture:
    farthest = depths[np.isfinite(depths)].max(initial=LEAST_DEPTH_M)
    limited = np.clip(np.nan_to_num(depths, nan=farthest), 0.0, farthest)
    grey = (255.0 * (1.0 - limited / farthest)).astype(np.uint8)
    return np.repeat(grey[:, :, None], 3, axis=2)


def _place_ranges(scan: LaserScan) -> FloatArray:
    ranges = np.array(scan.ranges, dtype=np.float64)
    # Gazebo writes NaN as the increment of a single ray.
    increment = scan.angle_increment if len(ranges) > 1 else 0.0
    # Formats other than CDR carry numbers that float32 cannot hold.
    if not abs(scan.angle_min) + len(ranges) * abs(increment) < MAX_ANGLE_RAD:
        raise MalformedPayload("LaserScan has an angle that is too large, or not finite")
    is_hit = (ranges >= scan.range_min) & (ranges <= scan.range_max) & np.isfinite(ranges)
    rays = np.flatnonzero(is_hit)
    angles = scan.angle_min + rays * increment
    hits = ranges[rays]
    return np.stack((hits * np.cos(angles), hits * np.sin(angles), np.zeros(len(hits))), axis=1)


def _read_cloud(cloud: PointCloud2) -> FloatArray:
    count, size = cloud.width * cloud.height, cloud.point_step
    offsets = {f.name: f.offset for f in cloud.fields if f.datatype == FLOAT32}
    places = [offsets.get(name, size) for name in ("x", "y", "z")]
    if count * size != len(cloud.data) or max(places) + 4 > size:
        raise MalformedPayload(
            f"PointCloud2 of {count} points of {size} bytes has {len(cloud.data)} bytes, "
            "or no float32 fields x, y and z"
        )
    if not count:
        # Then nothing limits the size of a point.
        return np.zeros((0, 3))
    number = ">f4" if cloud.is_bigendian else "<f4"
    layout = np.dtype(
        {"names": ["x", "y", "z"], "formats": [number] * 3, "offsets": places, "itemsize": size}
    )
    points = np.frombuffer(cloud.data, layout)
    return np.stack([points[name].astype(np.float64) for name in ("x", "y", "z")], axis=1)


def _find_stride(count: int, limit: int) -> int:
    """Find the least stride by which at most `limit` of `count` items are left."""
    return max(1, -(-count // limit))
