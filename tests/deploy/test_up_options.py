"""Every option of `zensim serve` is one of `zensim up`, and reaches its server."""

import dataclasses
from typing import Any

import msgspec
import pytest

from tests.zensim.api.test_local_deployment import DEFAULTS
from zensim.api.local_deployment import LaunchConfig, make_serve_arguments
from zensim.deploy.cli.serve_commands import ServeOptions
from zensim.deploy.cli.up_commands import UpOptions, make_config
from zensim.proto.settings.deployment_settings import ServeSettings
from zensim.proto.settings.setting import SettingField, change_settings, is_settings, list_settings

CHANGED: dict[str, object] = {
    "journal": "journal",
    "input_log": True,
    "listen": "tcp/127.0.0.1:5",
    "connect": "tcp/127.0.0.1:6",
    "secure": True,
    "client_certificates": True,
    "insecure": True,
    "mesh_http": "127.0.0.1:0",
    "metrics": "9464",
    "metrics_insecure": True,
    "wait": 3.0,
    "world_name": "other",
    "ros_domain": "5",
    "ros_distro": "humble",
    "ros_bridge": True,
    "ros_topics": "odom,tf",
    "world": "walls",
    "model_paths": ["models"],
    "strict": True,
    "allow_missing": True,
    "paused": True,
    "seed": 3,
    "engine": "mujoco",
    "allow_failed_engine": True,
    "rtf": 2.0,
    "step_hz": 100.0,
    "control_hz": 50.0,
    "dynamics": "kinematic",
    "clusters": "off",
    "engine_workers": 1,
    "lockstep": True,
    "lockstep_timeout": 2.0,
    "on_miss": "wait",
}


def change(name: str) -> UpOptions:
    """Change a setting of `zensim up`."""
    usual = UpOptions(robots=0)
    groups: dict[str, Any] = {
        one: value for one, value in vars(usual).items() if isinstance(value, msgspec.Struct)
    }
    changed = {one: change_settings(value, {name: CHANGED[name]}) for one, value in groups.items()}
    return dataclasses.replace(usual, **changed)


def test_every_option_of_serve_is_one_of_up() -> None:
    fields = {one.name: one.type for one in dataclasses.fields(ServeOptions)}

    assert fields.items() <= {one.name: one.type for one in dataclasses.fields(UpOptions)}.items()
    plain = {name for name, kind in fields.items() if not is_settings(kind)}
    assert plain == {"as_json", "announce"}, "these only print; all others are settings"


@pytest.mark.parametrize("field", list_settings(ServeSettings), ids=lambda field: field.name)
def test_setting_reaches_the_server_of_up(field: SettingField) -> None:
    words = make_serve_arguments(make_config(change(field.name)))

    assert field.flag in words
    assert words != make_serve_arguments(make_config(UpOptions(robots=0)))


def test_defaults_of_the_server_are_left_out() -> None:
    assert isinstance(DEFAULTS, LaunchConfig)
    words = make_serve_arguments(DEFAULTS)

    assert [word for word in words if word.startswith("--")] == [
        *("--announce", "--listen", "--world-name", "--world", "--ros-domain")
    ]


@pytest.mark.parametrize(
    ("robots", "layout", "width_m"), [(20, "", 0), (21, "", 4), (21, "row", 0)]
)
def test_robots_stand_in_a_row_unless_they_are_many(robots: int, layout: str, width_m: int) -> None:
    places = make_config(UpOptions(robots=robots, layout=layout)).placements

    assert len(places) == robots
    assert max(place.y for place in places) - min(place.y for place in places) == width_m
