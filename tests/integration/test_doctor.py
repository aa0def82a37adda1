"""`zensim doctor` on networks with each fault that it distinguishes."""

import json
import signal
import socket
from pathlib import Path

import zenoh

from tests.integration.processes import (
    Server,
    connected,
    eventually,
    free_endpoint,
    kill,
    run_in_process,
    running,
    running_agents,
    serving,
    without_libraries,
    zensim,
)
from tests.integration.rmw_sessions import open_rmw_session
from tests.integration.sensor_runs import read_sensor_rows, running_sensors
from zensim.proto.exit_codes import ExitCode

NODE_OF_ROS = "@ros2_lv/0/1234/0/0/NN/%/%/{}"
DENY_QUERIES = {
    "enabled": True,
    "default_permission": "allow",
    "rules": [
        {
            "id": "no_queries",
            "permission": "deny",
            "messages": ["query"],
            "flows": ["ingress"],
            "key_exprs": ["sim/**"],
        }
    ],
    "subjects": [{"id": "all"}],
    "policies": [{"rules": ["no_queries"], "subjects": ["all"]}],
}


def run_doctor(endpoint: str, *arguments: str) -> tuple[ExitCode, list[dict[str, str]]]:
    """Run the doctor and parse its findings."""
    done = run_in_process("doctor", "--json", "--connect", endpoint, *arguments)
    assert done.stderr == ""
    return ExitCode(done.returncode), json.loads(done.stdout)


def run_failing_doctor(endpoint: str, *arguments: str) -> tuple[ExitCode, str, str]:
    """Run the doctor on a faulty network; the fault is the last finding."""
    status, found = run_doctor(endpoint, *arguments)
    assert [one["mark"] for one in found].count("wrong") == 1
    assert found[-1]["mark"] == "wrong"
    assert found[-1]["advice"]
    return status, found[-1]["what"], found[-1]["found"]


def advice_of(server: Server, what: str) -> str:
    status, found = run_doctor(server.endpoint)
    assert status is ExitCode.OK
    return next(one["advice"] for one in found if one["what"] == what)


def test_doctor_reports_a_missing_router() -> None:
    status, what, _ = run_failing_doctor(free_endpoint())

    assert (status, what) == (ExitCode.UNREACHABLE, "endpoint")


def test_doctor_reports_a_listener_other_than_a_router() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        status, what, _ = run_failing_doctor(f"tcp/127.0.0.1:{other.getsockname()[1]}")

    assert (status, what) == (ExitCode.UNREACHABLE, "session")


def test_doctor_reports_a_router_without_a_server_and_with_another_world() -> None:
    endpoint = free_endpoint()
    with running("router", "--listen", endpoint), connected(endpoint):
        status, what, _ = run_failing_doctor(endpoint)
        assert (status, what) == (ExitCode.UNREACHABLE, "server")

        with running("serve", "--connect", endpoint, "--world-name", "other"):
            eventually(
                lambda: "'other'" in run_failing_doctor(endpoint)[2], 20.0, "serving another world"
            )


def test_doctor_reports_denied_queries() -> None:
    endpoint = free_endpoint()
    settings = json.loads(zensim("router", "--listen", endpoint, "--print-config").stdout)
    settings["access_control"] = DENY_QUERIES
    with (
        zenoh.open(zenoh.Config.from_json5(json.dumps(settings))),
        running("serve", "--connect", endpoint),
    ):
        eventually(
            lambda: "denied" in run_failing_doctor(endpoint)[2], 20.0, "serving behind the control"
        )


def test_doctor_reports_causes_of_immobile_robots_and_a_suspended_server() -> None:
    # Slowly, so that a busy machine is quick enough for real time, too.
    with serving("--paused", "--rtf", "0.1") as server:
        server.zensim("spawn", "box_bot", "--name", "r1")

        assert "'zensim play'" in advice_of(server, "time")
        assert "'zensim agent r1'" in advice_of(server, "robots")
        assert server.zensim("play").returncode == 0
        eventually(lambda: advice_of(server, "time") == "", 20.0, "running in real time")

        kill(server.process.pid, signal.SIGSTOP)
        try:
            status, what, _ = run_failing_doctor(server.endpoint)
        finally:
            kill(server.process.pid, signal.SIGCONT)
        assert (status, what) == (ExitCode.UNREACHABLE, "session")


