"""Worlds and states over the network: load, unload, stop and quit with running robots."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.processes import END_S, Server, agent_of, eventually, running_agents, serving
from tests.integration.robots import robot
from zensim.proto.messages.entity_messages import TagsFilter
from zensim.proto.messages.result_messages import (
    GetCurrentWorldCode,
    LoadWorldCode,
    ResultCode,
    ServiceError,
    SetSimulationStateCode,
)
from zensim.proto.messages.simulation_messages import State

GROUND = "<include><uri>model://ground_plane</uri></include>"
CRATE = (
    "<sdf version='1.6'><model name='crate'><link name='box'><inertial><mass>1</mass><inertia>"
    "<ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial><collision name='c'>"
    "<geometry><box><size>1 1 1</size></box></geometry></collision></link></model></sdf>"
)
MOVING_M_S = 0.05


def sdf(inside: str = "", name: str = "yard") -> str:
    return f"<sdf version='1.6'><world name='{name}'>{GROUND}{inside}</world></sdf>"


def code_of(refused: "pytest.ExceptionInfo[ServiceError]") -> int:
    return refused.value.code


def drives(server: Server, name: str) -> None:
    driver = robot(server.bus, name)

    def is_moving() -> bool:
        driver.command(0.3)
        return abs(server.client.entity_state(name).twist.linear.x) > MOVING_M_S

    eventually(is_moving, 10.0, "moving")


@pytest.fixture(scope="module")
def shared() -> Iterator[Server]:
    with serving() as found:
        yield found


@pytest.fixture
def server(shared: Server) -> Server:
    """The server of all tests that leave it running, with a new empty world that plays."""
    shared.client.load_world("empty")
    shared.client.set_simulation_state(State.PLAYING)
    return shared


def test_agent_waits_and_claims_again_when_its_world_is_replaced(server: Server) -> None:
    server.zensim("spawn", "box_bot", "--name", "r1")
    with running_agents(server, "r1"):
        drives(server, "r1")
        before = server.client.info()

        report = server.client.load_world("walls")

        after = server.client.info()
        assert (report.world.name, after.world_model, after.state) == (
            *("walls", "walls"),
            "stopped",
        )
        assert (after.epoch, after.steps) == (before.epoch + 1, 0)
        assert server.client.entities() == ("outer_walls", "inner_walls")
        assert server.client.current_world().world_resource.uri == "walls"
        server.client.set_simulation_state(State.PLAYING)
        server.zensim("spawn", "box_bot", "--name", "r1")
        eventually(lambda: agent_of(server, "r1"), 10.0, "claiming again")
        drives(server, "r1")


def test_world_keeps_running_when_another_cannot_be_loaded(server: Server) -> None:
    server.zensim("spawn", "box_bot", "--name", "r1")
    hostile = "<!DOCTYPE a [<!ENTITY b 'c'>]><sdf/>"
    for text, code in (
        (hostile, LoadWorldCode.RESOURCE_PARSE_ERROR),
        (sdf("<include><uri>file:///etc/passwd</uri></include>"), LoadWorldCode.MISSING_ASSETS),
    ):
        with pytest.raises(ServiceError) as refused:
            server.client.load_world(text=text)
        assert code_of(refused) == code

    assert server.client.entities() == ("r1",)
    assert server.client.simulation_state() == State.PLAYING
    steps = server.steps()
    eventually(lambda: server.steps() > steps, 5.0, "stepping on")


def test_worlds_of_the_operator_are_listed_and_loaded_and_no_other_file(tmp_path: Path) -> None:
    given, secret = tmp_path / "given", tmp_path / "secret.world"
    (given / "crate").mkdir(parents=True)
    (given / "crate" / "model.sdf").write_text(CRATE)
    included = "<include><uri>model://crate</uri><pose>0 0 0.5 0 0 0</pose></include>"
    tags = "<zensim:tags>fenced</zensim:tags>"
    (given / "yard.world").write_text(sdf(tags + included))
    secret.write_text(sdf(name="secret"))

    with serving("--model-path", str(given)) as server:
        worlds = [world.name for world in server.client.available_worlds()]
        assert worlds == ["default", "maze", "office", "walls", "warehouse", "yard"]
        (yard,) = server.client.available_worlds(TagsFilter(("fenced",)))
        server.client.load_world(yard.world_resource.uri)
        assert server.client.entities() == ("crate",)
        server.client.load_world(text=sdf(included, "mine"))
        assert server.client.current_world().name == "mine"
        for uri in (str(secret), "../secret.world", f"file://{secret}"):
            with pytest.raises(ServiceError) as refused:
                server.client.load_world(uri)
            assert code_of(refused) == ResultCode.NOT_FOUND


def test_server_without_a_world_refuses_what_needs_one(server: Server) -> None:
    server.client.unload_world()

    assert server.client.simulation_state() == State.NO_WORLD
    assert server.zensim("spawn", "box_bot", "--name", "r1").returncode != 0
    with pytest.raises(ServiceError) as refused:
        server.client.step(1)
    assert code_of(refused) == ResultCode.INCORRECT_STATE
    with pytest.raises(ServiceError) as refused:
        server.client.current_world()
    assert code_of(refused) == GetCurrentWorldCode.NO_WORLD_LOADED
    assert server.steps() == 0
    server.client.load_world("empty")
    assert server.zensim("spawn", "box_bot", "--name", "r1").returncode == 0


def test_stopped_world_is_reset_and_plays_again(server: Server) -> None:
    server.zensim("spawn", "box_bot", "--name", "r1")
    server.client.set_simulation_state(State.STOPPED)

    assert (server.steps(), server.client.entities()) == (0, ())
    with pytest.raises(ServiceError) as refused:
        server.client.set_simulation_state(State.NO_WORLD)
    assert code_of(refused) == SetSimulationStateCode.INCORRECT_TRANSITION

    server.client.set_simulation_state(State.PLAYING)
    eventually(lambda: server.steps() > 0, 5.0, "playing")


def test_server_quits_after_its_reply() -> None:
    with serving() as server:
        server.zensim("spawn", "box_bot", "--name", "r1")

        server.client.set_simulation_state(State.QUITTING)

        assert server.process.wait(END_S) == 0


def test_loaded_and_unloaded_worlds_are_restored_from_the_journal(tmp_path: Path) -> None:
    saved = ("--journal", str(tmp_path / "journal"))
    with serving(*saved) as server:
        server.client.load_world("walls")
        server.zensim("spawn", "box_bot", "--name", "r1")
        server.process.kill()
        server.process.wait()

    with serving(*saved) as server:
        assert server.client.current_world().world_resource.uri == "walls"
        assert server.client.entities() == ("outer_walls", "inner_walls", "r1")
        assert server.client.simulation_state() == State.STOPPED
        server.client.unload_world()
        server.client.set_simulation_state(State.QUITTING)
        assert server.process.wait(END_S) == 0

    with serving(*saved) as server:
        assert server.client.simulation_state() == State.NO_WORLD
        assert server.client.entities() == ()
