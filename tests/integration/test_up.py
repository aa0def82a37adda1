"""`zensim up` and `down` as a new user meets them: ports, variables, the page, and their end."""

import json
import os
import re
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import psutil
import pytest

from tests.integration.page_user import PageUser
from tests.integration.processes import (
    children,
    connected,
    eventually,
    free_endpoint,
    kill,
    read_json_line,
    run_in_process,
    running,
    serving,
    zensim,
)
from zensim.deploy.cli.view_commands import PAGE_NICENESS
from zensim.proto.bus.bus_errors import TooFewFiles
from zensim.proto.exit_codes import ExitCode
from zensim.proto.web_access import name_cookie
from zensim.recording.bag_info import read_info
from zensim.sim_server.security.secure_folder import open_secure_folder
from zensim.spawner.client.sim_client import SimClient

if TYPE_CHECKING:
    import subprocess

SMALL = ("--engine", "mujoco", "--no-viewer", "--sensors", "0")
"""A deployment without what a test does not need."""


@pytest.fixture(autouse=True)
def own_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the records of these runs apart from those of the user."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    for name in ("ZENSIM_CONNECT", "ZENSIM_WORLD"):
        monkeypatch.delenv(name, raising=False)


@contextmanager
def up(
    *arguments: str, endpoint: str = ""
) -> Iterator[tuple["subprocess.Popen[str]", dict[str, object]]]:
    listen = endpoint or free_endpoint()
    with running("up", "--listen", listen, "--json", *SMALL, *arguments) as process:
        yield process, read_json_line(process)


def wait_for_exit(process: "subprocess.Popen[str]") -> int:
    eventually(lambda: process.poll() is not None, 30.0, "its end")
    assert process.returncode is not None
    return process.returncode


def find_child(process: "subprocess.Popen[str]", verb: str) -> int | None:
    """Find the process id of the program that runs a verb."""
    for pid in children(process.pid):
        try:
            words = psutil.Process(pid).cmdline()
        except psutil.NoSuchProcess:
            continue
        if verb in words:
            return pid
    return None


def test_second_up_at_an_endpoint_fails_and_leaves_the_first_world_alone() -> None:
    with up("--robots", "1") as (_, ready):
        endpoint = str(ready["endpoint"])

        done = zensim("up", "--robots", "3", "--listen", endpoint, *SMALL)

        with connected(endpoint) as bus:
            assert len(SimClient(bus).entities()) == 1
    assert done.returncode == ExitCode.FAILED
    assert endpoint in done.stderr
    assert "zensim down" in done.stderr
    assert done.stderr.count("\n") == 1


