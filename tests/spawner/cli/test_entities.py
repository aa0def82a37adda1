"""`zensim list`, `inspect` and `delete` against a real server."""

import pytest

from proto.exits import Exit
from spawner.cli.entities import app
from spawner.cli.spawn import app as spawn_app
from tests.integration.processes import Server
from tests.spawner.cli.commands import NOWHERE, assert_failed, run, run_at


@pytest.fixture
def two(server: Server) -> Server:
    """A server with two robots."""
    run_at(server, spawn_app, "spawn", "box_bot", "-n", "r1", "-x", "1", "-Y", "0.5")
    run_at(server, spawn_app, "spawn", "box_bot", "-n", "r2", "-ns", "team/r2", "-y", "-3")
    return server


def test_list_shows_a_line_for_each_entity(two: Server) -> None:
    done = run_at(two, app, "list")

    head, first, second = done.out.splitlines()
    assert done.status == Exit.OK
    assert head.split() == ["name", "namespace", "agent", "x", "[m]", "y", "[m]", "yaw", "[rad]"]
    assert first.split() == ["r1", "r1", "-", "1.000", "0.000", "0.500"]
    assert second.split() == ["r2", "team/r2", "-", "0.000", "-3.000", "0.000"]


def test_list_prints_json(two: Server) -> None:
    first, second = run_at(two, app, "list", "--json").json()

    assert (first["name"], first["namespace"], first["agent"]) == ("r1", "r1", "")
    assert (first["x"], first["yaw"]) == pytest.approx((1.0, 0.5))
    assert second["y"] == pytest.approx(-3.0)


def test_list_is_empty_when_nobody_is_there(server: Server) -> None:
    assert run_at(server, app, "list", "--json").json() == []


def test_delete_takes_entities_out(two: Server) -> None:
    done = run_at(two, app, "delete", "r1", "r2")

    assert (done.status, done.out) == (Exit.OK, "deleted r1\ndeleted r2\n")
    assert two.client.entities() == ()


def test_delete_says_who_does_not_exist(two: Server) -> None:
    done = run_at(two, app, "delete", "r9")

    assert_failed(done, Exit.NOT_FOUND, "zensim delete: NOT_FOUND (2): ")
    assert "'r9' does not exist" in done.err
    assert two.client.entities() == ("r1", "r2")


def test_inspect_shows_what_an_entity_is_made_of(two: Server) -> None:
    facts = run_at(two, app, "inspect", "r2", "--json").json()

    assert (facts["name"], facts["namespace"], facts["model"]) == ("r2", "team/r2", "box_bot")
    assert facts["mass_kg"] == pytest.approx(1.4)
    assert facts["joints"] == ["left_wheel_joint", "right_wheel_joint"]
    assert facts["drive"]["pairs"][0]["separation_m"] == 0.11


def test_inspect_is_read_by_people_too(two: Server) -> None:
    lines = run_at(two, app, "inspect", "r1").out.splitlines()

    assert "name: r1" in lines
    assert "model: box_bot" in lines


def test_inspect_says_who_does_not_exist(two: Server) -> None:
    done = run_at(two, app, "inspect", "r9")

    assert_failed(done, Exit.NOT_FOUND, "zensim inspect: NOT_FOUND (2): ")


def test_command_says_so_when_nobody_listens() -> None:
    done = run(app, "list", "--connect", NOWHERE)

    assert_failed(done, Exit.UNREACHABLE, "zensim list: UNREACHABLE (4): nobody listens at")


@pytest.mark.parametrize("arguments", [("list",), ("delete", "r1"), ("inspect", "r1")], ids=str)
def test_command_says_so_when_nobody_serves_that_world(
    server: Server, arguments: tuple[str, ...]
) -> None:
    done = run_at(server, app, *arguments, "--world-name", "mars")

    assert_failed(
        done, Exit.UNREACHABLE, f"zensim {arguments[0]}: UNREACHABLE (4): nothing answers"
    )
