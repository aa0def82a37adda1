"""Lidars and inertial units of the robots of many equal worlds."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from zensim.api.api_errors import Invalid, NotFound, Unsupported
from zensim.api.world_host import WorldHost
from zensim.envs.world_layout import WorldLayout
from zensim.proto.messages.model_messages import IDENTITY, Model, Sensor
from zensim.proto.messages.sensing_messages import Environment
from zensim.proto.messages.sensor_messages import ImuSensor, RaySensor
from zensim.proto.sensor_noise import KeyArray, SensorNoise, make_noise_key
from zensim.proto.topic_catalog import IMU
from zensim.robot_agent.mounted_sensors import list_state_sensors, mount_sensors
from zensim.robot_agent.robot_rows import NEW_ROW, StateRows
from zensim.robot_agent.state_sensors import SensorIdentity, StateSensor, make_state_sensor
from zensim.sim_server.physics.engine import FloatArray, IntArray
from zensim.sim_server.scene.fleet_casting import WorldsCaster, are_level, make_scan_caster
from zensim.sim_server.scene.scene import SceneLayout
from zensim.sim_server.sensors.ray_sensors import limit_ranges
from zensim.sim_server.sensors.scene_roster import (
    POSE_COLUMNS,
    SceneMeshes,
    SceneRoster,
    SensorMount,
)
from zensim.spawner.client.service_client import ServiceClient

SensorName = Literal["scan", "imu"]
SENSORS: dict[str, type] = {"scan": RaySensor, "imu": ImuSensor}
IMU_LIMITS = np.array([1.0] * 4 + [100.0] * 3 + [1000.0] * 3)
"""Limits of quaternion, angular velocity [rad/s] and specific force [m/s^2] in observations."""


class BatchSensors:
    """What a batch measures; the noise of a world depends on its seed and its own step alone."""

    def __init__(
        self, server: WorldHost, layout: WorldLayout, worlds: int, names: Sequence[SensorName]
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
        self._lidars = BatchLidars(server, layout, worlds) if "scan" in names else None
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
        self, times_ns: Sequence[int], base: FloatArray, joints: tuple[FloatArray, FloatArray]
    ) -> None:
        """Take the states after a control step.

        Args:
            times_ns: Of each world, since its restart.
            base: (worlds, m, 13) of what is read.
            joints: Positions and velocities, (worlds, k).
        """
        if self._imus is not None:
            self._imus.take(times_ns, base, joints)

    def save(self) -> KeyArray:
        """Copy what measurements depend on beside states and steps.

        Raises:
            Unsupported: Inertial units have states of their own.
        """
        if self._imus is not None:
            raise Unsupported("a batch with inertial units cannot be saved", hint="leave out imu")
        return np.zeros((0, 0), np.uint64) if self._lidars is None else self._lidars.keys.copy()

    def load(self, keys: KeyArray) -> None:
        """Put back what `save` returned."""
        if self._lidars is not None:
            self._lidars.take_keys(keys)

    def read_imu(self) -> FloatArray:
        """See `Batch.imu`."""
        if self._imus is None:
            raise Invalid("this batch measures no imu", hint="make it with sensors=('imu',)")
        return np.array(self._imus.numbers)

    def measure_scans(self, steps: IntArray, base: FloatArray, positions: FloatArray) -> FloatArray:
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
    """The lidars of all robots of all worlds, cast at once.

    Attributes:
        keys: Of their noise, (worlds, robots).
    """

    def __init__(self, server: WorldHost, layout: WorldLayout, worlds: int) -> None:
        """Prepare the scenes; see `BatchSensors`."""
        self._layout = layout
        roster = SceneRoster(ServiceClient(server.network, server.world.name).models())
        self._environment = roster.environment
        meshes = SceneMeshes(server.network, server.world.name)
        meshes.fetch(roster.meshes)
        robots = zip(layout.names, layout.models, strict=True)
        self._sensors = [(name, _find_sensor("scan", name, model)) for name, model in robots]
        settings = [sensor.settings for _, sensor in self._sensors]
        _require_equal("scan", settings)
        assert isinstance(settings[0], RaySensor)
        self._settings = settings[0]
        self._mounts = [
            SensorMount(model, sensor)
            for model, (_, sensor) in zip(layout.models, self._sensors, strict=True)
        ]
        own = roster.make_layout(meshes)
        self._caster = make_scan_caster(own)
        start = layout.start
        self._worlds_caster = WorldsCaster(
            own.place_fixed(start.base, start.joint_positions),
            SceneLayout([roster.models[row] for row in layout.read] * worlds, meshes.find_corners),
            len(layout.read),
            len(layout.entities),
        )
        self.keys = np.zeros((worlds, len(self._sensors)), np.uint64)
        self._noises: list[SensorNoise] = []
        """One for all rows, or one for each world if it has a bias that walks; empty if old."""

    def restart(self, world: int, seed: int) -> None:
        """See `BatchSensors.restart`."""
        self.keys[world] = [make_noise_key(seed, name, sensor) for name, sensor in self._sensors]
        self._noises = []

    def take_keys(self, keys: KeyArray) -> None:
        """Set the keys (worlds, robots) of the noise."""
        self.keys[:] = keys
        self._noises = []

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Least and greatest range of each ray."""
        settings = self._settings
        rays = settings.horizontal.count * settings.vertical.count
        return np.full(rays, settings.range_min_m), np.full(rays, settings.range_max_m)

    def measure(self, steps: IntArray, base: FloatArray, positions: FloatArray) -> FloatArray:
        """Measure all scans (worlds, robots, rays); see `Batch.scans`."""
        is_lost = np.asarray(~np.isfinite(base).all(axis=(1, 2)))
        if is_lost.any():
            start = self._layout.start
            base = np.where(is_lost[:, None, None], start.base[self._layout.read], base)
            start_positions = start.joint_positions[self._layout.read_joints]
            positions = np.where(is_lost[:, None], start_positions, positions)
        found = self._add_noise(limit_ranges(self._cast(base, positions), self._settings), steps)
        low, high = self.limits
        found = np.clip(found, low, high).reshape(*self.keys.shape, -1)
        found[is_lost] = high
        return found

    def _cast(self, base: FloatArray, positions: FloatArray) -> FloatArray:
        """Cast all rays (worlds * robots, rays)."""
        worlds, models = base.shape[:2]
        poses = self._find_poses(base, positions)
        if not are_level(self._settings, poses).all():
            return self._cast_by_world(base, positions, poses)
        state = base[..., :POSE_COLUMNS].reshape(-1, POSE_COLUMNS), positions.reshape(-1)
        carriers = np.arange(worlds)[:, None] * models + self._layout.robots
        return self._worlds_caster.cast(self._settings, poses, carriers.reshape(-1), state)

    def _cast_by_world(
        self, base: FloatArray, positions: FloatArray, poses: FloatArray
    ) -> FloatArray:
        """Cast the rays of lidars that are not level, world by world."""
        robots, found = self._layout.robot_rows, []
        all_base, all_positions = self._layout.fill_in(base, positions)
        own = poses.reshape(len(base), len(robots), POSE_COLUMNS)
        for world, placed in enumerate(own):
            self._caster.place(all_base[world, :, :POSE_COLUMNS], all_positions[world])
            found.append(self._caster.cast(self._settings, placed, robots))
        return np.concatenate(found)

    def _find_poses(self, base: FloatArray, positions: FloatArray) -> FloatArray:
        """Find the poses (worlds * robots, 7) of the sensors."""
        layout = self._layout
        found = [
            mount.find_poses(base[:, row, :POSE_COLUMNS], positions[:, first + mount.joints])
            for mount, row, first in zip(
                self._mounts, layout.robots, layout.first_joints, strict=True
            )
        ]
        return np.stack(found, axis=1).reshape(-1, POSE_COLUMNS)

    def _add_noise(self, ranges: FloatArray, steps: IntArray) -> FloatArray:
        settings, robots = self._settings, self.keys.shape[1]
        if not self._noises:
            self._noises = [self._make_noise(self.keys.reshape(-1))]
            if not self._noises[0].is_counted_by_row:
                self._noises = [self._make_noise(keys) for keys in self.keys]
        limits = {"range_min_m": settings.range_min_m, "range_max_m": settings.range_max_m}
        if self._noises[0].is_counted_by_row:
            counters = np.repeat(steps, robots).astype(np.uint64)
            return self._noises[0].apply_to_ranges(ranges, counters, **limits)
        parts = zip(self._noises, np.split(ranges, len(steps)), steps.tolist(), strict=True)
        return np.concatenate(
            [noise.apply_to_ranges(part, step, **limits) for noise, part, step in parts]
        )

    def _make_noise(self, keys: KeyArray) -> SensorNoise:
        compat = self._sensors[0][1].compat
        return SensorNoise([self._settings.noise], keys, self._environment, compat)


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
        self, times_ns: Sequence[int], base: FloatArray, joints: tuple[FloatArray, FloatArray]
    ) -> None:
        """See `BatchSensors.take`."""
        own = base[:, self._layout.robots]
        positions, velocities = (values[:, self._joints] for values in joints)
        for world, (unit, time_ns) in enumerate(zip(self._units, times_ns, strict=True)):
            state = StateRows(time_ns, own[world], positions[world], velocities[world])
            rows = unit.take(state)
            if len(rows):
                self.numbers[world, rows] = unit.find_numbers(unit.outputs[IMU.name], rows)
