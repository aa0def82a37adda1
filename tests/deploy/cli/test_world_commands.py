"""`zensim world load`, `list`, `current`, `poses` and `unload` against a real server."""

from pathlib import Path

import pytest

from tests.deploy.cli.commands import assert_failed, run_at
from tests.integration.processes import Server
from zensim.deploy.cli.doctor_commands import app as doctor_app
from zensim.deploy.cli.simulation_commands import app as simulation_app
from zensim.deploy.cli.world_commands import app
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.simulation_messages import State

SDF = """<sdf version="1.7"><world name="mine"><model name="block"><static>true</static>
<link name="l"><collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision>
</link></model></world></sdf>"""


def test_list_prints_names_that_load_accepts(server: Server) -> None:
    head, *lines = run_at(server, app, "list").out.splitlines()
    names = [
        world["world_resource"]["uri"] for world in run_at(server, app, "list", "--json").json()
    ]

    assert head.split()[:2] == ["name", "tags"]
    assert [line.split()[0] for line in lines] == names
    assert {"empty", "maze", "office", "walls", "warehouse"} <= set(names)


def test_load_accepts_a_name(server: Server) -> None:
    done = run_at(server, app, "load", "walls")

    assert done.status == ExitCode.OK
    assert done.out.startswith("loaded walls")
    assert run_at(server, app, "current").out == "walls\n"
    assert server.client.simulation_state() == State.STOPPED


def test_load_accepts_a_file(server: Server, tmp_path: Path) -> None:
    file = tmp_path / "mine.sdf"
    file.write_text(SDF)

    loaded = run_at(server, app, "load", str(file), "--json").json()

    assert loaded["world"]["name"] == "mine"
    assert server.client.entities() == ("block",)
    assert run_at(server, app, "current", "--json").json()["name"] == "mine"


def test_poses_lists_named_poses(server: Server) -> None:
    run_at(server, app, "load", "walls")

    head, *lines = run_at(server, app, "poses").out.splitlines()
    found = run_at(server, app, "poses", "--json").json()

    assert head.split()[:2] == ["name", "tags"]
    assert [line.split()[0] for line in lines] == [one["name"] for one in found]
    assert {"centre", "corner"} <= {one["name"] for one in found}
    assert run_at(server, app, "poses", "--tag", "nowhere", "--json").json() == []


def test_unload_fails_without_a_world(server: Server) -> None:
    first, second = (run_at(server, app, "unload") for _ in range(2))

    assert (first.status, first.out) == (ExitCode.OK, "unloaded\n")
    assert_failed(second, ExitCode.FAILED, "zensim world unload: ")
    none = run_at(server, app, "current")
    assert_failed(none, ExitCode.FAILED, "zensim world current: ")


def test_doctor_and_play_say_how_to_load_a_world_where_there_is_none(server: Server) -> None:
    run_at(server, app, "unload")

    played = run_at(server, simulation_app, "play")
    found = run_at(server, doctor_app, "--json").json()

    assert_failed(played, ExitCode.FAILED, "zensim play: ", "'zensim world load")
    (advice,) = [one["advice"] for one in found if one["what"] == "time"]
    assert "'zensim world load" in advice
    assert "play" not in advice


@pytest.mark.parametrize(
    ("word", "status", "line"),
    [
        ("nowhere", ExitCode.NOT_FOUND, "zensim world load: "),
        ("./nowhere.sdf", ExitCode.NOT_FOUND, "zensim world load: "),
    ],
)
def test_load_of_an_unknown_world_changes_nothing(
    server: Server, word: str, status: ExitCode, line: str
) -> None:
    done = run_at(server, app, "load", word)

    assert_failed(done, status, line)
    assert server.client.simulation_state() == State.PAUSED


def test_load_refuses_a_binary_file(server: Server, tmp_path: Path) -> None:
    file = tmp_path / "mine.sdf"
    file.write_bytes(b"\xff\xfe\x00")

    done = run_at(server, app, "load", str(file))

    assert_failed(done, ExitCode.USAGE, "zensim world load: ")


def test_strict_load_refuses_unsupported_elements(server: Server, tmp_path: Path) -> None:
    file = tmp_path / "mine.sdf"
    file.write_text(
        SDF.replace("<model", "<wind><linear_velocity>1 0 0</linear_velocity></wind><model", 1)
    )

    done = run_at(server, app, "load", str(file), "--strict")

    assert_failed(done, ExitCode.FAILED, "zensim world load: ")
