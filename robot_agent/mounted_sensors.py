"""Sensors that agents simulate: which a model has, where they are mounted, their topic keys."""

import msgspec

from zensim.proto import keys
from zensim.proto.messages.drive_messages import Compat
from zensim.proto.messages.model_messages import Model, Sensor
from zensim.proto.messages.sensor_messages import StateSensorSettings
from zensim.robot_agent.link_motion import LinkChain, find_link_chain


class MountedSensor(msgspec.Struct, frozen=True):
    """What the measurements of a sensor depend on: all but names, frames and topics."""

    settings: StateSensorSettings
    rate_hz: float
    """0 = at every control step."""
    compat: Compat
    chain: LinkChain
    """Chain from the root link to the sensor."""
    topics: tuple[str, ...]
    """Names in the topic catalog, in the order of `Sensor.topics`."""


def list_state_sensors(model: Model) -> tuple[Sensor, ...]:
    """List the sensors of a model that its agent simulates."""
    return tuple(
        sensor
        for sensor in model.sensors
        if isinstance(sensor.settings, StateSensorSettings) and sensor.topics
    )


def mount_sensors(model: Model) -> tuple[MountedSensor, ...]:
    """Find where the sensors of `list_state_sensors` are mounted."""
    return tuple(_mount_sensor(model, sensor) for sensor in list_state_sensors(model))


def _mount_sensor(model: Model, sensor: Sensor) -> MountedSensor:
    settings = sensor.settings
    if not isinstance(settings, StateSensorSettings):
        raise TypeError(f"sensor '{sensor.name}' is no sensor of a robot's own state")
    return MountedSensor(
        settings,
        sensor.update_rate_hz,
        sensor.compat,
        find_link_chain(model, sensor.link).extend(sensor.origin),
        tuple(one.topic for one in sensor.topics),
    )


def list_sensor_keys(model: Model, namespace: str) -> tuple[str, ...]:
    """List the keys of all topics of `list_state_sensors`, sensor by sensor."""
    return tuple(
        keys.robot(namespace, topic.name)
        for sensor in list_state_sensors(model)
        for topic in sensor.topics
    )
