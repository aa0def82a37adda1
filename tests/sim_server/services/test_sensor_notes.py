"""Report entries on sensors that depend on the world and on the hosts of sensor processes."""

import msgspec
import pytest

from tests.sim_server.fakes import a_world, make_parts
from tests.sim_server.orders import an_order, spawned, suspicions
from zensim.proto.messages.model_messages import Link, Model, Origin, Sensor, Shape
from zensim.proto.messages.sensing_messages import Environment, SphericalCoordinates
from zensim.proto.messages.sensor_messages import (
    CameraSensor,
    ImuSensor,
    NavsatSensor,
    RaySensor,
    ScanAxis,
    SensorSettings,
)
from zensim.proto.messages.spawn_messages import Resource
from zensim.proto.sensor_libraries import LIBRARIES, Library
from zensim.sim_server.description.world_model import PlacedModel, WorldModel
from zensim.sim_server.services import sensor_notes
from zensim.sim_server.services.sensor_notes import make_library_notes, make_world_notes

IMU_SETTINGS = ImuSensor()


def a_sensing_model(*sensors: Sensor) -> Model:
    return Model("r", (Link("base"),), sensors=sensors)


def a_rated_sensor(rate_hz: float, settings: SensorSettings | None = IMU_SETTINGS) -> Sensor:
    return Sensor("s", "imu", "base", "base", update_rate_hz=rate_hz, settings=settings)


PLACE = SphericalCoordinates(latitude_deg=52.0)
CONTROL_AT_80_HZ = Environment(step_ns=4_166_667, control_steps=3, spherical_coordinates=PLACE)


@pytest.mark.parametrize(("rate_hz", "count"), [(0.0, 0), (10.0, 0), (80.0, 0), (200.0, 1)])
def test_sensor_above_the_control_rate_is_reported(rate_hz: float, count: int) -> None:
    model = a_sensing_model(a_rated_sensor(rate_hz))

    notes = [*make_world_notes(model, CONTROL_AT_80_HZ)]

    assert [note.status for note in notes] == ["suspicious"] * count
    assert all("80 Hz" in note.reason for note in notes)


def test_rate_of_a_sensor_that_is_not_simulated_is_not_reported() -> None:
    model = a_sensing_model(a_rated_sensor(200.0, settings=None))

    assert [*make_world_notes(model, CONTROL_AT_80_HZ)] == []


def test_navsat_without_a_place_of_the_world_is_reported() -> None:
    model = a_sensing_model(a_rated_sensor(1.0, NavsatSensor()))
    nowhere = msgspec.structs.replace(CONTROL_AT_80_HZ, spherical_coordinates=None)

    assert [*make_world_notes(model, CONTROL_AT_80_HZ)] == []
    assert len([*make_world_notes(model, nowhere)]) == 1


def test_spawn_reports_sensors_above_the_control_rate() -> None:
    parts = make_parts(a_world())
    order = msgspec.structs.replace(an_order(), entity_resource=Resource(resource_string=FAST_IMU))

    assert any("control steps a second" in reason for reason in suspicions(spawned(parts, order)))


def a_world_file(*heights: float) -> WorldModel:
    """Static boxes 10 m away, of these heights."""
    boxes = [
        Model(f"b{place}", (Link("base", collisions=(Shape("box", (1.0, 1.0, height)),)),))
        for place, height in enumerate(heights)
    ]
    return WorldModel(
        "boxes",
        models=tuple(
            PlacedModel(box.name, box, Origin((10.0, 0.0, height / 2.0)))
            for box, height in zip(boxes, heights, strict=True)
        ),
    )


@pytest.mark.parametrize(
    ("heights", "count"), [((), 0), ((0.01,), 0), ((0.1,), 1), ((0.1, 0.2), 0)]
)
def test_lidar_above_all_of_a_world_is_reported(heights: tuple[float, ...], count: int) -> None:
    parts = make_parts(a_world())
    parts.current_world.model = a_world_file(*heights)
    order = msgspec.structs.replace(an_order(), entity_resource=Resource(uri="box_bot_lidar"))

    found = [reason for reason in suspicions(spawned(parts, order)) if "level rays" in reason]

    # The lidar of a standing robot is 0.13 m high.
    assert len(found) == count
    assert all("0.13 m" in reason for reason in found)


