"""IMU, navsat, altimeter and magnetometer: closed forms, in real engines and without."""

import math
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from tests.engines import STEP_NS, MakeEngine
from tests.models import a_body, a_box, a_box_bot, a_state, box_bot_at
from zensim.proto.messages.drive_messages import Compat
from zensim.proto.messages.model_messages import Joint, Link, Model, Origin, Sensor
from zensim.proto.messages.sensing_messages import Environment, SphericalCoordinates
from zensim.proto.messages.sensor_messages import (
    AirPressureSensor,
    AltimeterSensor,
    ImuSensor,
    MagnetometerSensor,
    NavsatSensor,
    Noise,
    SensorSettings,
    SensorTopic,
)
from zensim.proto.messages.standard_messages import Header, Imu, NavSatFix
from zensim.proto.rigid_transforms import from_rpy
from zensim.robot_agent.mounted_sensors import mount_sensors
from zensim.robot_agent.robot_rows import FloatArray, StateRows
from zensim.robot_agent.state_sensors import SensorIdentity, StateSensor, make_state_sensor
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import Engine
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine

GRAVITY = 9.81
CONTROL_STEPS = 3
CONTROL_S = CONTROL_STEPS * STEP_NS * 1e-9
ENVIRONMENT = Environment(
    seed=4,
    gravity=(0.0, 0.0, -GRAVITY),
    magnetic_field=(2e-5, 1e-5, -4e-5),
    spherical_coordinates=SphericalCoordinates(48.0, 11.0, 500.0),
    step_ns=STEP_NS,
    control_steps=CONTROL_STEPS,
)
TOPICS = {
    ImuSensor: ("imu",),
    NavsatSensor: ("fix", "vel"),
    AltimeterSensor: ("altimeter",),
    MagnetometerSensor: ("magnetic_field",),
    AirPressureSensor: ("air_pressure",),
}
ENGINES = (PyBulletEngine, MujocoEngine)
AT_LINK = Origin()


def with_sensor(
    model: Model,
    settings: SensorSettings,
    *,
    link: str = "",
    origin: Origin = AT_LINK,
    rate_hz: float = 0.0,
    compat: Compat = "fixed",
) -> Model:
    link = link or model.links[0].name
    topics = tuple(SensorTopic(topic, topic) for topic in TOPICS[type(settings)])
    sensor = Sensor(
        *("sensor", "any", link, link, origin, rate_hz),
        settings=settings,
        topics=topics,
        frame_id=link,
        compat=compat,
    )
    return msgspec.structs.replace(model, sensors=(sensor,))


def make_sensor(
    model: Model,
    environment: Environment = ENVIRONMENT,
    count: int = 1,
    spawn: FloatArray | None = None,
) -> StateSensor:
    (mounted,) = mount_sensors(model)
    sensor = make_state_sensor(mounted, environment)
    spawn_state = () if spawn is None else tuple(spawn.tolist())
    identities = [SensorIdentity(1000 + row, spawn_state) for row in range(count)]
    sensor.remap(identities, np.full(count, -1))
    return sensor


def measure(sensor: StateSensor, topic: str) -> FloatArray:
    return np.asarray(sensor.find_numbers(sensor.outputs[topic], np.array([0]))[0])


def rows_of(
    step: int, *states: FloatArray, positions: FloatArray | None = None, velocity: float = 0.0
) -> StateRows:
    joints = np.zeros((len(states), 0)) if positions is None else positions
    return StateRows(step * STEP_NS, np.array(states), joints, np.full(joints.shape, velocity))


