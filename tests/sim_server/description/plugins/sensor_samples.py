"""Robots with one sensor, for tests."""

from tests.sim_server.description.robots import (
    a_collision,
    a_joint,
    a_link,
    a_reference,
    a_robot,
    an_inertial,
)
from zensim.proto.messages.model_messages import Model, Sensor
from zensim.sim_server.description.pipeline import parse_description

MAST_HEIGHT_M = 0.5


def a_sensor(kind: str, inside: str = "", name: str = "s", plugin: str = "") -> str:
    return f'<sensor type="{kind}" name="{name}">{inside}{plugin}</sensor>'


def a_sensor_plugin(filename: str, inside: str = "", name: str = "driver") -> str:
    return f'<plugin name="{name}" filename="lib{filename}.so">{inside}</plugin>'


def a_robot_text(*parts: str) -> str:
    """A base with a mast, merged into it, and an optical frame at the top of the mast."""
    return a_robot(
        a_link("base", an_inertial() + a_collision()),
        a_link("mast", a_collision() + a_collision()),
        a_joint("m", ("base", "mast"), "fixed", f'<origin xyz="1 0 {MAST_HEIGHT_M}"/>'),
        a_link("optical"),
        a_joint("o", ("mast", "optical"), "fixed", '<origin rpy="-1.5707963 0 -1.5707963"/>'),
        *parts,
    )


def a_model(*parts: str, compat: str = "fixed") -> Model:
    """Parse a robot as the server does."""
    return parse_description(
        a_robot_text(*parts),
        assets={},
        allow_missing=False,
        compat="gazebo11" if compat == "gazebo11" else "fixed",
    ).model


def a_model_with(*sensors: str, compat: str = "fixed") -> Model:
    """Parse a robot with sensors on its mast."""
    return a_model(a_reference("mast", "".join(sensors)), compat=compat)


def the_sensor(*sensors: str, compat: str = "fixed") -> Sensor:
    (found,) = a_model_with(*sensors, compat=compat).sensors
    return found


def topics_of(sensor: Sensor) -> dict[str, str]:
    return {one.topic: one.name for one in sensor.topics}
