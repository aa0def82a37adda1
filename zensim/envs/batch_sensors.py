"""Lidars and inertial units of the robots of many equal worlds."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from zensim.api.api_errors import Invalid, NotFound
from zensim.api.in_process_server import InProcessServer
from zensim.envs.world_layout import FloatArray, WorldLayout
from zensim.proto.messages.model_messages import IDENTITY, Model, Sensor
from zensim.proto.messages.sensor_messages import Environment, ImuSensor, RaySensor
from zensim.proto.sensor_noise import SensorNoise, make_noise_key
from zensim.proto.topic_catalog import IMU
from zensim.robot_agent.mounted_sensors import list_state_sensors, mount_sensors
from zensim.robot_agent.robot_rows import NEW_ROW, StateRows
from zensim.robot_agent.state_sensors import SensorIdentity, StateSensor, make_state_sensor
from zensim.sim_server.scene.fleet_casting import make_scan_caster
from zensim.sim_server.sensors.ray_sensors import limit_ranges
from zensim.sim_server.sensors.scene_roster import (
    POSE_COLUMNS,
    SceneMeshes,
    SceneRoster,
    SensorPlaces,
)
from zensim.spawner.client.service_client import ServiceClient

SensorName = Literal["scan", "imu"]
SENSORS: dict[str, type] = {"scan": RaySensor, "imu": ImuSensor}
IMU_LIMITS = np.array([1.0] * 4 + [100.0] * 3 + [1000.0] * 3)
"""Limits of quaternion, angular velocity [rad/s] and specific force [m/s^2] in observations."""


class BatchSensors:
    """What a batch measures; the noise of a world depends on its seed and its own step alone."""

    def __init__(
        self,
        server: InProcessServer,
        layout: WorldLayout,
        worlds: int,
        names: Sequence[SensorName],
    ) -> None:
        """Find the sensors.

        Args:
            server: Of the world that is copied.
            layout: Of its arrays.
            worlds: Number of copies.
            names: Of the sensors that are measured.

        Raises:
            Invalid: A name is unknown, or models differ in such a sensor.
            NotFound: A robot has no such sensor.
        """
        for name in names:
            if name not in SENSORS:
                raise Invalid(f"sensor '{name}' is unknown", hint=f"use {', '.join(SENSORS)}")
        self._lidars = BatchLidars(server, layout) if "scan" in names else None
        self._imus: BatchImus | None = None
        if "imu" in names:
            found = ServiceClient(server.network, server.world.name).models()
            self._imus = BatchImus(found.environment, layout, worlds)
        self.restart({world: world for world in range(worlds)})

    @property
    def limits(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Least and greatest values of what each sensor of a robot measures."""
        found = {}
        if self._lidars is not None:
            found["scan"] = self._lidars.limits
        if self._imus is not None:
            found["imu"] = -IMU_LIMITS, IMU_LIMITS
        return found

    def restart(self, seeds: Mapping[int, int]) -> None:
        """Start some worlds anew, each with a seed of its noise."""
        for part in (self._lidars, self._imus):
            if part is not None:
                for world, seed in seeds.items():
                    part.restart(world, seed)

    def take(
        self,
        times_ns: Sequence[int],
        base: FloatArray,
        joints: tuple[FloatArray, FloatArray],
    ) -> None:
        """Take the states after a control step.

        Args:
            times_ns: Of each world, since its restart.
            base: (worlds, m, 13) of what is read.
            joints: Positions and velocities, (worlds, k).
        """
        if self._imus is not None:
            self._imus.take(times_ns, base, joints)

    def read_imu(self) -> FloatArray:
        """See `Batch.imu`."""
        if self._imus is None:
            raise Invalid("this batch measures no imu", hint="make it with sensors=('imu',)")
        return np.array(self._imus.numbers)

    def measure_scans(
        self, steps: Sequence[int], base: FloatArray, positions: FloatArray
    ) -> FloatArray:
        """See `Batch.scans`; steps are those of each world."""
        if self._lidars is None:
            raise Invalid("this batch measures no scan", hint="make it with sensors=('scan',)")
        return self._lidars.measure(steps, base, positions)


def _find_sensor(name: str, robot: str, model: Model) -> Sensor:
    """Find the first sensor of a kind.

    Raises:
        NotFound: The model has none.
    """
    for sensor in model.sensors:
        if isinstance(sensor.settings, SENSORS[name]):
            return sensor
    raise NotFound(
        f"robot '{robot}' has no sensor for '{name}'", hint="use a model such as box_bot_lidar"
    )


def _require_equal(name: str, settings: Sequence[object]) -> None:
    if any(one != settings[0] for one in settings):
        raise Invalid(f"robots differ in their '{name}'", hint="use robots of one model")


