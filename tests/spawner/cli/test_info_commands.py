"""`zensim info get` and `set` against a real server."""

import pytest

from tests.integration.processes import Server
from tests.spawner.cli.commands import assert_failed, run_at
from zensim.proto.exit_codes import ExitCode
from zensim.spawner.cli.info_commands import app


def test_get_prints_lines(two: Server) -> None:
    done = run_at(two, app, "get", "r1")

    assert done.out.splitlines() == ["r1: robot", "  tags         -", "  description  box_bot"]


def test_set_keeps_other_values(two: Server) -> None:
    run_at(two, app, "set", "r1", "--tag", "a", "--tag", "b")
    run_at(two, app, "set", "r1", "--category", "dynamic-object")
    run_at(two, app, "set", "r1", "--description", "")

    assert run_at(two, app, "get", "r1", "--json").json() == {
        "entity": "r1",
        "category": "dynamic_object",
        "tags": ["a", "b"],
        "description": "",
    }


def test_no_tags_removes_all_tags(two: Server) -> None:
    run_at(two, app, "set", "r1", "--tag", "a")

    assert run_at(two, app, "set", "r1", "--no-tags", "--json").json()["tags"] == []
    assert two.client.entity_info("r1").tags == ()


@pytest.mark.parametrize(
    ("arguments", "status", "line"),
    [
        (("get", "r9"), ExitCode.NOT_FOUND, "zensim info get: "),
        (("set", "r9", "--tag", "a"), ExitCode.NOT_FOUND, "zensim info set: "),
        (("set", "r1"), ExitCode.USAGE, "zensim info set: "),
        (
            ("set", "r1", "--category", "x"),
            ExitCode.USAGE,
            "zensim info set: ",
        ),
        (
            ("set", "r1", "--tag", "a", "--no-tags"),
            ExitCode.USAGE,
            "zensim info set: ",
        ),
    ],
)
def test_info_fails_with_one_line(
    two: Server, arguments: tuple[str, ...], status: ExitCode, line: str
) -> None:
    assert_failed(run_at(two, app, *arguments), status, line)
