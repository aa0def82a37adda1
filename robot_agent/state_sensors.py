"""Sensors of a robot's own state, as arrays with a row per robot; the same for one robot."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import msgspec
import numpy as np

from zensim.proto.drives.array_math import ARRAY_MATH
from zensim.proto.geodesy import WorldGeodesy
from zensim.proto.message_paths import POSITION_AXES, QUATERNION_AXES
from zensim.proto.messages.agent_messages import STATE_COLUMNS, Claim
from zensim.proto.messages.model_messages import IDENTITY, Sensor
from zensim.proto.messages.sensing_messages import Environment, SphericalCoordinates
from zensim.proto.messages.sensor_messages import (
    AirPressureSensor,
    AltimeterSensor,
    ImuSensor,
    MagnetometerSensor,
    NavsatSensor,
    Noise,
)
from zensim.proto.messages.standard_messages import (
    NANOSECONDS,
    Altimeter,
    FluidPressure,
    Header,
    Imu,
    MagneticField,
    NavSatFix,
    Vector3Stamped,
)
from zensim.proto.rigid_transforms import conjugate, multiply, rotate
from zensim.proto.sensor_noise import SensorNoise, make_noise_key
from zensim.proto.sensor_schedule import is_due
from zensim.proto.topic_catalog import (
    AIR_PRESSURE,
    ALTIMETER,
    FIX,
    IMU,
    MAGNETIC_FIELD,
    VEL,
    TopicSpec,
)
from zensim.robot_agent.link_motion import LinkState
from zensim.robot_agent.mounted_sensors import MountedSensor
from zensim.robot_agent.robot_rows import FloatArray, IntArray, StateRows

AT_ORIGIN = (0.0, 0.0, 0.0, *IDENTITY, *(0.0,) * 6)
"""State of a root link at rest, of `STATE_COLUMNS` numbers."""
NO_ROWS: IntArray = np.zeros(0, dtype=np.int64)
NO_ESTIMATE = -1.0
"""First element of the covariance of a quantity that is not measured (sensor_msgs/msg/Imu)."""
DIAGONAL_KNOWN = 2
"""`position_covariance_type` of sensor_msgs/msg/NavSatFix."""
HALF_TURN_DEG = 180.0
"""Heading of Gazebo Classic's world beside that of its file: x is west with heading 0."""


@dataclass(frozen=True)
class SensorIdentity:
    """One sensor of one robot."""

    noise_key: int
    spawn_state: tuple[float, ...]
    """State of the root link when the robot was spawned."""


def identify_sensor(claim: Claim, sensor: Sensor) -> SensorIdentity:
    """Identify a sensor of a claimed robot."""
    key = make_noise_key(claim.environment.seed, claim.entity, sensor)
    return SensorIdentity(key, claim.spawn_state)


@dataclass(frozen=True)
class SensorOutput:
    """How the measurements of a sensor are written to one topic."""

    topic: TopicSpec
    paths: tuple[str, ...]
    """Paths of the numbers in the message."""
    columns: slice
    """Columns of the measurements that are these numbers."""


def _list_vector_paths(field: str) -> tuple[str, ...]:
    return tuple(f"{field}.{axis}" for axis in POSITION_AXES)