class BatchLidars:
    """The lidars of all robots, measured by the caster of the sensor process."""

    def __init__(self, server: InProcessServer, layout: WorldLayout) -> None:
        """Prepare the scene; see `BatchSensors`."""
        self._layout = layout
        roster = SceneRoster(ServiceClient(server.network, server.world.name).models())
        self._environment = roster.environment
        meshes = SceneMeshes(server.network, server.world.name)
        meshes.fetch(roster.meshes)
        self._caster = make_scan_caster(roster.make_layout(meshes))
        robots = zip(layout.names, layout.models, strict=True)
        chosen = {name: _find_sensor("scan", name, model) for name, model in robots}
        self._sensors = tuple(chosen.items())
        settings = [sensor.settings for sensor in chosen.values()]
        _require_equal("scan", settings)
        assert isinstance(settings[0], RaySensor)
        self._settings = settings[0]
        mounted = [one for one in roster.sensors if one.sensor == chosen.get(one.entity)]
        self._places = SensorPlaces(mounted, roster)
        self._noises: dict[int, SensorNoise] = {}
        """Noise by world."""

    def restart(self, world: int, seed: int) -> None:
        """See `BatchSensors.restart`."""
        keys = [make_noise_key(seed, robot, sensor) for robot, sensor in self._sensors]
        compat = self._sensors[0][1].compat
        self._noises[world] = SensorNoise([self._settings.noise], keys, self._environment, compat)

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Least and greatest range of each ray."""
        settings = self._settings
        rays = settings.horizontal.count * settings.vertical.count
        return np.full(rays, settings.range_min_m), np.full(rays, settings.range_max_m)

    def measure(self, steps: Sequence[int], base: FloatArray, positions: FloatArray) -> FloatArray:
        """Measure all scans (worlds, robots, rays); see `Batch.scans`."""
        all_base, all_positions = self._layout.fill_in(base, positions)
        poses = all_base[:, :, :POSE_COLUMNS]
        found = [
            self._measure_world(world, step, poses[world], all_positions[world])
            for world, step in enumerate(steps)
        ]
        return np.stack(found)

    def _measure_world(
        self, world: int, step: int, base: FloatArray, positions: FloatArray
    ) -> FloatArray:
        settings, carriers = self._settings, self._layout.robot_rows
        least, most = settings.range_min_m, settings.range_max_m
        if not np.isfinite(base).all():
            return np.tile(self.limits[1], (len(carriers), 1))
        self._caster.place(base, positions)
        poses = self._places.find_poses(base, positions)
        exact = limit_ranges(self._caster.cast(settings, poses, carriers), settings)
        noisy = self._noises[world].apply_to_ranges(
            exact, step, range_min_m=least, range_max_m=most
        )
        return np.clip(noisy, least, most)


class BatchImus:
    """The inertial units of all robots; a row for each robot of each world.

    Attributes:
        numbers: See `Batch.imu`; at rest and upright before the first measurement.
    """

    def __init__(self, environment: Environment, layout: WorldLayout, worlds: int) -> None:
        """Prepare the rows; see `BatchSensors`."""
        self._layout = layout
        robots = zip(layout.names, layout.models, strict=True)
        self._sensors = [(name, _find_sensor("imu", name, model)) for name, model in robots]
        mounted = [
            mount_sensors(model)[list_state_sensors(model).index(sensor)]
            for model, (_, sensor) in zip(layout.models, self._sensors, strict=True)
        ]
        _require_equal("imu", mounted)
        joints = {len(model.joints) for model in layout.models}
        _require_equal("imu", sorted(joints))
        self._joints = layout.first_joints[:, None] + np.arange(joints.pop())
        self._units: list[StateSensor] = [
            make_state_sensor(mounted[0], environment) for _ in range(worlds)
        ]
        """Units of each world, which has a time of its own."""
        gx, gy, gz = environment.gravity
        self._at_rest = np.array([*IDENTITY, 0.0, 0.0, 0.0, -gx, -gy, -gz])
        self.numbers: FloatArray = np.tile(self._at_rest, (worlds, len(self._sensors), 1))

    def restart(self, world: int, seed: int) -> None:
        """See `BatchSensors.restart`."""
        start = self._layout.start.base[self._layout.robot_rows].tolist()
        identities = [
            SensorIdentity(make_noise_key(seed, name, sensor), tuple(state))
            for (name, sensor), state in zip(self._sensors, start, strict=True)
        ]
        self.numbers[world] = self._at_rest
        self._units[world].reset()
        self._units[world].remap(identities, np.full(len(identities), NEW_ROW))

    def take(
        self,
        times_ns: Sequence[int],
        base: FloatArray,
        joints: tuple[FloatArray, FloatArray],
    ) -> None:
        """See `BatchSensors.take`."""
        own = base[:, self._layout.robots]
        positions, velocities = (values[:, self._joints] for values in joints)
        for world, (unit, time_ns) in enumerate(zip(self._units, times_ns, strict=True)):
            state = StateRows(time_ns, own[world], positions[world], velocities[world])
            rows = unit.take(state)
            if len(rows):
                self.numbers[world, rows] = unit.find_numbers(unit.outputs[IMU.name], rows)
