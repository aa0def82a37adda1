"""Spawns whose client has given up: the same request again is their retry."""

import signal
from pathlib import Path

import pytest

import zensim
from tests.integration.processes import START_S, eventually, running, serving
from zensim.deploy.cli import spawn_commands
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.service_catalog import SPAWN_ENTITY
from zensim.spawner.client import service_client

GIVES_UP_S = 0.3


@pytest.mark.parametrize("name", ["r1", ""], ids=["named", "without a name"])
def test_spawn_that_got_no_reply_in_time_succeeds_when_it_is_repeated(name: str) -> None:
    with serving() as server:
        order = SpawnEntityOrder(
            name=name, allow_renaming=not name, entity_resource=Resource("box_bot")
        )
        server.process.send_signal(signal.SIGSTOP)
        try:
            with pytest.raises(TimeoutError):
                server.bus.call(SPAWN_ENTITY, order, world="default", timeout_s=GIVES_UP_S)
        finally:
            server.process.send_signal(signal.SIGCONT)

        report = server.bus.call(SPAWN_ENTITY, order, world="default", timeout_s=START_S)

        assert server.client.entities() == (report.entity_name,)
        if name:
            with pytest.raises(ServiceError) as refused:
                server.bus.call(SPAWN_ENTITY, order, world="default", timeout_s=START_S)
            assert refused.value.code_name == "NAME_NOT_UNIQUE"


@pytest.mark.parametrize(
    ("function", "words"),
    [
        ("spawn_bonded", ("spawn", "box_bot", "-n", "r1")),
        ("spawn_many", ("fleet", "box_bot", "--robots", "1")),
    ],
)
def test_command_that_gave_up_succeeds_when_it_is_run_again_and_not_a_third_time(
    function: str, words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with serving() as server:
        with monkeypatch.context() as patch:
            spawns = getattr(spawn_commands, function)

            def stop_and_spawn(*given: object, **options: object) -> object:
                server.process.send_signal(signal.SIGSTOP)
                return spawns(*given, **options)

            patch.setattr(spawn_commands, function, stop_and_spawn)
            patch.setattr(service_client, "SPAWN_TIMEOUT_S", GIVES_UP_S)
            given_up = server.zensim(*words, "--timeout", str(GIVES_UP_S))
        server.process.send_signal(signal.SIGCONT)
        again, third = server.zensim(*words), server.zensim(*words)

        assert len(server.client.entities()) == 1
    assert given_up.returncode == ExitCode.TIMEOUT, given_up.stderr
    assert again.returncode == ExitCode.OK, again.stderr
    assert third.returncode == ExitCode.FAILED


def test_robot_that_no_agent_drove_in_time_is_returned_by_the_same_call_again() -> None:
    with serving() as server, zensim.connect(server.endpoint) as sim:
        for _ in range(2):
            with pytest.raises(zensim.Timeout):
                sim.spawn("box_bot", "r1", timeout_s=GIVES_UP_S)
        with running("agent", "r1", "--connect", server.endpoint):
            robot = sim.spawn("box_bot", "r1", timeout_s=START_S)

        assert robot.name == "r1"
        with pytest.raises(zensim.SpawnRefused):
            sim.spawn("box_bot", "r1", timeout_s=START_S)
        sim.delete("r1")
        eventually(lambda: not server.client.entities(), START_S, "no robot")
