"""Report entries on sensors that depend on the world and on the hosts of sensor processes."""

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from zensim.proto.messages.model_messages import Model, Origin, ReportEntry, Sensor
from zensim.proto.messages.sensing_messages import Environment
from zensim.proto.messages.sensor_messages import CameraSensor, NavsatSensor, RaySensor
from zensim.proto.rigid_transforms import compose
from zensim.proto.se3 import FloatArray, from_origin
from zensim.proto.sensor_libraries import Library, find_missing_libraries
from zensim.proto.sensor_schedule import find_true_rate_hz
from zensim.sim_server.description.model_geometry import find_link_poses
from zensim.sim_server.description.plugins.sensor_reader import make_sensor_entry
from zensim.sim_server.scene.fleet_casting import are_level
from zensim.sim_server.scene.sensor_faults import SensorFault, find_sensor_fault
from zensim.sim_server.service_parts import Spawning, make_environment

RATE_TOLERANCE = 1e-3
"""Share by which a rate may be above the control rate without a note."""
MAX_NAMED = 3


def make_sensor_notes(spawning: Spawning, model: Model, pose: FloatArray) -> list[ReportEntry]:
    """Report what sensors will not do as their description says.

    Args:
        spawning: Has the world and the sensor processes.
        model: Of the robot.
        pose: (7,) of its root link in the world.
    """
    # Most robots have no sensors, and a spawn takes less than a millisecond.
    if not any(sensor.settings is not None for sensor in model.sensors):
        return []
    environment = make_environment(spawning.world, spawning.current)
    origins = _find_origins(model, pose)
    missing = spawning.sensors.missing
    return [
        *make_world_notes(model, environment),
        *_make_height_notes(spawning, model, origins),
        *make_library_notes(model, origins, environment, missing),
    ]


def complete_report(
    model: Model, namespace: str, environment: Environment
) -> tuple[ReportEntry, ...]:
    """Write topics and rates of the sensors in the report of a model as they are in this world."""
    simulated = [sensor for sensor in model.sensors if sensor.settings is not None]
    completed = {
        make_sensor_entry(one): make_sensor_entry(
            one, namespace, find_true_rate_hz(one.update_rate_hz, environment)
        )
        for one in simulated
    }
    return (
        tuple(completed.get(entry, entry) for entry in model.report) if completed else model.report
    )


def make_world_notes(model: Model, environment: Environment) -> Iterator[ReportEntry]:
    """Report rates above the control rate, and receivers in a world without a place on Earth."""
    for sensor in model.sensors:
        true_hz = find_true_rate_hz(sensor.update_rate_hz, environment)
        if sensor.settings is not None and sensor.update_rate_hz > true_hz * (1.0 + RATE_TOLERANCE):
            yield _suspect(
                sensor,
                f"asks for {sensor.update_rate_hz:g} Hz, but the server reports {true_hz:g} "
                f"control steps a second: {true_hz:g} Hz; zensim serve --control-hz sets more",
            )
        if isinstance(sensor.settings, NavsatSensor) and not environment.spherical_coordinates:
            yield _suspect(
                sensor, "the world has no <spherical_coordinates>: its origin is at 0 N 0 E"
            )


def make_library_notes(
    model: Model,
    origins: Mapping[str, Origin],
    environment: Environment,
    missing: Mapping[str, frozenset[Library]],
) -> Iterator[ReportEntry]:
    """Report sensors that no host measures as it should for want of a library.

    Args:
        model: Of the robot.
        origins: Poses of its links in the world.
        environment: Of the world.
        missing: What the hosts of sensor processes lack, by process; this host is judged if there
            is none.
    """
    seeing = [one for one in model.sensors if isinstance(one.settings, RaySensor | CameraSensor)]
    hosts = list(missing.values()) if missing else []
    if seeing and not hosts:
        hosts = [frozenset(find_missing_libraries())]
    for sensor in seeing:
        faults = [_find_fault(sensor, origins, environment, host) for host in set(hosts)]
        if None not in faults:
            least = min(filter(None, faults), key=lambda fault: fault.is_refused)
            yield _suspect(sensor, f"{least}; {_describe_hosts(list(missing))}")


def _find_fault(
    sensor: Sensor,
    origins: Mapping[str, Origin],
    environment: Environment,
    missing: Collection[Library],
) -> SensorFault | None:
    is_level = False
    if isinstance(sensor.settings, RaySensor):
        pose = from_origin(compose(origins[sensor.link], sensor.origin))
        is_level = bool(are_level(sensor.settings, pose[None])[0])
    rate_hz = find_true_rate_hz(sensor.update_rate_hz, environment)
    return find_sensor_fault(sensor, rate_hz, missing, is_level=is_level)


def _describe_hosts(processes: list[str]) -> str:
    if not processes:
        return (
            "so it is on the server's host; no sensor process runs, and one on another host may "
            "have it"
        )
    named = ", ".join(sorted(processes)[:MAX_NAMED])
    more = f" and {len(processes) - MAX_NAMED} more" if len(processes) > MAX_NAMED else ""
    return f"so it is on the hosts of all sensor processes ({named}{more})"


def _find_origins(model: Model, pose: FloatArray) -> dict[str, Origin]:
    """Find the poses of all links in the world, with all joints at 0."""
    x, y, z, *turn = np.asarray(pose[:7]).tolist()
    base = Origin((x, y, z), (turn[0], turn[1], turn[2], turn[3]))
    links = find_link_poses(model.links[0].name, model.joints)
    return {name: compose(base, origin) for name, origin in links.items()}


def _make_height_notes(
    spawning: Spawning, model: Model, origins: Mapping[str, Origin]
) -> Iterator[ReportEntry]:
    """Report level lidars above everything that the world's file has."""
    lidars = [
        sensor
        for sensor in model.sensors
        if isinstance(sensor.settings, RaySensor) and sensor.settings.vertical.count == 1
    ]
    top_m = spawning.current.find_top(spawning.descriptions.store.vertices) if lidars else None
    if top_m is None:
        return
    for sensor in lidars:
        height_m = compose(origins[sensor.link], sensor.origin).position[2]
        if height_m > top_m:
            yield _suspect(
                sensor,
                f"is {height_m:.2f} m high, above all of the world's file ({top_m:.2f} m): its "
                "level rays meet other entities only",
            )


def _suspect(sensor: Sensor, reason: str) -> ReportEntry:
    return ReportEntry("suspicious", f"sensor '{sensor.name}'", reason)