ROW = ScanAxis(360, -1.0, 1.0)
LEVEL, HEAVY = RaySensor(ROW), RaySensor(ROW, ScanAxis(16, -0.2, 0.2))
LIGHT = RaySensor(ScanAxis(10, -1.0, 1.0), ScanAxis(4, -0.2, 0.2))
LEANING = Origin(orientation=(0.0, 0.0998334, 0.0, 0.9950042))
"""By 0.2 rad about y."""
NONE: frozenset[Library] = frozenset()
ALL = frozenset(LIBRARIES)
NO_OPENGL: frozenset[Library] = frozenset({"opengl"})
NO_EMBREE: frozenset[Library] = frozenset({"embree"})


def find_slugs(settings: SensorSettings, origin: Origin, *hosts: frozenset[Library]) -> list[str]:
    """List the slugs of notes on a sensor at 10 Hz with processes on hosts that lack libraries."""
    model = a_sensing_model(a_rated_sensor(10.0, settings))
    missing = {f"s{number}": host for number, host in enumerate(hosts)}
    notes = [*make_library_notes(model, {"base": origin}, CONTROL_AT_80_HZ, missing)]
    assert {note.status for note in notes} <= {"suspicious"}
    return [note.reason.partition(":")[0] for note in notes]


@pytest.mark.parametrize(
    ("settings", "host", "slugs"),
    [
        (CameraSensor(), NONE, []),
        (CameraSensor(), NO_OPENGL, ["sensor.slow_renderer"]),
        (CameraSensor(), NO_EMBREE, []),
        (CameraSensor(), ALL, ["sensor.no_renderer"]),
        (LEVEL, ALL, []),
        (LIGHT, ALL, ["sensor.slow_rays"]),
        (HEAVY, NO_OPENGL, []),
        (HEAVY, ALL, ["sensor.no_embree"]),
        (ImuSensor(), ALL, []),
    ],
)
def test_sensor_that_the_only_process_cannot_measure_is_reported(
    settings: SensorSettings, host: frozenset[Library], slugs: list[str]
) -> None:
    assert find_slugs(settings, Origin(), host) == slugs


def test_lidar_that_leans_needs_embree() -> None:
    assert find_slugs(LEVEL, LEANING, ALL) == ["sensor.slow_rays"]


def test_sensor_that_one_of_several_processes_can_measure_is_not_reported() -> None:
    assert find_slugs(CameraSensor(), Origin(), ALL, NONE) == []
    assert find_slugs(CameraSensor(), Origin(), ALL, NO_OPENGL) == ["sensor.slow_renderer"]


def test_host_of_the_server_is_judged_without_a_sensor_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sensor_notes, "find_missing_libraries", lambda: dict.fromkeys(ALL, ""))

    assert find_slugs(CameraSensor(), Origin()) == ["sensor.no_renderer"]
    assert find_slugs(CameraSensor(), Origin(), NONE) == []


def test_spawn_reports_what_the_sensor_processes_lack() -> None:
    parts = make_parts(a_world())
    order = msgspec.structs.replace(an_order(), entity_resource=Resource(uri="box_bot_camera"))
    parts.sensors.note_missing("s1", NONE, is_alive=True)
    before = suspicions(spawned(parts, order))

    parts.sensors.note_missing("s1", ALL, is_alive=True)
    parts.sensors.note_missing("s1", NONE, is_alive=False)
    second = msgspec.structs.replace(order, name="second")
    after = suspicions(spawned(parts, second))

    assert not any(reason.startswith("sensor.") for reason in before)
    assert [reason for reason in after if reason.startswith("sensor.no_renderer: ")]


def test_spawn_reports_topics_and_rates_of_sensors_as_they_are() -> None:
    parts = make_parts(a_world())
    order = msgspec.structs.replace(an_order(), entity_resource=Resource(resource_string=FAST_IMU))

    report = spawned(parts, order).report

    true_hz = 1e9 / (parts.world.clock.step_ns * parts.world.control_steps)
    (entry,) = [one for one in report if one.subject == "sensor 'imu' on 'base'"]
    assert entry.status == "applied"
    assert entry.reason.startswith("Imu on r/imu; frame 'base', ")
    assert float(entry.reason.split(", ")[1].removesuffix(" Hz")) == pytest.approx(
        true_hz, rel=0.01
    )


FAST_IMU = """<robot name="r"><link name="base"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<gazebo reference="base"><sensor type="imu" name="imu"><update_rate>1000</update_rate></sensor>
</gazebo></robot>"""
