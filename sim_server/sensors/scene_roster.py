"""Entities of a world as sensor processes know them: models, sensors, shapes and meshes."""

import io
import logging
import math
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from typing import TYPE_CHECKING, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto import keys
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.forward_kinematics import compute_link_poses
from zensim.proto.messages.asset_messages import GetAssetRequest
from zensim.proto.messages.model_messages import Link, Model, Origin, Sensor, Shape
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.sensor_messages import CameraSensor, RaySensor, SensorTopic
from zensim.proto.messages.telemetry_messages import GetModelsResponse
from zensim.proto.network_protocols import CallingNetwork
from zensim.proto.se3 import FloatArray, compose, from_origin
from zensim.proto.service_catalog import GET_ASSET
from zensim.proto.stl import read_corners
from zensim.sim_server.scene.camera_images import list_visible_shapes
from zensim.sim_server.scene.scene import SceneLayout

if TYPE_CHECKING:
    from zensim.sim_server.scene.broad_phase import IntArray

T = TypeVar("T")
LOG = logging.getLogger("zensim.sensors")
ASSET_TIMEOUT_S = 5.0
FETCH_S = 2.0
"""Wall time after which a fetch leaves the rest for the next one: the program goes on meanwhile."""
PLACE_BYTES = 8
"""Bytes of the place of a corner in an image."""
NO_CORNERS = np.zeros((3, 3), dtype=np.float32)
"""A triangle that no ray hits."""
POSE_COLUMNS = 7


@dataclass(frozen=True, eq=False)
class SceneSensor:
    """A sensor that sensor processes publish.

    Attributes:
        row: Index of its entity.
        model: Of the entity.
    """

    row: int
    entity: str
    namespace: str
    model: Model
    sensor: Sensor

    @property
    def name(self) -> tuple[str, str, str]:
        """Names of entity, link and sensor: unique in the world."""
        return self.entity, self.sensor.link, self.sensor.name

    def find_key(self, topic: SensorTopic) -> str:
        """Write the key of one of its topics."""
        return keys.robot(self.namespace or self.entity, topic.name)


class SensorMount:
    """The place of a sensor in all entities of one model."""

    def __init__(self, model: Model, sensor: Sensor) -> None:
        """Keep the joints between the root link and the sensor."""
        joint_to = {joint.child: number for number, joint in enumerate(model.joints)}
        chain: list[int] = []
        link = sensor.link
        while (number := joint_to.get(link)) is not None:
            chain.insert(0, number)
            link = model.joints[number].parent
        self.joints = np.array(chain, dtype=np.intp)
        """Numbers of the joints of the chain, in the order of `Model.joints`."""
        joints = tuple(model.joints[number] for number in chain)
        wanted = {model.links[0].name, *(joint.child for joint in joints)}
        links = tuple(one for one in model.links if one.name in wanted)
        self._chain = msgspec.structs.replace(model, links=links, joints=joints, frames=())
        self._link = sensor.link
        self._origin = from_origin(sensor.origin)

    def find_poses(self, base: FloatArray, joint_positions: FloatArray) -> FloatArray:
        """Find the poses (n, 7) of the sensors in the world.

        Args:
            base: (n, 7) of the root links.
            joint_positions: (n, k) of the joints of the chain.
        """
        return compose(
            compute_link_poses(self._chain, base, joint_positions)[self._link], self._origin
        )


