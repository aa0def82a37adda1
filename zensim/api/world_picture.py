"""Pictures of a world, from above one side, by the renderer of cameras."""

import math
import struct
import zlib

import numpy as np
import numpy.typing as npt

from zensim.api.world_access import WorldAccess
from zensim.api.world_state import POSE, FloatArray, WorldState
from zensim.proto.messages.sensor_messages import CameraSensor
from zensim.proto.messages.telemetry_messages import GetModelsResponse
from zensim.sim_server.sensors.camera_sensors import ViewedScene
from zensim.sim_server.sensors.scene_roster import SceneMeshes, SceneRoster
from zensim.sim_server.sensors.sensor_groups import SceneMoment
from zensim.spawner.client.service_client import ServiceClient
from zensim.spawner.spawn.spawn_poses import make_pose

CAMERA = CameraSensor(width=960, height=600, near_m=0.05, far_m=1000.0)
PITCH_RAD, YAW_RAD = 0.8, math.pi / 4.0
MARGIN_M, LEAST_SIZE_M = 2.0, 3.0
"""Margin around the robots, and least side of the square of ground that is shown."""
PNG_HEAD = b"\x89PNG\r\n\x1a\n"
RGB_8_BITS = (8, 2, 0, 0, 0)
"""Bits, colour type, compression, filter and interlacing of a PNG file."""


def take_picture(access: WorldAccess) -> bytes:
    """Take a picture, a PNG file, that shows everything that was spawned.

    Raises:
        CamerasUnavailable: Images cannot be made on this host.
        ServiceError: The server refused to describe its entities.
    """
    models = ServiceClient(access, access.world_name).models()
    state, roster = access.refresh(), SceneRoster(models, None)
    meshes = SceneMeshes(access, access.world_name)
    meshes.fetch(roster.visual_meshes)
    meshes.fetch_files(roster.texture_files)
    view = ViewedScene(roster.make_visual_layout(meshes), roster.scene, meshes)
    joints = np.frombuffer(state.snapshot.joint_positions, dtype="<f8")
    moment = SceneMoment(
        state.snapshot.step, state.snapshot.time_ns, state.base[:, POSE].copy(), joints
    )
    shown = view.find_renderer(moment).render(CAMERA, _choose_view(models, state))
    return encode_png(shown.rgb)


def _choose_view(models: GetModelsResponse, state: WorldState) -> FloatArray:
    """Choose the pose (7,) of a camera that sees what was spawned, else the origin."""
    spawned = [one.entity for one in models.entities if not one.belongs_to_world]
    rows = [state.row[name] for name in spawned if name in state.row]
    points = state.base[rows, :3] if rows else np.zeros((1, 3))
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(LEAST_SIZE_M, float((high - low).max()) + 2.0 * MARGIN_M)
    distance = size / (2.0 * math.tan(CAMERA.horizontal_fov_rad / 2.0))
    along = math.cos(PITCH_RAD)
    ahead = np.array([along * math.cos(YAW_RAD), along * math.sin(YAW_RAD), -math.sin(PITCH_RAD)])
    x, y, z = ((low + high) / 2.0 - distance * ahead).tolist()
    turned = make_pose((x, y, z), (0.0, PITCH_RAD, YAW_RAD)).orientation
    return np.array([x, y, z, turned.x, turned.y, turned.z, turned.w])


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
