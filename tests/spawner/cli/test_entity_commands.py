"""`zensim inspect` and `delete` against a real server."""

import pytest

from tests.integration.processes import Server
from tests.spawner.cli.commands import assert_failed, run_at
from zensim.proto.exit_codes import ExitCode
from zensim.spawner.cli.entity_commands import app


def test_delete_takes_entities_out(two: Server) -> None:
    done = run_at(two, app, "delete", "r1", "r2")

    assert (done.status, done.out) == (ExitCode.OK, "deleted r1\ndeleted r2\n")
    assert two.client.entities() == ()


def test_delete_says_who_does_not_exist(two: Server) -> None:
    done = run_at(two, app, "delete", "r9")

    assert_failed(done, ExitCode.NOT_FOUND, "zensim delete: NOT_FOUND (2): ")
    assert "'r9' does not exist" in done.err
    assert two.client.entities() == ("r1", "r2")


@pytest.mark.parametrize(
    ("names", "status", "failures"),
    [(("r1", "r9"), ExitCode.PARTIAL, 1), (("r8", "r9"), ExitCode.NOT_FOUND, 2)],
)
def test_delete_goes_on_after_a_failure(
    two: Server, names: tuple[str, ...], status: ExitCode, failures: int
) -> None:
    done = run_at(two, app, "delete", *names)

    assert done.status == status
    assert done.err.count("zensim delete: NOT_FOUND (2): ") == done.err.count("\n") == failures
    assert ("r1" in two.client.entities()) == ("r1" not in names)


def test_delete_takes_those_that_match_a_pattern(two: Server) -> None:
    done = run_at(two, app, "delete", "--pattern", "^r[13]$", "--json")

    assert done.json() == [{"name": "r1", "code": 1, "message": ""}]
    assert two.client.entities() == ("r2",)


def test_delete_says_so_when_nothing_matches(two: Server) -> None:
    done = run_at(two, app, "delete", "--pattern", "x")

    assert_failed(done, ExitCode.NOT_FOUND, "zensim delete: NOT_FOUND (3): no name has 'x' in it")
    assert two.client.entities() == ("r1", "r2")


def test_delete_takes_all_and_is_content_when_nobody_is_left(two: Server) -> None:
    first, second = (run_at(two, app, "delete", "--all") for _ in range(2))

    assert (first.status, first.out) == (ExitCode.OK, "deleted r1\ndeleted r2\n")
    assert (second.status, second.out) == (ExitCode.OK, "")


@pytest.mark.parametrize(
    "arguments", [(), ("r1", "--all"), ("r1", "--pattern", "r"), ("--all", "--pattern", "r")]
)
def test_delete_is_refused_when_it_is_not_clear_what_is_meant(
    two: Server, arguments: tuple[str, ...]
) -> None:
    done = run_at(two, app, "delete", *arguments)

    assert_failed(done, ExitCode.USAGE, "zensim delete: USAGE (2): give names, or --pattern REGEX")
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
    assert "category: robot" in lines
    assert "drive: diff_drive" in lines
    assert any("applied" in line for line in lines)


def test_inspect_tells_what_an_entity_is_and_how_large(two: Server) -> None:
    facts = run_at(two, app, "inspect", "r1", "--json").json()

    assert (facts["category"], facts["tags"], facts["description"]) == ("robot", [], "box_bot")
    assert facts["bounds"]["lower"][0] < 0.0 < facts["bounds"]["upper"][0]
    assert facts["twist"]["linear"] == {"x": 0.0, "y": 0.0, "z": 0.0}


def test_inspect_says_who_does_not_exist(two: Server) -> None:
    done = run_at(two, app, "inspect", "r9")

    assert_failed(done, ExitCode.NOT_FOUND, "zensim inspect: NOT_FOUND (2): ")


@pytest.mark.parametrize("arguments", [("delete", "r1"), ("inspect", "r1")], ids=str)
def test_command_says_so_when_nobody_serves_that_world(
    server: Server, arguments: tuple[str, ...]
) -> None:
    done = run_at(server, app, *arguments, "--world-name", "mars")

    assert_failed(
        done, ExitCode.UNREACHABLE, f"zensim {arguments[0]}: UNREACHABLE (4): nothing answers"
    )
