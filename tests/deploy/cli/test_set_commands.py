"""`zensim set`, and `zensim inspect` of what it set, against a real server."""

import pytest
from msgspec.structs import astuple

from tests.deploy.cli.commands import assert_failed, run_at
from tests.integration.processes import Server
from zensim.deploy.cli.entity_commands import app as entity_app
from zensim.deploy.cli.set_commands import app
from zensim.proto.exit_codes import ExitCode
from zensim.proto.rigid_transforms import to_rpy


def test_set_changes_state_and_info_at_once(two: Server) -> None:
    done = run_at(two, app, "r1", "-x", "4", "--tag", "red", "--json")

    printed = done.json()
    assert printed["pose"]["position"]["x"] == pytest.approx(4.0)
    assert printed["tags"] == ["red"]
    assert two.client.entity_state("r1").pose.position.x == pytest.approx(4.0)
    assert two.client.entity_info("r1").tags == ("red",)


def test_set_prints_position_and_velocity(two: Server) -> None:
    lines = run_at(two, app, "r1", "-x", "1").out.splitlines()

    assert lines[0] == "r1 in world at 0.000 s"
    assert [line.split()[-3:] for line in lines[1:3]] == [
        ["1.0000", "0.0000", "0.0600"],
        ["0.0000", "0.0000", "0.5000"],
    ]


def test_set_prints_category_tags_and_description(two: Server) -> None:
    done = run_at(two, app, "r1", "--tag", "a")

    assert done.out.splitlines() == ["r1: robot", "  tags         a", "  description  box_bot"]


@pytest.mark.parametrize("change", [("-x", "4"), ("--category", "robot")])
def test_set_prints_only_what_it_set(two: Server, change: tuple[str, ...]) -> None:
    done = run_at(two, app, "r1", *change)

    assert ("position" in done.out) == (change[0] == "-x")
    assert ("category" in done.out or "robot" in done.out) == (change[0] == "--category")


def test_set_keeps_other_values_of_the_state(two: Server) -> None:
    done = run_at(two, app, "r1", "-y", "-2", "--linear", "0.1", "0", "-0.2")

    state = two.client.entity_state("r1")
    position, linear = state.pose.position, state.twist.linear
    assert done.status == ExitCode.OK
    assert (position.x, position.y, position.z) == pytest.approx((1.0, -2.0, 0.06))
    assert to_rpy(astuple(state.pose.orientation)) == pytest.approx((0.0, 0.0, 0.5))
    assert (linear.x, linear.y, linear.z) == pytest.approx((0.1, 0.0, -0.2))


def test_set_keeps_other_values_of_the_info(two: Server) -> None:
    run_at(two, app, "r1", "--tag", "a", "--tag", "b")
    run_at(two, app, "r1", "--category", "dynamic-object")
    run_at(two, app, "r1", "--description", "")

    info = run_at(two, entity_app, "inspect", "r1", "--json").json()

    assert {name: info[name] for name in ("category", "tags", "description")} == {
        "category": "dynamic_object",
        "tags": ["a", "b"],
        "description": "",
    }


def test_no_tags_removes_all_tags(two: Server) -> None:
    run_at(two, app, "r1", "--tag", "a")

    assert run_at(two, app, "r1", "--no-tags", "--json").json()["tags"] == []
    assert two.client.entity_info("r1").tags == ()


def test_set_uses_the_frame_of_another_entity(two: Server) -> None:
    run_at(two, app, "r1", "--frame", "r2", "-x", "1", "-y", "0", "-Y", "-1.5")

    state = two.client.entity_state("r1")
    position = state.pose.position
    assert (position.x, position.y) == pytest.approx((1.0, -3.0))
    assert to_rpy(astuple(state.pose.orientation))[2] == pytest.approx(-1.5)


def test_inspect_uses_the_frame_of_another_entity(two: Server) -> None:
    facts = run_at(two, entity_app, "inspect", "r1", "--frame", "r2", "--json").json()

    assert (facts["name"], facts["y"]) == ("r1", pytest.approx(3.0))


def test_set_angular_keeps_linear_velocity(two: Server) -> None:
    run_at(two, app, "r1", "--linear", "0.1", "0", "0")

    run_at(two, app, "r1", "--angular", "0", "0", "1")

    twist = two.client.entity_state("r1").twist
    assert (twist.linear.x, twist.angular.z) == pytest.approx((0.1, 1.0))


@pytest.mark.parametrize(
    "change", [(), ("--tag", "a", "--no-tags"), ("--category", "cloud")], ids=str
)
def test_set_is_refused_before_anything_changes(two: Server, change: tuple[str, ...]) -> None:
    assert_failed(run_at(two, app, "r1", *change), ExitCode.USAGE, "zensim set: ")


def test_set_refuses_what_is_no_number(two: Server) -> None:
    assert_failed(run_at(two, app, "r1", "-x", "nan"), ExitCode.USAGE, "zensim ", ": -x nan is no")


@pytest.mark.parametrize("arguments", [("r9", "-x", "1"), ("r9", "--tag", "a")], ids=str)
def test_set_names_an_entity_that_is_not_there(two: Server, arguments: tuple[str, ...]) -> None:
    assert_failed(run_at(two, app, *arguments), ExitCode.NOT_FOUND, "zensim set: ", "'r9'")


def test_inspect_names_a_frame_that_is_not_there(two: Server) -> None:
    done = run_at(two, entity_app, "inspect", "r1", "--frame", "r9")

    assert_failed(done, ExitCode.NOT_FOUND, "zensim inspect: ", "r9")