class SceneRoster:
    """The entities of a world at one roster number.

    Attributes:
        number: Of `SceneState.roster`.
        environment: Of the world.
        scene: Lights and colours of the world.
        models: Of each entity.
        joint_starts: (n,) index of the first joint position of each entity.
        joint_count: Of all entities.
        sensors: All sensors of sensor processes, in the order of the entities and of their models.
    """

    def __init__(self, response: GetModelsResponse, known: "SceneRoster | None" = None) -> None:
        """Read the entities.

        Args:
            response: Of `get_models`, for all entities.
            known: An earlier roster, whose equal models are used again.
        """
        self.number = response.roster
        self.environment = response.environment
        self.scene = response.scene
        former: dict[Model, Model] = {}
        if known is not None:
            former = {model: model for model in known.distinct_models}
        self.distinct_models: tuple[Model, ...] = tuple(
            former.get(model, model) for model in response.models
        )
        self.models = tuple(self.distinct_models[one.model] for one in response.entities)
        counts = np.array([len(model.joints) for model in self.models], dtype=np.intp)
        self.joint_starts = np.cumsum(counts) - counts
        self.joint_count = int(counts.sum())
        self.sensors = tuple(
            SceneSensor(row, one.entity, one.namespace, self.distinct_models[one.model], sensor)
            for row, one in enumerate(response.entities)
            for sensor in self.distinct_models[one.model].sensors
            if isinstance(sensor.settings, RaySensor | CameraSensor)
        )

    @cached_property
    def meshes(self) -> tuple[str, ...]:
        """Names of the meshes of collisions."""
        return self._name_meshes(lambda link: link.collisions)

    @cached_property
    def visual_meshes(self) -> tuple[str, ...]:
        """Names of the meshes that cameras see."""
        return self._name_meshes(lambda link: (*link.visuals, *link.collisions))

    def _name_meshes(self, list_shapes: Callable[[Link], Iterable[Shape]]) -> tuple[str, ...]:
        links = (link for model in self.distinct_models for link in model.links)
        shapes = (shape for link in links for shape in list_shapes(link))
        return tuple(dict.fromkeys(shape.mesh for shape in shapes if shape.kind == "mesh"))

    @cached_property
    def texture_files(self) -> tuple[str, ...]:
        """Names of the images on visuals, and of their coordinates."""
        return tuple(
            dict.fromkeys(
                name
                for model in self.distinct_models
                for link in model.links
                for shape in link.visuals
                if shape.texture is not None
                for name in (shape.texture.image, shape.texture.coordinates)
            )
        )

    def fits(self, poses: FloatArray, joint_positions: FloatArray) -> bool:
        """Whether arrays have a row for each entity and joint."""
        return len(poses) == len(self.models) and len(joint_positions) == self.joint_count

    def make_layout(self, meshes: "SceneMeshes") -> SceneLayout:
        """Group the shapes of all entities."""
        return SceneLayout(
            self.models,
            meshes.find_corners,
            meshes.find_corners,
            has_ground=self.environment.has_ground,
        )

    def make_visual_layout(self, meshes: "SceneMeshes") -> SceneLayout:
        """Group what cameras see of all entities."""
        return SceneLayout(
            self.models,
            meshes.find_corners,
            meshes.find_corners,
            has_ground=self.environment.has_ground,
            list_shapes=lambda link: list_visible_shapes(link, meshes.has),
        )