def test_up_and_serve_listen_although_a_variable_names_another_server(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ZENSIM_CONNECT", "tcp/127.0.0.1:1")

    with up("--robots", "1") as (_, ready):
        assert ready["robots"] == 1
    with serving("--engine", "mujoco") as server:
        assert server.client.info().entities == 0


def test_serve_connects_where_the_variable_says_without_a_flag(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ZENSIM_CONNECT", "tcp/127.0.0.1:1")

    done = zensim("serve", "--wait", "0.1", "--engine", "mujoco")

    assert done.returncode == ExitCode.UNREACHABLE


def test_taken_port_of_the_page_is_reported_before_anything_starts() -> None:
    endpoint = free_endpoint()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]

        done = zensim("up", "--listen", endpoint, "--port", str(port))

    assert done.returncode == ExitCode.FAILED
    assert str(port) in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_missing_page_is_reported_before_anything_starts(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['viser'] = None\n")
    path = os.pathsep.join((str(tmp_path), os.environ.get("PYTHONPATH", str(Path.cwd()))))

    done = zensim("up", prefix=("env", f"PYTHONPATH={path}"))

    assert done.returncode == ExitCode.FAILED
    assert "zensim[viewer]" in done.stderr
    assert done.stderr.count("\n") == 1


def test_world_goes_on_and_the_page_comes_back_when_the_page_dies() -> None:
    arguments = ("--robots", "1", "--engine", "mujoco", "--sensors", "0", "--port", "0")
    with running("up", "--listen", free_endpoint(), "--json", *arguments) as process:
        ready = read_json_line(process)
        first = eventually(lambda: find_child(process, "view"), 30.0, "the page")

        kill(first, signal.SIGKILL)

        second = eventually(
            lambda: (found := find_child(process, "view")) != first and found, 30.0, "a new page"
        )
        port = int(str(ready["viewer"]).rsplit(":", 1)[1])
        eventually(lambda: can_connect(port), 60.0, "the page at its address")
        assert second != first
        assert process.poll() is None
        assert os.getpriority(os.PRIO_PROCESS, second) >= PAGE_NICENESS
        with connected(str(ready["endpoint"])) as bus:
            assert SimClient(bus).info().entities == 1


def test_world_and_page_go_on_when_a_wall_and_a_deleted_robot_are_clicked() -> None:
    arguments = ("--robots", "2", "--world", "walls", "--engine", "mujoco", "--sensors", "0")
    with running("up", "--listen", free_endpoint(), "--json", *arguments, "--port", "0") as process:
        ready = read_json_line(process)
        page = find_child(process, "view")
        with PageUser(str(ready["viewer"])) as user, connected(str(ready["endpoint"])) as bus:
            for name in ("outer_walls", "box_bot1"):
                user.wait_for_row(name)
                user.send("ZensimSelect", entity=name)
                assert user.control(name)["type"] == "GuiFolderMessage"
            SimClient(bus).delete("box_bot1")
            eventually(lambda: "box_bot1" not in user.list_rows(), 20.0, "no such entity")

            user.send("ZensimSelect", entity="box_bot1")
            user.send("ZensimSelect", entity="box_bot0")

            assert user.control("box_bot0")["type"] == "GuiFolderMessage"
            assert "playing" in user.texts()
            assert SimClient(bus).info().state == "playing"
        assert process.poll() is None
        assert find_child(process, "view") == page


def can_connect(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), 1.0).close()
    except OSError:
        return False
    return True


def test_final_real_time_factor_counts_time_before_and_after_a_reset() -> None:
    with up("--robots", "0", "--rtf", "1") as (process, ready):
        with connected(str(ready["endpoint"])) as bus:
            client = SimClient(bus)
            eventually(lambda: client.info().sim_time_s > 3.0, 30.0, "simulation time")
            client.reset()
            eventually(lambda: client.info().sim_time_s > 1.0, 30.0, "time after the reset")
        process.send_signal(signal.SIGINT)
        summary = read_json_line(process)

    factor = float(str(summary["real_time_factor"]))
    assert factor * float(str(summary["wall_time_s"])) > 3.5
    assert factor <= 1.1


def test_hints_name_an_address_that_clients_can_connect_to() -> None:
    port = free_endpoint().rsplit(":", 1)[1]
    listen = f"tcp/0.0.0.0:{port}"
    with running("up", "--insecure", "--listen", listen, "--robots", "1", *SMALL) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(7)]

    text = "".join(lines)
    hints = re.findall(r"--connect (\S+)", text)
    assert f"tcp/127.0.0.1:{port}" in hints
    assert not [hint for hint in hints if "0.0.0.0" in hint]


def test_secured_robots_are_driven_and_recorded_by_programs_with_tokens_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))

    recording = tmp_path / "run.mcap"
    options = ("--robots", "2", "--behaviour", "circle", "--record", str(recording))
    with up("--secure", *options) as (process, ready):
        token = f"@{tmp_path / 'zensim' / 'default' / 'operator.token'}"
        secrets = [account.password for account in open_secure_folder("default").list_active()]

        def list_driven() -> dict[str, str] | None:
            listed = json.loads(run_in_process("list", "--json", "--join", token).stdout)
            moved = [one for one in listed if abs(one["yaw"]) > 0.01]
            return {one["name"]: one["agent"] for one in moved} if len(moved) > 1 else None

        assert str(ready["endpoint"]).startswith("tls/")
        assert eventually(list_driven, 30.0, "driving") == {
            "box_bot0": "box_bot0",
            "box_bot1": "box_bot1",
        }
        lines = [" ".join(psutil.Process(pid).cmdline()) for pid in children(process.pid)]
        assert not [line for line in lines if any(secret in line for secret in secrets)]
        eventually(
            lambda: recording.exists() and recording.stat().st_size > 20_000, 30.0, "recording"
        )
        process.send_signal(signal.SIGINT)
        wait_for_exit(process)
    topics = {one.name for one in read_info(recording).topics if one.messages}
    assert {"/box_bot0/odom", "/box_bot1/tf_static", "/clock"} <= topics


