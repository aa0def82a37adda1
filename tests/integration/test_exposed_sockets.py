"""All sockets of all programs: who opens them, by which rule, and what is open by default.

A new program that listens, or a new option for an address, fails here until it has a rule.
"""

import ast
import re
import socket
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

import zensim
from tests.deploy.test_command_settings import list_all_commands
from tests.integration.processes import children, run_in_process, running_up
from zensim.proto.exit_codes import ExitCode

PROGRAMS = ("proto", "sim_server", "spawner", "robot_agent", "zensim", "deploy")
LISTENS = frozenset(
    ("create_server", "open_listener", "listen", "bind", "start_server", "serve_forever")
)
"""Functions and methods by which a socket is opened for others."""
ZENOH = "check_exposure: other hosts by --secure (TLS, join tokens) or --insecure"
PAGE = (
    "check_page_exposure: other hosts by --secure (TLS, token) or --insecure; own Host and Origin"
)
HTTP = "is_own_origin for each request; other hosts by an option of its program"
LOOPBACK = "loopback only"
PROBE = "closed at once: finds out whether a port is free"
RULES = {
    "deploy/cli/router_commands.py": ZENOH,
    "proto/bounded_http_server.py": HTTP,
    "proto/bus/bus_session.py": "a client of the same network",
    "proto/bus/session_opening.py": "of the configuration of a session that others make",
    "proto/endpoints.py": PROBE,
    "proto/web_access.py": PAGE,
    "sim_server/security/secure_folder.py": "TLS, and users with join tokens only",
    "sim_server/server_config.py": ZENOH,
    "spawner/page/page_server.py": PAGE,
    "zensim/foxglove/foxglove_server.py": PAGE,
    "deploy/cli/replay_commands.py": LOOPBACK,
}
"""Modules that listen, and what decides who may connect."""
NOT_SOCKETS = frozenset({"robot_agent/pool/pooled_robots.py"})
"""Modules with a method of that name that subscribes."""
ADDRESS = re.compile("HOST|ADDRESS|ENDPOINT")
OPEN = "0.0.0.0"
EXPOSING = {
    ("up", "--listen"): f"tcp/{OPEN}:0",
    ("up", "--mesh-http"): f"{OPEN}:0",
    ("up", "--metrics"): f"{OPEN}:0",
    ("serve", "--listen"): f"tcp/{OPEN}:0",
    ("serve", "--mesh-http"): f"{OPEN}:0",
    ("serve", "--metrics"): f"{OPEN}:0",
    ("router", "--listen"): f"tcp/{OPEN}:0",
    ("agent", "--metrics"): f"{OPEN}:0",
    ("sensors run", "--metrics"): f"{OPEN}:0",
    ("record", "--metrics"): f"{OPEN}:0",
    ("view", "--host"): OPEN,
    ("foxglove", "--host"): OPEN,
}
"""Options that name an address to serve, with one that other hosts reach."""
NEEDED = {"agent": ("--pool", "0"), "record": ("--all",)}
"""Further words of a command."""
NOT_SERVED = frozenset(
    {
        ("down", "--listen"),  # of what is to end
        ("token create", "--host"),  # that a token names
        ("token show", "--host"),
        ("sweep run", "--ray-address"),  # of a cluster to use
    }
)


def list_listeners(tree: ast.AST) -> Iterator[str]:
    """List the calls by which a module listens."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else ast.unparse(node.func)
        keywords = {one.arg: ast.unparse(one.value) for one in node.keywords}
        is_session = name == "BusConfig" and keywords.get("listen", "()") != "()"
        is_replaced = name == "replace" and "listen" in keywords and "config" in ast.unparse(node)
        if name in LISTENS or is_session or is_replaced:
            yield ast.unparse(node)
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            yield from (name for one in node.bases if "HTTPServer" in (name := ast.unparse(one)))


def test_every_module_that_listens_has_a_rule() -> None:
    root = Path(next(iter(zensim.__path__))).parent
    paths = [path for name in PROGRAMS for path in (root / name).rglob("*.py")]

    found = {
        path.relative_to(root).as_posix(): calls
        for path in paths
        if (calls := list(list_listeners(ast.parse(path.read_text(encoding="utf-8")))))
    }

    assert {name: found[name] for name in found.keys() - RULES.keys() - NOT_SOCKETS} == {}
    assert (RULES.keys() | NOT_SOCKETS) - found.keys() == set()


def test_every_option_for_an_address_has_a_rule() -> None:
    found = {
        (name, option)
        for name, command in list_all_commands()
        for one in command.params
        for option in one.opts
        if option.startswith("--")
        and ADDRESS.search(str(one.metavar))
        and not {"--connect", "--join"} & set(one.opts)
    }

    assert found == EXPOSING.keys() | NOT_SERVED


@pytest.mark.parametrize(("command", "option"), EXPOSING)
def test_program_does_not_serve_other_hosts_without_a_decision(command: str, option: str) -> None:
    words = (*command.split(), option, EXPOSING[command, option], *NEEDED.get(command, ()))

    done = run_in_process(*words)

    assert done.returncode == ExitCode.USAGE, done.stderr
    assert "secure" in done.stderr


def test_default_deployment_listens_on_loopback_only() -> None:
    with running_up("--robots", "1", "--port", "0", "--metrics", "0") as (process, _, _):
        family = [psutil.Process(pid) for pid in (process.pid, *children(process.pid))]
        found = [one for program in family for one in program.net_connections("inet")]

    listening = {one.laddr.ip for one in found if one.status == psutil.CONN_LISTEN}
    datagrams = {one.laddr.ip for one in found if one.type == socket.SOCK_DGRAM}
    assert listening == {"127.0.0.1"}
    assert datagrams <= {"127.0.0.1"}
