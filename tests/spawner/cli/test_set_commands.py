"""`zensim set`, and the old spellings `state` and `info`."""

import pytest
import typer

from tests.integration.processes import Server
from tests.spawner.cli.commands import assert_failed, run_at
from zensim.proto.exit_codes import ExitCode
from zensim.spawner.cli.info_commands import app as info_app
from zensim.spawner.cli.set_commands import app
from zensim.spawner.cli.state_commands import app as state_app


def test_set_changes_state_and_info_at_once(two: Server) -> None:
    done = run_at(two, app, "r1", "-x", "4", "--tag", "red", "--json")

    printed = done.json()
    assert printed["pose"]["position"]["x"] == pytest.approx(4.0)
    assert printed["tags"] == ["red"]
    assert two.client.entity_state("r1").pose.position.x == pytest.approx(4.0)
    assert two.client.entity_info("r1").tags == ("red",)


@pytest.mark.parametrize("change", [("-x", "4"), ("--category", "robot")])
def test_set_prints_only_what_it_set(two: Server, change: tuple[str, ...]) -> None:
    done = run_at(two, app, "r1", *change)

    assert ("position" in done.out) == (change[0] == "-x")
    assert ("category" in done.out or "robot" in done.out) == (change[0] == "--category")


@pytest.mark.parametrize(
    "change", [(), ("--tag", "a", "--no-tags"), ("--category", "cloud")], ids=str
)
def test_set_is_refused_before_anything_changes(two: Server, change: tuple[str, ...]) -> None:
    assert_failed(run_at(two, app, "r1", *change), ExitCode.USAGE, "zensim set: ")


@pytest.mark.parametrize(
    ("old", "arguments"),
    [
        (state_app, ("get", "r1")),
        (state_app, ("set", "r1", "-x", "2")),
        (info_app, ("get", "r1")),
        (info_app, ("set", "r1", "--tag", "a")),
    ],
    ids=["state get", "state set", "info get", "info set"],
)
def test_old_spellings_work_with_a_note(
    two: Server, old: typer.Typer, arguments: tuple[str, ...]
) -> None:
    done = run_at(two, old, *arguments)

    assert done.status == ExitCode.OK
    assert done.err.count("note: ") == 1