class SceneMeshes:
    """Triangles of meshes and files of textures, fetched from the server once."""

    def __init__(
        self, network: CallingNetwork, world: str, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin without files.

        Args:
            network: With a server.
            world: Name of the world.
            now_s: Wall time from any origin.
        """
        self._network = network
        self._world = world
        self._now_s = now_s
        self._begun: dict[str, bytearray] = {}
        """First bytes of files that the last fetch left."""
        self._corners: dict[str, npt.NDArray[np.floating]] = {}
        self._files: dict[str, bytes] = {}

    def __getstate__(self) -> dict[str, object]:
        """Leave out the network: a copy has what was fetched."""
        return {**self.__dict__, "_network": None}

    def find_corners(self, name: str) -> npt.NDArray[np.floating]:
        """Find the corners (3 f, 3) of a mesh; nothing that can be hit while it is missing."""
        return self._corners.get(name, NO_CORNERS)

    def has(self, name: str) -> bool:
        """Whether a mesh has been fetched."""
        return name in self._corners

    def fetch(self, names: Iterable[str]) -> bool:
        """Fetch missing meshes, for a limited time; return whether all are there."""
        wanted = tuple(names)
        self._fetch_missing(wanted, self._corners, read_corners)
        return all(name in self._corners for name in wanted)

    def find_picture(self, image: str) -> npt.NDArray[np.uint8] | None:
        """See `TextureFiles`."""
        if not (data := self._files.get(image, b"")):
            return None
        # Its import takes a while, and few worlds have textures.
        from PIL import Image  # noqa: PLC0415

        try:
            return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
        except (OSError, ValueError, Image.DecompressionBombError) as error:
            LOG.warning("texture image=%s reason=%r", image, str(error))
            return None

    def find_places(self, coordinates: str) -> npt.NDArray[np.float32]:
        """See `TextureFiles`."""
        data = self._files.get(coordinates, b"")
        return np.frombuffer(data, "<f4", len(data) // PLACE_BYTES * 2).reshape(-1, 2)

    def fetch_files(self, names: Iterable[str]) -> bool:
        """Fetch missing files of textures, for a limited time; return whether all are there."""
        wanted = tuple(names)
        self._fetch_missing(wanted, self._files, bytes)
        return all(name in self._files for name in wanted)

    def _fetch_missing(
        self, names: Sequence[str], found: dict[str, T], read: Callable[[bytes], T]
    ) -> None:
        """Fetch what is missing until the time is over; what cannot be read stays missing."""
        deadline_s = self._now_s() + FETCH_S
        for name in names:
            if name in found:
                continue
            if data := self._fetch_bytes(name, deadline_s):
                with suppress(ValueError):
                    found[name] = read(data)
            if self._now_s() >= deadline_s:
                return

    def _fetch_bytes(self, name: str, deadline_s: float) -> bytes:
        """Fetch a file; empty if that fails, or needs another fetch."""
        data, total = self._begun.pop(name, bytearray()), math.inf
        try:
            while len(data) < total:
                request = GetAssetRequest(name, len(data))
                part = self._network.call(
                    GET_ASSET, request, world=self._world, timeout_s=ASSET_TIMEOUT_S
                )
                data, total = data + part.data, part.total if part.data else 0
                if len(data) < total and self._now_s() >= deadline_s:
                    self._begun[name] = data
                    return b""
        except TimeoutError:
            self._begun[name] = data
            return b""
        except (BusError, ServiceError, MalformedPayload):
            return b""
        return bytes(data) if sha256(data).hexdigest() == name else b""


class SensorPlaces:
    """Where some sensors are."""

    def __init__(self, sensors: Sequence[SceneSensor], roster: SceneRoster) -> None:
        """Group the sensors by their mounts, so that poses are found in arrays."""
        self.entities = np.array([sensor.row for sensor in sensors], dtype=np.intp)
        """(m,) rows of the entities that carry them."""
        members: dict[tuple[int, str, Origin], list[int]] = {}
        for number, one in enumerate(sensors):
            key = id(one.model), one.sensor.link, one.sensor.origin
            members.setdefault(key, []).append(number)
        self._mounts: list[tuple[IntArray, SensorMount, IntArray]] = []
        for numbers in members.values():
            mount = SensorMount(sensors[numbers[0]].model, sensors[numbers[0]].sensor)
            rows = np.array(numbers, dtype=np.intp)
            joints = roster.joint_starts[self.entities[rows], None] + mount.joints
            self._mounts.append((rows, mount, joints))

    def find_poses(self, base: FloatArray, joint_positions: FloatArray) -> FloatArray:
        """Find the poses (m, 7) in the world.

        Args:
            base: (n, 7) of the root links of all entities.
            joint_positions: Of all entities.
        """
        poses = np.empty((len(self.entities), POSE_COLUMNS))
        for rows, mount, joints in self._mounts:
            poses[rows] = mount.find_poses(base[self.entities[rows]], joint_positions[joints])
        return poses
