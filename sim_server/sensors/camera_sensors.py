"""Cameras: pictures, depth, points, labels and calibration of what is seen in a scene."""

import io
from collections.abc import Callable, Sequence
from functools import cached_property

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.messages.drive_messages import Compat
from zensim.proto.messages.sensor_messages import CameraSensor
from zensim.proto.messages.standard_messages import (
    CameraInfo,
    CompressedImage,
    Header,
    Image,
    PointCloud2,
    PointField,
)
from zensim.proto.messages.world_messages import Scene
from zensim.proto.topic_catalog import (
    CAMERA_INFO,
    DEPTH_CAMERA_INFO,
    DEPTH_IMAGE,
    DEPTH_POINTS,
    IMAGE_COMPRESSED,
    IMAGE_RAW,
    LABELS,
)
from zensim.sim_server.scene.broad_phase import IntArray
from zensim.sim_server.scene.camera_images import (
    CameraImages,
    CameraRenderer,
    TextureFiles,
    find_focal_length,
    find_principal_point,
)
from zensim.sim_server.scene.camera_selection import make_camera_renderer
from zensim.sim_server.scene.scene import SceneLayout
from zensim.sim_server.scene.scene_lights import SceneLights
from zensim.sim_server.sensors.array_messages import ArrayMessages
from zensim.sim_server.sensors.scene_roster import SceneRoster, SceneSensor
from zensim.sim_server.sensors.sensor_groups import SceneMoment, SensorGroup
from zensim.sim_server.sensors.sensor_publishers import SensorTopics

FLOAT32 = 7
"""`PointField.datatype`."""
POINT_FIELDS = tuple(
    PointField(name, 4 * number, FLOAT32, 1) for number, name in enumerate(("x", "y", "z", "rgb"))
)
POINT_STEP = 16
JPEG_QUALITY = 80
"""Quality that image_transport's compressed publisher uses."""
DISTORTION_MODEL, NO_DISTORTION = "plumb_bob", (0.0,) * 5
MAX_BYTE = 255.0

WriteImage = Callable[[CameraImages], bytes]
"""Makes the bytes of the array of a message."""


class ViewedScene:
    """What cameras see of all entities; takes poses when the first image of a moment is made."""

    def __init__(self, layout: SceneLayout, scene: Scene, files: TextureFiles) -> None:
        """Prepare a scene without poses.

        Args:
            layout: Of what cameras see.
            scene: Lights and colours of the world.
            files: Of textures.
        """
        self._layout = layout
        self._lights = SceneLights(layout, scene)
        self._files = files
        self._moment: SceneMoment | None = None

    @cached_property
    def _renderer(self) -> CameraRenderer:
        return make_camera_renderer(self._layout, self._files)

    def find_renderer(self, moment: SceneMoment) -> CameraRenderer:
        """Find the renderer, with the poses of a moment.

        Raises:
            CamerasUnavailable: Images cannot be made here.
        """
        if self._moment is not moment:
            state = moment.base, moment.joint_positions
            self._renderer.place(self._layout.place(*state), self._lights.place(*state))
            self._moment = moment
        return self._renderer


class CameraSensorGroup(SensorGroup):
    """Cameras with equal settings."""

    def __init__(
        self,
        sensors: Sequence[SceneSensor],
        settings: CameraSensor,
        roster: SceneRoster,
        topics: SensorTopics,
        scene: ViewedScene,
    ) -> None:
        """Prepare the messages; see `SensorGroup`."""
        super().__init__(sensors, roster, topics)
        self._settings, self._scene = settings, scene
        self._writers = {
            name: make_image_writer(name, settings, self._frames, self._compat)
            for name in self._topics.names
        }

    def publish(self, moment: SceneMoment) -> IntArray:
        """See `SensorGroup`."""
        wanted, rows_of = self._topics.find_all_wanted()
        if self._settings.is_triggered:
            wanted = np.intersect1d(wanted, self._topics.find_triggered())
        if not len(wanted):
            return wanted
        poses = self._places.find_poses(moment.base, moment.joint_positions)
        for row in wanted.tolist():
            exact = self._scene.find_renderer(moment).render(self._settings, poses[row])
            images = self._add_noise(exact, row, moment.step)
            for name, rows in rows_of.items():
                if row in rows:
                    only = np.array([row], dtype=np.intp)
                    self._topics.put(name, only, [self._writers[name](row, moment, images)])
        return wanted

    def _add_noise(self, images: CameraImages, row: int, step: int) -> CameraImages:
        """Add noise to the colours."""
        if self._settings.noise.kind == "none":
            return images
        noise = self._make_noise(self._settings.noise, [row])
        colours = images.rgb.reshape(1, -1) / MAX_BYTE
        noisy = noise.apply_to_ranges(colours, step, range_min_m=0.0, range_max_m=1.0)
        rgb = np.rint(noisy * MAX_BYTE).astype(np.uint8).reshape(images.rgb.shape)
        return CameraImages(rgb, images.depth, images.labels)


