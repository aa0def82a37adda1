"""`zensim list`, `inspect` and `delete` against a real server."""

import json
import signal

import pytest

from tests.deploy.cli.commands import NOWHERE, assert_failed, run, run_at
from tests.integration.processes import Server, eventually, running, serving
from zensim.deploy.cli.entity_commands import app
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.entity_messages import Category, EntityCategory, EntityInfo


def test_list_prints_a_row_per_entity(two: Server) -> None:
    done = run_at(two, app, "list")

    head, first, second = done.out.splitlines()
    assert done.status == ExitCode.OK
    numbers = ["x", "[m]", "y", "[m]", "z", "[m]", "yaw", "[rad]"]
    assert head.split() == ["name", "namespace", "agent", *numbers, "status"]
    assert first.split()[:5] == ["r1", "r1", "-", "1.000", "0.000"]
    assert first.split()[6:] == ["0.500"]
    assert second.split()[:5] == ["r2", "team/r2", "-", "0.000", "-3.000"]


def test_list_prints_json(two: Server) -> None:
    first, second = run_at(two, app, "list", "--json").json()

    assert (first["name"], first["namespace"], first["agent"]) == ("r1", "r1", "")
    assert (first["x"], first["yaw"]) == pytest.approx((1.0, 0.5))
    assert second["y"] == pytest.approx(-3.0)


def test_inspect_names_similar_entities(two: Server) -> None:
    done = run_at(two, app, "inspect", "r3")

    assert_failed(done, ExitCode.NOT_FOUND, "zensim inspect: ", "'r3'", "r1", "r2")


def test_list_is_empty_without_entities(server: Server) -> None:
    assert run_at(server, app, "list", "--json").json() == []


@pytest.mark.parametrize(
    ("options", "found"),
    [
        (("--filter", "2$"), ["r2"]),
        (("--category", "human"), ["r1"]),
        (("--category", "human", "--category", "robot"), ["r1", "r2"]),
        (("--tag", "b"), ["r1"]),
        (("--tag", "a", "--filter", "2$"), []),
    ],
)
def test_list_applies_all_filters(two: Server, options: tuple[str, ...], found: list[str]) -> None:
    info = EntityInfo(EntityCategory(Category.HUMAN), tags=("a", "b"))
    two.client.set_entity_info("r1", info)

    rows = run_at(two, app, "list", "--json", *options).json()

    assert [row["name"] for row in rows] == found


def test_list_does_not_wrap_long_names(two: Server) -> None:
    name = "n" * 60
    two.zensim("spawn", "box_bot", "--name", name)

    assert f"{name}  {name}  -" in two.zensim("list", "--filter", "nnn").stdout


@pytest.mark.parametrize(
    ("options", "status", "line"),
    [
        (("--category", "rbot"), ExitCode.USAGE, "zensim list: "),
        (("--filter", "("), ExitCode.FAILED, "zensim list: "),
        (("--world-name", "mars"), ExitCode.UNREACHABLE, "zensim list: "),
        (("-w", "--world-name", "mars"), ExitCode.UNREACHABLE, "zensim list: "),
    ],
)
def test_list_fails_with_one_line(
    server: Server, options: tuple[str, ...], status: ExitCode, line: str
) -> None:
    assert_failed(run_at(server, app, "list", *options), status, line)


def test_list_fails_when_nothing_listens() -> None:
    done = run(app, "list", "--connect", NOWHERE)

    assert_failed(done, ExitCode.UNREACHABLE, "zensim list: ")


def test_watch_continues_after_a_restart_of_the_server() -> None:
    with serving("--paused") as first:
        first.zensim("spawn", "box_bot", "--name", "r1")
        arguments = ("list", "-w", "--json", "--every", "0.05", "--connect", first.endpoint)
        with running(*arguments) as watch:
            assert watch.stdout is not None
            assert watch.stderr is not None
            assert [row["name"] for row in json.loads(watch.stdout.readline())] == ["r1"]
            first.process.kill()
            first.process.wait()
            assert watch.stderr.readline().startswith("zensim list: note: ")
            with serving("--paused", endpoint=first.endpoint):
                lines = iter(watch.stdout.readline, "")
                eventually(lambda: json.loads(next(lines)) == [], 20.0, "the new server's list")
                watch.send_signal(signal.SIGINT)
                _, notes = watch.communicate(timeout=120.0)

    assert watch.returncode == ExitCode.INTERRUPTED
    assert notes == ""