def test_doctor_names_the_libraries_that_sensors_lack(tmp_path: Path) -> None:
    bare = without_libraries(tmp_path, "moderngl", "embreex")
    with serving("--paused") as server:
        server.zensim("spawn", "box_bot_camera", "--name", "r1")
        assert "'zensim sensors run'" in advice_of(server, "sensors")

        run = ("sensors", "run", "--quiet", "--name", "s1", "--connect", server.endpoint)
        with running(*run, prefix=bare):
            eventually(lambda: advice_of(server, "sensors") == "", 20.0, "a sensor process")
            found = [one for one in run_doctor(server.endpoint)[1] if one["what"] == "libraries"]
            report = server.zensim("spawn", "box_bot_camera", "--name", "r2", "--json")
            (row,) = [one for one in read_sensor_rows(server) if one["entity"] == "r1"]

    assert ["moderngl" in one["found"] for one in found] == [False, True]
    assert ["s1" in one["found"] for one in found] == [True, True]
    assert "libegl1" in found[1]["advice"]
    assert "sensor.no_renderer: " in report.stdout
    assert row["fault"].startswith("sensor.no_renderer: ")
    assert row["process"] == ""


def rows_of_stack(server: Server, stack: str) -> set[str]:
    """Check a robot for a stack; none while anything is wrong, else the rows that are right."""
    status, found = run_doctor(server.endpoint, "--ros", stack, "r1")
    right = {one["what"] for one in found if one["mark"] == "ok"}
    return right if status is ExitCode.OK else set()


def test_doctor_checks_what_ros_stacks_ask_of_a_robot_with_a_lidar() -> None:
    with serving("--ros-domain", "0") as server:
        server.zensim("spawn", "box_bot_lidar", "--name", "r1")
        status, found = run_doctor(server.endpoint, "--ros", "nav2", "r1")
        assert (status, found[-1]["what"]) == (ExitCode.FAILED, "ROS 2")

        with running_agents(server, "r1"), running_sensors(server, "s1"):
            nav2, slam, rviz = (
                eventually(lambda stack=stack: rows_of_stack(server, stack), 60.0, stack)  # type: ignore[misc]
                for stack in ("nav2", "slam", "rviz")
            )
            assert nav2 >= {"odometry", "covariances", "odom tf", "base frame", "cmd_vel"}
            assert slam >= {"clock", "scan", "scan angles", "scan frame", "scan stamps"}
            assert rviz >= {"description", "link frames", "fixed frame", "meshes", "hosts"}

            status, found = run_doctor(server.endpoint, "--ros", "nav2", "r2")
            assert (status, found[-1]["what"]) == (ExitCode.NOT_FOUND, "robot")
            # A process that listens nowhere is one of a host that cannot be reached.
            with open_rmw_session(server.endpoint) as here:
                own = here.liveliness().declare_token(NODE_OF_ROS.format("here"))
                assert row_of_hosts(server) == ("ok", False)
                with open_rmw_session(server.endpoint, {"listen/endpoints": []}) as far:
                    distant = far.liveliness().declare_token(NODE_OF_ROS.format("far"))
                    eventually(lambda: row_of_hosts(server) == ("note", True), 30.0, "the row")
                    distant.undeclare()
                own.undeclare()


def row_of_hosts(server: Server) -> tuple[str, bool]:
    """Find the mark of the row of hosts, and whether it names the distant node alone."""
    _, found = run_doctor(server.endpoint, "--ros", "nav2", "r1")
    (row,) = [one for one in found if one["what"] == "hosts"]
    return row["mark"], "/far" in row["found"] and "/here" not in row["found"]


def test_doctor_refuses_a_stack_without_a_robot() -> None:
    for words in (("--ros", "nav2"), ("r1",), ("--ros", "rviz", "r1", "--ros-domain", "off")):
        assert run_in_process("doctor", *words).returncode == ExitCode.USAGE
