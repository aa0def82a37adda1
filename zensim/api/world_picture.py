"""Pictures of a world, from above one side, by the renderer of cameras."""

import math
import struct
import zlib
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.api.api_errors import Unsupported
from zensim.api.world_access import WorldAccess, api_errors
from zensim.api.world_state import POSE, FloatArray, WorldState
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.sensor_messages import CameraSensor
from zensim.proto.messages.telemetry_messages import GetModelsResponse
from zensim.sim_server.scene.camera_images import CamerasUnavailable
from zensim.sim_server.sensors.camera_sensors import ViewedScene
from zensim.sim_server.sensors.scene_roster import SceneMeshes, SceneRoster
from zensim.sim_server.sensors.sensor_groups import SceneMoment
from zensim.spawner.client.service_client import ServiceClient
from zensim.spawner.spawn.spawn_poses import make_pose

CAMERA = CameraSensor(width=960, height=600, near_m=0.05, far_m=1000.0, horizontal_fov_rad=0.8)
MAX_SIDE = 4096
"""Longest side of a picture [pixels]."""
PITCH_RAD, YAW_RAD = 0.6, math.pi / 4.0
MARGIN_M = 0.25
"""What is shown around the origins of the entities."""
PNG_HEAD = b"\x89PNG\r\n\x1a\n"
RGB_8_BITS = (8, 2, 0, 0, 0)
"""Bits, colour type, compression, filter and interlacing of a PNG file."""


@dataclass(frozen=True)
class WorldPicture:
    """A picture of a world.

    Attributes:
        png: The PNG file.
    """

    png: bytes

    def save(self, path: str | Path) -> None:
        """Write the PNG file.

        Raises:
            OSError: It cannot be written.
        """
        Path(path).write_bytes(self.png)

    def _repr_png_(self) -> bytes:
        return self.png

    def __repr__(self) -> str:
        """Say the size."""
        width, height = struct.unpack(">II", self.png[16:24])
        return f"<WorldPicture, {width} x {height} pixels>"


def take_picture(access: WorldAccess, camera: CameraSensor = CAMERA) -> bytes:
    """Take a picture, a PNG file, that shows everything that was spawned.

    Raises:
        CamerasUnavailable: Images cannot be made on this host.
        ServiceError: The server refused to describe its entities.
    """
    models = ServiceClient(access, access.world_name).models()
    shown_models = tuple(map(_show_collisions, models.models))
    models = msgspec.structs.replace(models, models=shown_models)
    state, roster = access.refresh(), SceneRoster(models, None)
    meshes = SceneMeshes(access, access.world_name)
    meshes.fetch(roster.visual_meshes)
    meshes.fetch_files(roster.texture_files)
    view = ViewedScene(roster.make_visual_layout(meshes), roster.scene, meshes)
    joints = np.frombuffer(state.snapshot.joint_positions, dtype="<f8")
    moment = SceneMoment(
        state.snapshot.step, state.snapshot.time_ns, state.base[:, POSE].copy(), joints
    )
    shown = view.find_renderer(moment).render(camera, _choose_view(models, state, camera))
    return encode_png(shown.rgb)


def _show_collisions(model: Model) -> Model:
    """Make the collisions of a model without visuals visible."""
    if any(link.visuals for link in model.links):
        return model
    replace = msgspec.structs.replace
    return replace(
        model, links=tuple(replace(link, visuals=link.collisions) for link in model.links)
    )


def make_picture(access: WorldAccess, width: int, height: int) -> WorldPicture:
    """Take a picture of some size [pixels].

    Raises:
        Unsupported: Images cannot be made on this host.
    """
    try:
        with api_errors():
            camera = msgspec.structs.replace(CAMERA, width=width, height=height)
            return WorldPicture(take_picture(access, camera))
    except CamerasUnavailable as error:
        raise Unsupported(f"no picture: {error}", slug="no_cameras") from error


def _choose_view(models: GetModelsResponse, state: WorldState, camera: CameraSensor) -> FloatArray:
    """Choose the pose (7,) of a camera that sees what was spawned, else the origin."""
    spawned = [one.entity for one in models.entities if not one.belongs_to_world]
    rows = [state.row[name] for name in spawned if name in state.row]
    points = state.base[rows, :3] if rows else np.zeros((1, 3))
    corners = MARGIN_M * np.array(list(product((-1.0, 1.0), repeat=3)))
    x, y, z = _find_eye((points[:, None] + corners).reshape(-1, 3), camera).tolist()
    turned = make_pose((x, y, z), (0.0, PITCH_RAD, YAW_RAD)).orientation
    return np.array([x, y, z, turned.x, turned.y, turned.z, turned.w])


def _find_eye(points: FloatArray, camera: CameraSensor) -> FloatArray:
    """Find where a camera sees all points (n, 3), as near as possible to their centre."""
    along, down = math.cos(PITCH_RAD), math.sin(PITCH_RAD)
    ahead = np.array([along * math.cos(YAW_RAD), along * math.sin(YAW_RAD), -down])
    left = np.array([-math.sin(YAW_RAD), math.cos(YAW_RAD), 0.0])
    wide = math.tan(camera.horizontal_fov_rad / 2.0)
    high = wide * camera.height / camera.width
    centre = (points.min(axis=0) + points.max(axis=0)) / 2.0
    offsets = points - centre
    sideways = np.abs(offsets @ left) / wide
    upward = np.abs(offsets @ np.cross(ahead, left)) / high
    distance = np.max(np.maximum(sideways, upward) - offsets @ ahead)
    found: FloatArray = centre - distance * ahead
    return found


def encode_png(rgb: npt.NDArray[np.uint8]) -> bytes:
    """Write an image (h, w, 3) as a PNG file."""
    height, width, _ = rgb.shape
    unfiltered = np.zeros((height, 1), dtype=np.uint8)
    rows = np.concatenate([unfiltered, rgb.reshape(height, -1)], axis=1)
    parts = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, *RGB_8_BITS)),
        (b"IDAT", zlib.compress(rows.tobytes())),
        (b"IEND", b""),
    )
    return PNG_HEAD + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