class ImageWriter:
    """Writes the messages of one topic of a group."""

    def __init__(
        self, template: msgspec.Struct, frames: Sequence[str], write: WriteImage | None
    ) -> None:
        """Encode the templates.

        Args:
            template: Without header and array.
            frames: Of each camera.
            write: Makes the array `data`; None without one.
        """
        headed = [
            msgspec.structs.replace(template, header=Header(frame_id=frame)) for frame in frames
        ]
        self._write = write
        self._messages = (
            ArrayMessages(headed)
            if write is None
            else ArrayMessages(headed, array="data", item=b"\1")
        )

    def __call__(self, row: int, moment: SceneMoment, images: CameraImages) -> bytes:
        """Write the message of one camera."""
        rows = np.array([row], dtype=np.intp)
        data = b"" if self._write is None else self._write(images)
        self._messages.fill(rows, moment.time_ns, lengths=len(data))
        return self._messages.write(rows, [data])[0]


def make_image_writer(
    topic: str, settings: CameraSensor, frames: Sequence[str], compat: Compat
) -> ImageWriter:
    """Make the writer of a topic of the catalog."""
    if topic in (CAMERA_INFO.name, DEPTH_CAMERA_INFO.name):
        return ImageWriter(make_camera_info(settings, compat), frames, None)
    if topic == IMAGE_COMPRESSED.name:
        return ImageWriter(CompressedImage(format="jpeg"), frames, write_jpeg)
    if topic == DEPTH_POINTS.name:
        points = PointCloud2(
            height=settings.height,
            width=settings.width,
            fields=POINT_FIELDS,
            point_step=POINT_STEP,
            row_step=POINT_STEP * settings.width,
        )
        return ImageWriter(points, frames, PointsOfDepth(settings).write)
    encoding, size, write = {
        IMAGE_RAW.name: ("rgb8", 3, write_rgb),
        DEPTH_IMAGE.name: ("32FC1", 4, lambda images: write_depth(images, settings)),
        LABELS.name: ("32SC1", 4, write_labels),
    }[topic]
    image = Image(
        height=settings.height, width=settings.width, encoding=encoding, step=size * settings.width
    )
    return ImageWriter(image, frames, write)


def make_camera_info(settings: CameraSensor, compat: Compat) -> CameraInfo:
    """Make the calibration; Gazebo Classic has its principal point half a pixel further."""
    focal, (cx, cy) = find_focal_length(settings), find_principal_point(settings)
    if compat == "gazebo11":
        cx, cy = cx + 0.5, cy + 0.5
    shift = -focal * settings.stereo_baseline_m
    return CameraInfo(
        height=settings.height,
        width=settings.width,
        distortion_model=DISTORTION_MODEL,
        d=NO_DISTORTION,
        k=(focal, 0.0, cx, 0.0, focal, cy, 0.0, 0.0, 1.0),
        r=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        p=(focal, 0.0, cx, shift, 0.0, focal, cy, 0.0, 0.0, 0.0, 1.0, 0.0),
    )


def write_rgb(images: CameraImages) -> bytes:
    """Write the pixels."""
    return images.rgb.tobytes()


def write_labels(images: CameraImages) -> bytes:
    """Write the indices of the entities."""
    return images.labels.astype("<i4").tobytes()


def write_jpeg(images: CameraImages) -> bytes:
    """Compress the pixels."""
    # Its import takes a while, and few want compressed pictures.
    from PIL import Image as Picture  # noqa: PLC0415

    file = io.BytesIO()
    Picture.fromarray(images.rgb).save(file, "JPEG", quality=JPEG_QUALITY)
    return file.getvalue()


def limit_depth(images: CameraImages, settings: CameraSensor) -> npt.NDArray[np.float32]:
    """Replace depths [m] below the minimum by -inf and those above the maximum by +inf."""
    limited = np.where(images.depth < settings.min_depth_m, -np.inf, images.depth)
    return np.where(limited > settings.max_depth_m, np.inf, limited).astype("<f4")


def write_depth(images: CameraImages, settings: CameraSensor) -> bytes:
    """Write depths [m]."""
    return limit_depth(images, settings).tobytes()


class PointsOfDepth:
    """Points of depth images in optical axes, with their colours."""

    def __init__(self, settings: CameraSensor) -> None:
        """Find the directions of the pixels."""
        focal, (cx, cy) = find_focal_length(settings), find_principal_point(settings)
        self._settings = settings
        self._x = ((np.arange(settings.width) - cx) / focal).astype("<f4")
        self._y = ((np.arange(settings.height) - cy) / focal).astype("<f4")[:, None]

    def write(self, images: CameraImages) -> bytes:
        """Write x, y, z [m] and colour of each pixel; NaN where no depth is measured."""
        depth = limit_depth(images, self._settings)
        depth = np.where(np.isfinite(depth), depth, np.float32(np.nan))
        points = np.empty((*depth.shape, POINT_STEP // 4), dtype="<f4")
        points[..., 0], points[..., 1], points[..., 2] = self._x * depth, self._y * depth, depth
        red, green, blue = np.moveaxis(images.rgb.astype("<u4"), 2, 0)
        points[..., 3] = (red << 16 | green << 8 | blue).astype("<u4").view("<f4")
        return points.tobytes()
