"""`zensim state get` and `set` against a real server."""

import pytest
from msgspec.structs import astuple

from tests.integration.processes import Server
from tests.spawner.cli.commands import assert_failed, run_at
from zensim.proto.exit_codes import ExitCode
from zensim.proto.rigid_transforms import to_rpy
from zensim.spawner.cli.state_commands import app


def test_get_prints_lines(two: Server) -> None:
    lines = run_at(two, app, "get", "r1").out.splitlines()

    assert lines[0] == "r1 in world at 0.000 s"
    assert [line.split()[-3:] for line in lines[1:3]] == [
        ["1.0000", "0.0000", "0.0600"],
        ["0.0000", "0.0000", "0.5000"],
    ]


def test_get_prints_json_in_another_frame(two: Server) -> None:
    state = run_at(two, app, "get", "r1", "--frame", "r2", "--json").json()

    assert (state["entity"], state["header"]["frame_id"]) == ("r1", "r2")
    assert state["pose"]["position"]["y"] == pytest.approx(3.0)


def test_set_keeps_other_values(two: Server) -> None:
    done = run_at(two, app, "set", "r1", "-y", "-2", "--linear", "0.1", "0", "-0.2")

    state = two.client.entity_state("r1")
    position, linear = state.pose.position, state.twist.linear
    assert done.status == ExitCode.OK
    assert (position.x, position.y, position.z) == pytest.approx((1.0, -2.0, 0.06))
    assert to_rpy(astuple(state.pose.orientation)) == pytest.approx((0.0, 0.0, 0.5))
    assert (linear.x, linear.y, linear.z) == pytest.approx((0.1, 0.0, -0.2))


def test_set_uses_the_frame_of_another_entity(two: Server) -> None:
    run_at(two, app, "set", "r1", "--frame", "r2", "-x", "1", "-y", "0", "-Y", "-1.5")

    state = two.client.entity_state("r1")
    position = state.pose.position
    assert (position.x, position.y) == pytest.approx((1.0, -3.0))
    assert to_rpy(astuple(state.pose.orientation))[2] == pytest.approx(-1.5)


def test_set_angular_keeps_linear_velocity(two: Server) -> None:
    run_at(two, app, "set", "r1", "--linear", "0.1", "0", "0")

    run_at(two, app, "set", "r1", "--angular", "0", "0", "1")

    twist = two.client.entity_state("r1").twist
    assert (twist.linear.x, twist.angular.z) == pytest.approx((0.1, 1.0))


@pytest.mark.parametrize(
    ("arguments", "status", "line"),
    [
        (
            ("get", "r9"),
            ExitCode.NOT_FOUND,
            "zensim state get: ",
        ),
        (("get", "r1", "--frame", "r9"), ExitCode.NOT_FOUND, "zensim state get: "),
        (("set", "r9", "-x", "1"), ExitCode.NOT_FOUND, "zensim state set: "),
        (("set", "r1"), ExitCode.USAGE, "zensim state set: "),
        (("set", "r1", "-x", "nan"), ExitCode.USAGE, "zensim "),
    ],
)
def test_state_fails_with_one_line(
    two: Server, arguments: tuple[str, ...], status: ExitCode, line: str
) -> None:
    assert_failed(run_at(two, app, *arguments), status, line)
