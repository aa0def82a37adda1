"""`python -m tests.integration.model_pictures` renews the pictures of models in the spawn form."""

import math

import numpy as np

import zensim
from tests.contract.repository import ROOT
from zensim.api.world_picture import encode_png
from zensim.api.world_state import POSE
from zensim.proto.messages.sensor_messages import CameraSensor
from zensim.proto.messages.telemetry_messages import GetModelsRequest
from zensim.proto.service_catalog import GET_MODELS
from zensim.sim_server.description.builtin_models import list_builtin_models
from zensim.sim_server.sensors.camera_sensors import ViewedScene
from zensim.sim_server.sensors.scene_roster import SceneMeshes, SceneRoster
from zensim.sim_server.sensors.sensor_groups import SceneMoment
from zensim.spawner.spawn.spawn_poses import make_pose

FOLDER = ROOT / "spawner" / "page" / "pictures"
CAMERA = CameraSensor(width=320, height=240, near_m=0.02, far_m=100.0, horizontal_fov_rad=0.6)
PITCH_RAD, YAW_RAD = 0.45, 0.8 * math.pi
MARGIN = 2.8
"""Distance of the camera by the diagonal of the model."""


def take_model_picture(name: str) -> bytes:
    """Take a picture, a PNG file, of a model of the server."""
    with zensim.World() as sim:
        robot = sim.spawn(name)
        access = sim._session.access  # noqa: SLF001  as `take_picture` gets it
        models, state = access.call(GET_MODELS, GetModelsRequest()), access.refresh()
        roster, meshes = SceneRoster(models, None), SceneMeshes(access, access.world_name)
        meshes.fetch(roster.visual_meshes)
        meshes.fetch_files(roster.texture_files)
        view = ViewedScene(roster.make_visual_layout(meshes), roster.scene, meshes)
        joints = np.frombuffer(state.snapshot.joint_positions, dtype="<f8")
        moment = SceneMoment(
            state.snapshot.step, state.snapshot.time_ns, state.base[:, POSE].copy(), joints
        )
        corners = sim._session.client.entity_bounds(robot.name).points  # noqa: SLF001
        points = np.array([(one.x, one.y, one.z) for one in corners]) + state.base[0, :3]
        return encode_png(view.find_renderer(moment).render(CAMERA, _place_camera(points)).rgb)


def _place_camera(points: np.ndarray) -> np.ndarray:
    """Find the pose (7,) of a camera that sees points (n, 3) from above the left front."""
    along = math.cos(PITCH_RAD)
    ahead = np.array([along * math.cos(YAW_RAD), along * math.sin(YAW_RAD), -math.sin(PITCH_RAD)])
    distance = MARGIN * float(np.linalg.norm(np.ptp(points, axis=0)))
    x, y, z = (points.mean(axis=0) - distance * ahead).tolist()
    turned = make_pose((x, y, z), (0.0, PITCH_RAD, YAW_RAD)).orientation
    return np.array([x, y, z, turned.x, turned.y, turned.z, turned.w])


if __name__ == "__main__":
    for model in list_builtin_models():
        (FOLDER / f"{model}.png").write_bytes(take_model_picture(model))