def test_delete_removes_entities(two: Server) -> None:
    done = run_at(two, app, "delete", "r1", "r2")

    assert (done.status, done.out) == (ExitCode.OK, "deleted r1\ndeleted r2\n")
    assert two.client.entities() == ()


def test_delete_fails_for_an_unknown_entity(two: Server) -> None:
    done = run_at(two, app, "delete", "r9")

    assert_failed(done, ExitCode.NOT_FOUND, "zensim delete: ", "r9")
    assert two.client.entities() == ("r1", "r2")


@pytest.mark.parametrize(
    ("names", "status", "failures"),
    [(("r1", "r9"), ExitCode.PARTIAL, 1), (("r8", "r9"), ExitCode.NOT_FOUND, 2)],
)
def test_delete_continues_after_a_failure(
    two: Server, names: tuple[str, ...], status: ExitCode, failures: int
) -> None:
    done = run_at(two, app, "delete", *names)

    assert done.status == status
    assert done.err.count("zensim delete: ") == done.err.count("\n") == failures
    assert ("r1" in two.client.entities()) == ("r1" not in names)


def test_delete_removes_entities_that_match_a_pattern(two: Server) -> None:
    done = run_at(two, app, "delete", "--filter", "^r[13]$", "--json")

    assert done.json() == [{"name": "r1", "code": 1, "message": ""}]
    assert two.client.entities() == ("r2",)


def test_delete_fails_when_nothing_matches(two: Server) -> None:
    done = run_at(two, app, "delete", "--filter", "x")

    assert_failed(done, ExitCode.NOT_FOUND, "zensim delete: ")
    assert two.client.entities() == ("r1", "r2")


def test_delete_all_succeeds_without_entities(two: Server) -> None:
    first, second = (run_at(two, app, "delete", "--all") for _ in range(2))

    assert (first.status, first.out) == (ExitCode.OK, "deleted r1\ndeleted r2\n")
    assert (second.status, second.out) == (ExitCode.OK, "")


@pytest.mark.parametrize(
    "arguments", [(), ("r1", "--all"), ("r1", "--filter", "r"), ("--all", "--filter", "r")]
)
def test_delete_is_refused_without_exactly_one_selection(
    two: Server, arguments: tuple[str, ...]
) -> None:
    done = run_at(two, app, "delete", *arguments)

    assert_failed(done, ExitCode.USAGE, "zensim delete: ")
    assert two.client.entities() == ("r1", "r2")


def test_inspect_prints_the_model_as_json(two: Server) -> None:
    facts = run_at(two, app, "inspect", "r2", "--json").json()

    assert (facts["name"], facts["namespace"], facts["model"]) == ("r2", "team/r2", "box_bot")
    assert facts["mass_kg"] == pytest.approx(1.4)
    assert facts["joints"] == ["left_wheel_joint", "right_wheel_joint"]
    assert facts["drive"]["pairs"][0]["separation_m"] == 0.11


def test_inspect_prints_a_line_per_fact(two: Server) -> None:
    lines = run_at(two, app, "inspect", "r1").out.splitlines()

    assert "name: r1" in lines
    assert "model: box_bot" in lines
    assert "category: robot" in lines
    assert "drive: diff_drive" in lines
    assert any("applied" in line for line in lines)


def test_inspect_prints_info_and_bounds_as_json(two: Server) -> None:
    facts = run_at(two, app, "inspect", "r1", "--json").json()

    assert (facts["category"], facts["tags"], facts["description"]) == ("robot", [], "box_bot")
    assert facts["bounds"]["lower"][0] < 0.0 < facts["bounds"]["upper"][0]
    assert facts["twist"]["linear"] == {"x": 0.0, "y": 0.0, "z": 0.0}


def test_inspect_fails_for_an_unknown_entity(two: Server) -> None:
    done = run_at(two, app, "inspect", "r9")

    assert_failed(done, ExitCode.NOT_FOUND, "zensim inspect: ")


@pytest.mark.parametrize("arguments", [("delete", "r1"), ("inspect", "r1")], ids=str)
def test_command_fails_when_no_server_has_the_world(
    server: Server, arguments: tuple[str, ...]
) -> None:
    done = run_at(server, app, *arguments, "--world-name", "mars")

    assert_failed(done, ExitCode.UNREACHABLE, f"zensim {arguments[0]}: ")