def run_imu(
    engine: Engine, model: Model, body: int, sensor: StateSensor, seconds: float, start: int = 0
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Step an engine; yield the state and the numbers of each IMU message."""
    joints = len(model.joints)
    for step in range(start + 1, start + round(seconds / STEP_NS * 1e9) + 1):
        engine.step()
        if step % CONTROL_STEPS:
            continue
        read = engine.read((body,))
        rows = StateRows(
            step * STEP_NS,
            read.base,
            read.joint_positions.reshape(1, joints),
            read.joint_velocities.reshape(1, joints),
        )
        if len(sensor.take(rows)):
            yield read.base[0], measure(sensor, "imu")


def make_engine(kind: MakeEngine, *, gravity: float = GRAVITY) -> Engine:
    return kind(EngineConfig(STEP_NS, gravity=(0.0, 0.0, -gravity)))


@pytest.fixture(params=ENGINES, ids=lambda kind: kind.__name__)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    made = make_engine(request.param)
    yield made
    made.close()


@pytest.fixture(params=ENGINES, ids=lambda kind: kind.__name__)
def weightless_engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    made = make_engine(request.param, gravity=0.0)
    yield made
    made.close()


def test_imu_at_rest_feels_gravity_upwards(engine: Engine) -> None:
    model = with_sensor(a_box_bot(), ImuSensor())
    body = engine.add(model, box_bot_at())
    list(run_imu(engine, model, body, make_sensor(model), 1.0))

    found = np.array(
        [numbers for _, numbers in run_imu(engine, model, body, make_sensor(model), 1)]
    )

    assert found[:, 7:].mean(axis=0) == pytest.approx([0.0, 0.0, GRAVITY], abs=0.02)
    assert found[:, 4:7].mean(axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=0.01)


def test_imu_in_an_arc_feels_the_pull_to_its_centre(engine: Engine) -> None:
    model = with_sensor(a_box_bot(), ImuSensor())
    body, sensor = engine.add(model, box_bot_at()), make_sensor(model)
    engine.command((body,), np.array([0.2 - 0.055, 0.2 + 0.055]) / 0.035)
    list(run_imu(engine, model, body, sensor, 2.0))

    told = list(run_imu(engine, model, body, sensor, 6.0, start=480))

    states = np.array([state for state, _ in told])
    found = np.array([numbers for _, numbers in told])
    speed, turn_rate = np.hypot(states[:, 7], states[:, 8]).mean(), states[:, 12].mean()
    assert speed == pytest.approx(0.2, rel=0.03)
    assert found[:, 8].mean() == pytest.approx(speed * turn_rate, rel=0.02)
    assert found[:, 6].mean() == pytest.approx(turn_rate, rel=1e-3)
    assert found[:, 9].mean() == pytest.approx(GRAVITY, abs=0.02)


def test_imu_in_free_fall_feels_nothing(engine: Engine) -> None:
    model = with_sensor(a_box(), ImuSensor())
    body = engine.add(model, a_state((0.0, 0.0, 8.0)))

    told = list(run_imu(engine, model, body, make_sensor(model), 1.0))

    assert len(told) == 79
    assert np.abs([numbers[7:] for _, numbers in told]).max() < 1e-3


def test_imu_dropped_feels_all_of_the_impact(engine: Engine) -> None:
    model = with_sensor(a_box(), ImuSensor())
    body = engine.add(model, a_state((0.0, 0.0, 0.3)))

    told = list(run_imu(engine, model, body, make_sensor(model), 2.0))

    force = np.array([numbers[9] for _, numbers in told])
    first, last = told[0][0][9], told[-1][0][9]
    assert force[0] == pytest.approx(0.0, abs=1e-3)
    assert force.max() > 5.0 * GRAVITY
    assert last == pytest.approx(0.0, abs=0.01)
    felt = force[1:].sum() * CONTROL_S
    assert felt == pytest.approx(last - first + GRAVITY * (len(told) - 1) * CONTROL_S, rel=0.01)


def test_imu_away_from_the_centre_feels_the_turning(weightless_engine: Engine) -> None:
    arm_m, turn_rate = 0.3, 2.0
    model = with_sensor(a_box(), ImuSensor(), origin=Origin((arm_m, 0.0, 0.0)))
    spin = a_state((0.0, 0.0, 5.0), angular=(0.0, 0.0, turn_rate))
    body = weightless_engine.add(model, spin)
    weightless_engine.set_base_state(body, spin)
    sensor = make_sensor(model, msgspec.structs.replace(ENVIRONMENT, gravity=(0.0, 0.0, 0.0)))

    told = list(run_imu(weightless_engine, model, body, sensor, 1.0))

    for state, numbers in told:
        assert numbers[7] == pytest.approx(-(state[12] ** 2) * arm_m, rel=0.02)
        assert numbers[6] == pytest.approx(state[12], rel=1e-6)
    assert told[0][0][12] == pytest.approx(turn_rate, rel=0.02)


def test_imu_on_a_moving_link_follows_its_joint() -> None:
    """A turntable at rest whose joint turns: the IMU turns with it."""
    arm_m, turn_rate = 0.2, 3.0
    joint = Joint("turn", "continuous", "base", "table", Origin((1.0, 0.0, 0.5)), (0.0, 0.0, 1.0))
    table = Model("table", (Link("base", a_body()), Link("table", a_body())), (joint,))
    model = with_sensor(table, ImuSensor(), link="table", origin=Origin((arm_m, 0.0, 0.1)))
    sensor = make_sensor(model)

    for step in range(0, 60, CONTROL_STEPS):
        angle = np.array([[turn_rate * step * STEP_NS * 1e-9]])
        sensor.take(rows_of(step, a_state(), positions=angle, velocity=turn_rate))
    found = measure(sensor, "imu")

    assert found[4:7] == pytest.approx([0.0, 0.0, turn_rate])
    assert found[7] == pytest.approx(-(turn_rate**2) * arm_m, rel=0.01)
    assert found[9] == pytest.approx(GRAVITY)
    assert found[:4] == pytest.approx(from_rpy(0.0, 0.0, float(angle[0, 0])))


def test_imu_has_the_axes_of_its_mounting() -> None:
    model = with_sensor(a_box(), ImuSensor(), origin=Origin((0, 0, 0), from_rpy(math.pi, 0, 0)))
    sensor = make_sensor(model)

    for step in (0, 3):
        sensor.take(rows_of(step, a_state(angular=(0.1, 0.2, 0.3))))

    assert measure(sensor, "imu")[4:] == pytest.approx([0.1, -0.2, -0.3, 0, 0, -GRAVITY])


def test_imu_may_tell_its_orientation_relative_to_that_at_spawn() -> None:
    spawn = a_state(turn=(0.0, 0.0, 1.0))
    model = with_sensor(a_box(), ImuSensor(reference="spawn"))
    sensor = make_sensor(model, spawn=spawn)

    for step in (0, 3):
        sensor.take(rows_of(step, a_state(turn=(0.0, 0.0, 1.4))))

    assert measure(sensor, "imu")[:4] == pytest.approx(from_rpy(0.0, 0.0, 0.4))


def test_imu_message_tells_the_variances_of_its_noise() -> None:
    quiet, loud = Noise("gaussian", stddev=0.1), Noise("gaussian", stddev=0.2)
    settings = ImuSensor((quiet, quiet, loud), (loud, loud, Noise()), has_orientation=False)
    sensor = make_sensor(with_sensor(a_box(), settings))

    message = sensor.make_template(sensor.outputs["imu"].topic, Header(frame_id="box"))

    assert isinstance(message, Imu)
    assert message.header.frame_id == "box"
    assert message.orientation_covariance[0] == -1.0
    assert message.angular_velocity_covariance[::4] == pytest.approx((0.01, 0.01, 0.04))
    assert message.linear_acceleration_covariance[::4] == pytest.approx((0.04, 0.04, 0.0))


def test_noise_of_an_imu_has_its_mean_and_deviation() -> None:
    noise = (Noise("gaussian", mean=0.1, stddev=0.05),) * 3
    sensor = make_sensor(with_sensor(a_box(), ImuSensor(noise, noise)), count=200)
    numbers = []

    for step in range(0, 300, CONTROL_STEPS):
        rows = sensor.take(rows_of(step, *[a_state()] * 200))
        if len(rows):
            numbers.append(sensor.find_numbers(sensor.outputs["imu"], rows))

    found = np.concatenate(numbers)
    exact = [0.1, 0.1, 0.1, 0.1, 0.1, GRAVITY + 0.1]
    assert found[:, 4:].mean(axis=0) == pytest.approx(exact, abs=0.002)
    assert found[:, 4:].std(axis=0) == pytest.approx([0.05] * 6, rel=0.03)


def test_sensor_is_due_at_its_rate_and_only_at_control_steps() -> None:
    model = with_sensor(a_box(), MagnetometerSensor(), rate_hz=10.0)
    sensor = make_sensor(model)

    due = [step for step in range(241) if len(sensor.take(rows_of(step, a_state())))]

    assert due == list(range(0, 241, 24))


def test_sensor_is_not_due_twice_at_one_step() -> None:
    sensor = make_sensor(with_sensor(a_box(), MagnetometerSensor()))

    assert [len(sensor.take(rows_of(step, a_state()))) for step in (3, 3, 6, 6)] == [1, 0, 1, 0]


def test_sensor_starts_again_after_a_reset() -> None:
    sensor = make_sensor(with_sensor(a_box(), ImuSensor()))
    due = [len(sensor.take(rows_of(step, a_state()))) for step in (6, 9)]

    sensor.reset()

    assert sensor.measured_ns is None
    again = [len(sensor.take(rows_of(step, a_state()))) for step in (0, 3)]
    assert due == again == [0, 1]


def test_imu_of_a_new_robot_waits_for_its_second_state_while_others_go_on() -> None:
    sensor = make_sensor(with_sensor(a_box(), ImuSensor()))
    still, other = a_state(), a_state(linear=(1.0, 0.0, 0.0))
    for step in (0, 3):
        sensor.take(rows_of(step, still))

    sensor.remap([SensorIdentity(1, ()), SensorIdentity(1000, ())], np.array([-1, 0]))

    assert sensor.take(rows_of(6, other, still)).tolist() == [1]
    assert sensor.take(rows_of(9, other, still)).tolist() == [0, 1]
    found = sensor.find_numbers(sensor.outputs["imu"], np.array([0, 1]))
    assert found[:, 7:] == pytest.approx(np.array([[0, 0, GRAVITY]] * 2), abs=1e-12)


def test_measurements_do_not_depend_on_who_asked_before() -> None:
    noise = (Noise("gaussian", stddev=0.05),) * 3
    model = with_sensor(a_box(), ImuSensor(noise, noise))
    asked, silent = make_sensor(model), make_sensor(model)

    for step in range(0, 30, 3):
        state = rows_of(step, a_state(linear=(0.01 * step**2, 0.0, 0.0)))
        for sensor in (asked, silent):
            sensor.take(state)
        if step > 3:
            measure(asked, "imu")

    assert measure(asked, "imu").tobytes() == measure(silent, "imu").tobytes()


def a_navsat(compat: Compat = "fixed", noise: float = 0.0, heading_deg: float = 0.0) -> StateSensor:
    position = Noise("gaussian", stddev=noise)
    settings = NavsatSensor(position, position)
    place = SphericalCoordinates(48.0, 11.0, 500.0, heading_deg)
    environment = msgspec.structs.replace(ENVIRONMENT, spherical_coordinates=place)
    return make_sensor(with_sensor(a_box(), settings, compat=compat), environment)


@pytest.mark.parametrize(
    ("compat", "heading_deg", "east", "north"),
    [("fixed", 0.0, 3.0, 4.0), ("gazebo11", 0.0, -3.0, -4.0), ("fixed", 90.0, -4.0, 3.0)],
)
def test_navsat_tells_the_place_and_the_velocity_to_east_and_north(
    compat: Compat, heading_deg: float, east: float, north: float
) -> None:
    sensor = a_navsat(compat, heading_deg=heading_deg)

    sensor.take(rows_of(0, a_state((300.0, 400.0, 10.0), linear=(3.0, 4.0, 1.0))))

    latitude, longitude, altitude = measure(sensor, "fix")
    assert measure(sensor, "vel") == pytest.approx([east, north, 1.0])
    # A degree is 111.2 km of latitude at 48 N, and 74.6 km of longitude.
    assert (latitude - 48.0) * 111_206 == pytest.approx(100.0 * north, rel=1e-3)
    assert (longitude - 11.0) * 74_628 == pytest.approx(100.0 * east, rel=1e-3)
    assert altitude == pytest.approx(510.0, abs=0.03)


def test_navsat_has_noise_in_metres() -> None:
    sensor, exact = a_navsat(noise=0.5), a_navsat()
    errors = []
    for step in range(0, 6000, 3):
        for one in (sensor, exact):
            one.take(rows_of(step, a_state()))
        errors.append(measure(sensor, "fix") - measure(exact, "fix"))

    metres = np.array(errors) * [111_206, 74_628, 1.0]
    assert metres.std(axis=0) == pytest.approx([0.5, 0.5, 0.5], rel=0.06)
    message = sensor.make_template(sensor.outputs["fix"].topic, Header())
    assert isinstance(message, NavSatFix)
    assert message.position_covariance[::4] == (0.25, 0.25, 0.25)
    assert message.position_covariance_type == 2


def test_altimeter_tells_the_height_above_that_at_spawn() -> None:
    model = with_sensor(a_box(), AltimeterSensor(), origin=Origin((0.0, 0.0, 0.2)))
    sensor = make_sensor(model, spawn=a_state((0.0, 0.0, 1.0)))

    sensor.take(rows_of(0, a_state((5.0, 0.0, 1.7), linear=(1.0, 0.0, -0.3))))

    assert measure(sensor, "altimeter") == pytest.approx([0.7, -0.3, 1.2])


@pytest.mark.parametrize(
    ("settings", "height", "pressure"),
    [
        (AirPressureSensor(), 0.0, 95_461.0),
        (AirPressureSensor(), 500.0, 89_875.0),
        (AirPressureSensor(reference_altitude_m=0.0), 0.0, 101_325.0),
        (AirPressureSensor(reference_altitude_m=5000.0), 0.0, 54_020.0),
    ],
)
def test_air_pressure_is_that_of_the_standard_atmosphere(
    settings: AirPressureSensor, height: float, pressure: float
) -> None:
    sensor = make_sensor(with_sensor(a_box(), settings))

    sensor.take(rows_of(0, a_state((0.0, 0.0, height))))

    assert measure(sensor, "air_pressure") == pytest.approx([pressure], abs=1.0)


def test_magnetometer_tells_the_field_in_its_axes() -> None:
    sensor = make_sensor(with_sensor(a_box(), MagnetometerSensor()))

    sensor.take(rows_of(0, a_state(turn=(0.0, 0.0, math.pi / 2.0))))

    assert measure(sensor, "magnetic_field") == pytest.approx([1e-5, -2e-5, -4e-5])
