"""Every option of `zensim serve` is one of `zensim up`, and reaches its server."""

import dataclasses
from typing import get_args

import pytest
import typer

from tests.zensim.api.test_local_deployment import DEFAULTS
from zensim.api.local_deployment import LaunchConfig, make_serve_arguments
from zensim.deploy.cli.up_commands import UpOptions, make_config
from zensim.proto.settings.server_settings import ServerSettings
from zensim.proto.settings.setting import SettingField, list_settings, make_settings
from zensim.sim_server.cli import ServeOptions

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
    "server": make_settings(ServerSettings, {"step_hz": 100.0}),
    "ros_domain": "5",
    "ros_distro": "humble",
    "ros_bridge": True,
    "ros_topics": "odom,tf",
}
CHANGED_SETTINGS: dict[str, object] = {
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
NEEDED: dict[str, dict[str, object]] = {"metrics_insecure": {"metrics": "0.0.0.0:9464"}}
"""Options without which another one changes nothing."""
PRINTED_ONLY = {"as_json", "announce"}


@pytest.mark.parametrize("field", dataclasses.fields(ServeOptions), ids=lambda field: field.name)
def test_option_of_serve_reaches_the_server_of_up(field: "dataclasses.Field[object]") -> None:
    if field.name in PRINTED_ONLY:
        return
    usual = make_serve_arguments(make_config(UpOptions(robots=0)))

    changed = {**NEEDED.get(field.name, {}), field.name: CHANGED[field.name]}
    given = UpOptions(robots=0, **changed)  # type: ignore[arg-type]

    assert make_serve_arguments(make_config(given)) != usual
    if field.name != "server":
        assert isinstance(get_args(field.type)[1], typer.models.OptionInfo)


@pytest.mark.parametrize("field", list_settings(ServerSettings), ids=lambda field: field.name)
def test_setting_reaches_the_server_of_up(field: SettingField) -> None:
    changed = make_settings(ServerSettings, {field.name: CHANGED_SETTINGS[field.name]})

    words = make_serve_arguments(make_config(UpOptions(robots=0, server=changed)))

    assert field.flag in words


def test_defaults_of_the_server_are_left_out() -> None:
    assert isinstance(DEFAULTS, LaunchConfig)
    words = make_serve_arguments(DEFAULTS)

    assert [word for word in words if word.startswith("--")] == [
        *("--listen", "--world-name", "--announce", "--world", "--ros-domain"),
    ]