class StateSensor(ABC):
    """Equal sensors of many robots; measurements are made only when they are asked for."""

    outputs: ClassVar[Mapping[str, SensorOutput]]
    """Outputs by name in the topic catalog."""
    needs_state_before: ClassVar[bool] = False
    """Whether a measurement is made of the states of two messages."""

    def __init__(self, mounted: MountedSensor, environment: Environment) -> None:
        self._mounted = mounted
        self._environment = environment
        self._noise: SensorNoise | None = None
        self._spawn_states = np.zeros((0, STATE_COLUMNS))
        self._seen_step: int | None = None
        self._now: StateRows | None = None
        self._before: StateRows | None = None
        self._measured: FloatArray | None = None
        self._motion_now: LinkState[FloatArray] | None = None
        self._motion_before: LinkState[FloatArray] | None = None
        self._motion_at_spawn: LinkState[FloatArray] | None = None

    def remap(self, identities: Sequence[SensorIdentity], before: IntArray) -> None:
        """Set the robots, one per row, and the former row of each; negative if it is new."""
        keys = [one.noise_key for one in identities]
        self._noise = SensorNoise(self.list_noises(), keys, self._environment, self._mounted.compat)
        self._spawn_states = np.array([one.spawn_state or AT_ORIGIN for one in identities])
        self._now = self._now.remap(before) if self._now else None
        self._before = self._before.remap(before) if self._before else None
        self._forget_measurements()
        self._motion_at_spawn = None

    def reset(self) -> None:
        """Forget all states; time may have gone back."""
        self._seen_step = self._now = self._before = None
        self._forget_measurements()

    def take(self, state: StateRows) -> IntArray:
        """Take a state; find the rows that are due and can be measured."""
        step = state.time_ns // self._environment.step_ns
        if step % self._environment.control_steps:
            return NO_ROWS
        seen, self._seen_step = self._seen_step, step
        if not is_due(step, self._mounted.rate_hz, self._environment, seen):
            return NO_ROWS
        self._before, self._now = self._now, state
        self._motion_before, self._motion_now = self._motion_now, None
        self._measured = None
        if not self.needs_state_before:
            return np.arange(len(state.base))
        if self._before is None:
            return NO_ROWS
        return np.flatnonzero(np.isfinite(self._before.base[:, 0]))

    def find_numbers(self, output: SensorOutput, rows: IntArray) -> FloatArray:
        """Find the numbers of some rows' last messages, (m, numbers)."""
        if self._measured is None:
            self._measured = self.measure()
        return self._measured[rows, output.columns]

    @abstractmethod
    def make_template(self, topic: TopicSpec, header: Header) -> msgspec.Struct:
        """Make the message of a topic with any numbers."""

    @abstractmethod
    def list_noises(self) -> list[Noise]:
        """List the noise of each quantity."""

    @abstractmethod
    def measure(self) -> FloatArray:
        """Measure all rows, noise included; (n, columns of all outputs)."""

    def add_noise(self, exact: FloatArray) -> FloatArray:
        """Add the noise of the last message to quantities (n, quantities)."""
        if self._noise is None or self._now is None:
            return exact
        return self._noise.apply(exact, self._now.time_ns // self._environment.step_ns)

    def motion(self) -> LinkState[FloatArray]:
        """Find the motion of the sensors at the last message."""
        if self._motion_now is None:
            self._motion_now = self._find_motion(self._now)
        return self._motion_now

    def motion_before(self) -> LinkState[FloatArray]:
        """Find the motion of the sensors at the message before."""
        if self._motion_before is None:
            self._motion_before = self._find_motion(self._before)
        return self._motion_before

    def motion_at_spawn(self) -> LinkState[FloatArray]:
        """Find the motion of the sensors at spawn, with all joints at 0."""
        if self._motion_at_spawn is None:
            joints = [joint.index for joint in self._mounted.chain.joints]
            zeros = np.zeros((len(self._spawn_states), max(joints, default=-1) + 1))
            self._motion_at_spawn = self._find_motion(
                StateRows(0, self._spawn_states, zeros, zeros)
            )
        return self._motion_at_spawn

    @property
    def measured_ns(self) -> int | None:
        """Simulation time of the last message; None if nothing can be measured yet."""
        if self._now is None or (self.needs_state_before and self._before is None):
            return None
        return self._now.time_ns

    @property
    def elapsed_s(self) -> float:
        """Simulation time between the last message and the one before."""
        if self._now is None or self._before is None:
            return math.nan
        return (self._now.time_ns - self._before.time_ns) / NANOSECONDS

    def _forget_measurements(self) -> None:
        self._measured = self._motion_now = self._motion_before = None

    def _find_motion(self, state: StateRows | None) -> LinkState[FloatArray]:
        if state is None:
            raise RuntimeError("a measurement needs a state; call take() first")
        # Contiguous columns take a tenth less time.
        base = tuple(np.ascontiguousarray(state.base.T))
        positions, velocities = tuple(state.positions.T), tuple(state.velocities.T)
        return self._mounted.chain.motion(base, positions, velocities, ARRAY_MATH)


def _make_diagonal(*noises: Noise) -> tuple[float, ...]:
    """Make the 3 x 3 covariance of three quantities."""
    x, y, z = (noise.stddev**2 if noise.kind != "none" else 0.0 for noise in noises)
    return (x, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, z)


class ImuRows(StateSensor):
    """IMUs: orientation, angular velocity, and the mean specific force between two messages."""

    needs_state_before = True
    outputs: ClassVar = {
        IMU.name: SensorOutput(
            IMU,
            (
                *(f"orientation.{axis}" for axis in QUATERNION_AXES),
                *_list_vector_paths("angular_velocity"),
                *_list_vector_paths("linear_acceleration"),
            ),
            slice(0, 10),
        )
    }

    def __init__(
        self, mounted: MountedSensor, environment: Environment, settings: ImuSensor
    ) -> None:
        super().__init__(mounted, environment)
        self._settings = settings

    def make_template(self, topic: TopicSpec, header: Header) -> Imu:  # noqa: ARG002 - has one
        """See `StateSensor`."""
        no_estimate = (NO_ESTIMATE, *(0.0,) * 8)
        return Imu(
            header=header,
            orientation_covariance=(0.0,) * 9 if self._settings.has_orientation else no_estimate,
            angular_velocity_covariance=_make_diagonal(*self._settings.angular_velocity),
            linear_acceleration_covariance=_make_diagonal(*self._settings.linear_acceleration),
        )

    def list_noises(self) -> list[Noise]:
        """See `StateSensor`."""
        return [*self._settings.angular_velocity, *self._settings.linear_acceleration]

    def measure(self) -> FloatArray:
        """See `StateSensor`: orientation, angular velocity, specific force."""
        now, before, elapsed_s = self.motion(), self.motion_before(), self.elapsed_s
        back = conjugate(now.orientation)
        (ux, uy, uz), (vx, vy, vz) = before.linear, now.linear
        gx, gy, gz = self._environment.gravity
        force = ((vx - ux) / elapsed_s - gx, (vy - uy) / elapsed_s - gy, (vz - uz) / elapsed_s - gz)
        exact = np.stack([*rotate(back, now.angular), *rotate(back, force)], axis=1)
        return np.concatenate([self._find_orientations(now), self.add_noise(exact)], axis=1)

    def _find_orientations(self, now: LinkState[FloatArray]) -> FloatArray:
        found = now.orientation
        if not self._settings.has_orientation:
            return np.tile(IDENTITY, (len(found[0]), 1))
        if self._settings.reference == "spawn":
            found = multiply(conjugate(self.motion_at_spawn().orientation), found)
        return np.stack(found, axis=1)


class NavsatRows(StateSensor):
    """Satellite receivers: geodetic position, and velocity east, north and up."""

    outputs: ClassVar = {
        FIX.name: SensorOutput(FIX, ("latitude", "longitude", "altitude"), slice(0, 3)),
        VEL.name: SensorOutput(VEL, _list_vector_paths("vector"), slice(3, 6)),
    }

    def __init__(
        self, mounted: MountedSensor, environment: Environment, settings: NavsatSensor
    ) -> None:
        """Create it without rows; a world without a place is at 0 N 0 E."""
        super().__init__(mounted, environment)
        self._settings = settings
        place = environment.spherical_coordinates or SphericalCoordinates()
        if mounted.compat == "gazebo11":
            heading_deg = place.heading_deg + HALF_TURN_DEG
            place = msgspec.structs.replace(place, heading_deg=heading_deg)
        self._geodesy = WorldGeodesy(place)

    def make_template(self, topic: TopicSpec, header: Header) -> NavSatFix | Vector3Stamped:
        """See `StateSensor`."""
        if topic is VEL:
            return Vector3Stamped(header)
        across, up = self._settings.horizontal_position, self._settings.vertical_position
        covariance = _make_diagonal(across, across, up)
        return NavSatFix(
            header, position_covariance=covariance, position_covariance_type=DIAGONAL_KNOWN
        )

    def list_noises(self) -> list[Noise]:
        """See `StateSensor`; in metres east, north and up."""
        one = self._settings
        return [
            *(one.horizontal_position, one.horizontal_position, one.vertical_position),
            *(one.horizontal_velocity, one.horizontal_velocity, one.vertical_velocity),
        ]

    def measure(self) -> FloatArray:
        """See `StateSensor`: latitude, longitude [deg], altitude [m], velocity [m/s]."""
        now, turn = self.motion(), self._geodesy.to_east_north_up
        exact = [turn(np.stack(vector, axis=1)) for vector in (now.position, now.linear)]
        noisy = self.add_noise(np.concatenate(exact, axis=1))
        return np.concatenate([self._geodesy.to_geodetic(noisy[:, :3]), noisy[:, 3:]], axis=1)


class AltimeterRows(StateSensor):
    """Altimeters: height above that at spawn, and vertical velocity."""

    outputs: ClassVar = {
        ALTIMETER.name: SensorOutput(
            ALTIMETER, ("vertical_position", "vertical_velocity", "vertical_reference"), slice(0, 3)
        )
    }

    def __init__(
        self, mounted: MountedSensor, environment: Environment, settings: AltimeterSensor
    ) -> None:
        super().__init__(mounted, environment)
        self._settings = settings

    def make_template(self, topic: TopicSpec, header: Header) -> Altimeter:  # noqa: ARG002 - one
        """See `StateSensor`."""
        return Altimeter(header)

    def list_noises(self) -> list[Noise]:
        """See `StateSensor`."""
        return [self._settings.vertical_position, self._settings.vertical_velocity]

    def measure(self) -> FloatArray:
        """See `StateSensor`: height [m], velocity [m/s], height at spawn [m]."""
        now, reference = self.motion(), self.motion_at_spawn().position[2]
        exact = np.stack([now.position[2] - reference, now.linear[2]], axis=1)
        return np.concatenate([self.add_noise(exact), reference[:, None]], axis=1)


class MagnetometerRows(StateSensor):
    """Magnetometers: the field of the world in the sensor's axes."""

    outputs: ClassVar = {
        MAGNETIC_FIELD.name: SensorOutput(
            MAGNETIC_FIELD, _list_vector_paths("magnetic_field"), slice(0, 3)
        )
    }

    def __init__(
        self, mounted: MountedSensor, environment: Environment, settings: MagnetometerSensor
    ) -> None:
        super().__init__(mounted, environment)
        self._settings = settings

    def make_template(self, topic: TopicSpec, header: Header) -> MagneticField:  # noqa: ARG002
        """See `StateSensor`."""
        covariance = _make_diagonal(*self._settings.field)
        return MagneticField(header, magnetic_field_covariance=covariance)

    def list_noises(self) -> list[Noise]:
        """See `StateSensor`."""
        return list(self._settings.field)

    def measure(self) -> FloatArray:
        """See `StateSensor`: the field [T]."""
        back = conjugate(self.motion().orientation)
        return self.add_noise(np.stack(rotate(back, self._environment.magnetic_field), axis=1))


SEA_LEVEL_PA, SEA_LEVEL_K, LAPSE_K_PER_M, PRESSURE_EXPONENT = 101_325.0, 288.15, 0.0065, 5.25588
"""Constants of the troposphere. Source: ISO 2533, standard atmosphere."""


class AirPressureRows(StateSensor):
    """Barometers: the pressure of the standard atmosphere at the height of the sensor."""

    outputs: ClassVar = {
        AIR_PRESSURE.name: SensorOutput(AIR_PRESSURE, ("fluid_pressure",), slice(0, 1))
    }

    def __init__(
        self, mounted: MountedSensor, environment: Environment, settings: AirPressureSensor
    ) -> None:
        super().__init__(mounted, environment)
        self._settings = settings
        place = environment.spherical_coordinates or SphericalCoordinates()
        given = settings.reference_altitude_m
        self._origin_m = place.elevation_m if given is None else given

    def make_template(self, topic: TopicSpec, header: Header) -> FluidPressure:  # noqa: ARG002
        """See `StateSensor`."""
        return FluidPressure(header, variance=self._settings.pressure.stddev**2)

    def list_noises(self) -> list[Noise]:
        """See `StateSensor`."""
        return [self._settings.pressure]

    def measure(self) -> FloatArray:
        """See `StateSensor`: the pressure [Pa]."""
        altitude = self._origin_m + self.motion().position[2]
        share = 1.0 - LAPSE_K_PER_M * altitude / SEA_LEVEL_K
        exact = SEA_LEVEL_PA * np.maximum(share, 0.0) ** PRESSURE_EXPONENT
        return self.add_noise(exact[:, None])


def make_state_sensor(mounted: MountedSensor, environment: Environment) -> StateSensor:
    """Make the sensors of robots that are mounted alike, without rows."""
    settings = mounted.settings
    if isinstance(settings, ImuSensor):
        return ImuRows(mounted, environment, settings)
    if isinstance(settings, NavsatSensor):
        return NavsatRows(mounted, environment, settings)
    if isinstance(settings, AltimeterSensor):
        return AltimeterRows(mounted, environment, settings)
    if isinstance(settings, AirPressureSensor):
        return AirPressureRows(mounted, environment, settings)
    return MagnetometerRows(mounted, environment, settings)