@pytest.mark.parametrize(("options", "can_act"), [((), False), (("--page-role", "operator"), True)])
def test_page_of_a_secured_up_acts_if_its_role_does(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: tuple[str, ...],
    can_act: bool,  # noqa: FBT001
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    given = ("--secure", "--robots", "1", "--behaviour", "none", "--viewer", *options)

    with up(*given, "--port", "0") as (_, ready):
        url, _, token = str(ready["viewer"]).partition("/?")
        secret = token.partition("=")[2]
        cookie = f"{name_cookie(urlsplit(url).port or 0)}={secret}"
        with PageUser(url, cookie=cookie) as visitor:
            visitor.control("Run to this time" if can_act else "Collision shapes")  # the last tab
            labels = visitor.list_labels()
            if can_act:
                visitor.act("Pause")
                eventually(lambda: "paused" in visitor.texts(), 20.0, "a pause")

    file = "page_operator.secret" if can_act else "page.secret"
    assert ({"Spawn", "Stop all"} <= labels) == can_act
    assert (tmp_path / "zensim" / "default" / file).read_text().strip() in token


def test_page_role_needs_a_secured_deployment() -> None:
    done = zensim("up", "--page-role", "operator")

    assert done.returncode == ExitCode.USAGE
    assert "--secure" in done.stderr


def test_down_ends_up_and_everything_it_started() -> None:
    with up("--robots", "1") as (process, ready):
        family = [process.pid, *children(process.pid)]

        done = zensim("down", "--json")
        wait_for_exit(process)

        eventually(lambda: not any(map(psutil.pid_exists, family[1:])), 10.0, "the end of all")
    assert done.returncode == ExitCode.OK
    assert [run["endpoint"] for run in json.loads(done.stdout)] == [ready["endpoint"]]


def test_down_fails_when_nothing_runs() -> None:
    done = zensim("down")

    assert done.returncode == ExitCode.NOT_FOUND
    assert done.stderr.startswith("zensim down: ")


def test_down_ends_the_chosen_one_of_several() -> None:
    with up("--robots", "0") as (first, ready), up("--robots", "0") as (second, _):
        undecided = zensim("down")
        chosen = zensim("down", "--listen", str(ready["endpoint"]))
        wait_for_exit(first)

        assert undecided.returncode == ExitCode.USAGE
        assert "--all" in undecided.stderr
        assert chosen.returncode == ExitCode.OK
        assert second.poll() is None


def test_paused_world_is_ready_without_odometry() -> None:
    paused = ("--robots", "2", "--paused", "--seed", "7")
    with up(*paused) as (_, ready), connected(str(ready["endpoint"])) as bus:
        info = SimClient(bus).info()

    assert (info.state, info.claimed, info.seed) == ("paused", 2, 7)


def under_file_limit(limit: str) -> tuple[str, ...]:
    """Make a command prefix under which a process may have so many open files."""
    return ("bash", "-c", f'ulimit {limit}; exec "$@"', "bash")


@pytest.mark.parametrize(
    ("limit", "command"),
    [("-n 64", ("serve",)), ("-n 128", ("up", "--robots", "10", *SMALL))],
    ids=["server", "deployment"],
)
def test_too_few_open_files_are_named_at_once(limit: str, command: tuple[str, ...]) -> None:
    options = ("--listen", free_endpoint())
    done = zensim(*command, *options, timeout_s=30.0, prefix=under_file_limit(limit))

    assert done.returncode == ExitCode.FAILED
    assert f"zensim {command[0]}: {TooFewFiles.slug}: " in done.stderr
    assert re.search(rf"\b{limit.split()[1]}\b.*'ulimit -n \d+'", done.stderr)


def test_limit_of_open_files_is_raised_where_it_may_be() -> None:
    prefix = under_file_limit("-S -n 64")
    words = ("up", "--listen", free_endpoint(), "--json", "--robots", "2", *SMALL)
    with running(*words, prefix=prefix) as process:
        assert read_json_line(process)["endpoint"]
