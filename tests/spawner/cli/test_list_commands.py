"""`zensim list` against a real server."""

import json
import signal

import pytest

from tests.integration.processes import Server, eventually, running, serving
from tests.spawner.cli.commands import NOWHERE, assert_failed, run, run_at
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.entity_messages import Category, EntityCategory, EntityInfo
from zensim.spawner.cli.list_commands import app


def test_list_shows_a_line_for_each_entity(two: Server) -> None:
    done = run_at(two, app)

    head, first, second = done.out.splitlines()
    assert done.status == ExitCode.OK
    assert head.split() == ["name", "namespace", "agent", "x", "[m]", "y", "[m]", "yaw", "[rad]"]
    assert first.split() == ["r1", "r1", "-", "1.000", "0.000", "0.500"]
    assert second.split() == ["r2", "team/r2", "-", "0.000", "-3.000", "0.000"]


def test_list_prints_json(two: Server) -> None:
    first, second = run_at(two, app, "--json").json()

    assert (first["name"], first["namespace"], first["agent"]) == ("r1", "r1", "")
    assert (first["x"], first["yaw"]) == pytest.approx((1.0, 0.5))
    assert second["y"] == pytest.approx(-3.0)


def test_list_is_empty_when_nobody_is_there(server: Server) -> None:
    assert run_at(server, app, "--json").json() == []


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
def test_list_shows_those_that_pass_every_filter(
    two: Server, options: tuple[str, ...], found: list[str]
) -> None:
    info = EntityInfo(EntityCategory(Category.HUMAN), tags=("a", "b"))
    two.client.set_entity_info("r1", info)

    rows = run_at(two, app, "--json", *options).json()

    assert [row["name"] for row in rows] == found


def test_list_keeps_long_names_on_one_line(two: Server) -> None:
    name = "n" * 60
    two.zensim("spawn", "box_bot", "--name", name)

    assert f"{name}  {name}  -" in two.zensim("list", "--filter", "nnn").stdout


@pytest.mark.parametrize(
    ("options", "status", "line"),
    [
        (
            ("--category", "rbot"),
            ExitCode.USAGE,
            "zensim list: USAGE (2): category 'rbot' is unknown",
        ),
        (("--filter", "("), ExitCode.FAILED, "zensim list: OPERATION_FAILED (4): filter.pattern: "),
        (
            ("--world-name", "mars"),
            ExitCode.UNREACHABLE,
            "zensim list: UNREACHABLE (4): nothing answ",
        ),
        (
            ("-w", "--world-name", "mars"),
            ExitCode.UNREACHABLE,
            "zensim list: UNREACHABLE (4): noth",
        ),
    ],
)
def test_list_says_what_is_wrong_in_one_line(
    server: Server, options: tuple[str, ...], status: ExitCode, line: str
) -> None:
    assert_failed(run_at(server, app, *options), status, line)


def test_list_says_so_when_nobody_listens() -> None:
    done = run(app, "--connect", NOWHERE)

    assert_failed(done, ExitCode.UNREACHABLE, "zensim list: UNREACHABLE (4): nobody listens at")


def test_watch_goes_on_through_a_restart_until_it_is_interrupted() -> None:
    with serving("--paused") as first:
        first.zensim("spawn", "box_bot", "--name", "r1")
        arguments = ("list", "-w", "--json", "--every", "0.05", "--connect", first.endpoint)
        with running(*arguments) as watch:
            assert watch.stdout is not None
            assert [row["name"] for row in json.loads(watch.stdout.readline())] == ["r1"]
            first.process.kill()
            first.process.wait()
            with serving("--paused", endpoint=first.endpoint):
                lines = iter(watch.stdout.readline, "")
                eventually(lambda: json.loads(next(lines)) == [], 20.0, "the new server's list")
                watch.send_signal(signal.SIGINT)
                _, said = watch.communicate(timeout=20.0)

    assert watch.returncode == ExitCode.INTERRUPTED
    assert said == "zensim list: note: no server answers; waiting for it\n"
