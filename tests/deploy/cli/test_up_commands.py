"""What `zensim up` says while its world runs."""

from types import SimpleNamespace
from typing import cast

import pytest

from zensim.api.local_deployment import LocalDeployment
from zensim.deploy.cli import up_commands
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.messages.telemetry_messages import Info


@pytest.mark.parametrize(
    ("info", "is_slow"),
    [
        (Info(real_time_factor=0.3, target_real_time_factor=1.0), True),
        (Info(real_time_factor=1.7, target_real_time_factor=4.0), True),
        (Info(real_time_factor=0.95, target_real_time_factor=1.0), False),
        (Info(real_time_factor=3.0, target_real_time_factor=0.0), False),
        (Info(real_time_factor=0.0, target_real_time_factor=1.0), False),
        (None, False),
    ],
    ids=["slow", "slower than asked", "in time", "unlimited", "paused", "no server"],
)
def test_slow_world_is_told_once_what_makes_it_faster(
    info: Info | None,
    is_slow: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def ask() -> Info:
        if info is None:
            raise NoServer("gone")
        return info

    monkeypatch.setattr(up_commands, "SLOW_AFTER_S", -1.0)
    deployment = SimpleNamespace(client=SimpleNamespace(info=ask))
    check = up_commands.say_once_if_slow(cast("LocalDeployment", deployment), lambda: False)

    assert [check() for _ in range(3)] == [False] * 3
    assert capsys.readouterr().err.count("--dynamics") == is_slow
