"""The command lines of compose.yaml, run as plain processes: each option and each file is real."""

import os
import socket
import ssl
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.contract.repository import ROOT
from tests.integration.processes import eventually, free_endpoint, running, zensim
from tests.integration.scraping import find_free_port, probe, scrape
from zensim.proto.exit_codes import ExitCode

COMPOSE = ROOT / "deploy" / "containers" / "compose.yaml"
WITHIN_S = 60.0
ROBOTS = 4
CLIENTS = ("pool-1", "pool-2", "sensors", "recorder")
USERS = ("pool", "pool_2", "sensors", "recorder", "page")


@dataclass(frozen=True)
class Deployment:
    """What runs: ports of metrics, port of the page, and folders in place of volumes."""

    ports: dict[str, str]
    page: str
    folder: Path

    def token(self, user: str) -> str:
        """Name the file of a user's token, as an option."""
        return f"@{self.folder / 'run' / user / 'token'}"


def read_services() -> dict[str, Any]:
    services: dict[str, Any] = yaml.safe_load(COMPOSE.read_text())["services"]
    return services


def place(words: list[str], replaced: dict[str, str]) -> list[str]:
    """Put paths and addresses of this host in the place of those of a container."""
    for before, after in replaced.items():
        words = [word.replace(before, after) for word in words]
    return words


def make_certificate(folder: Path) -> None:
    command = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2"
    names = ("-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1")
    files = ("-keyout", str(folder / "page.key"), "-out", str(folder / "page.pem"))
    subprocess.run([*command.split(), *names, *files], check=True, capture_output=True)


def write_tokens(script: list[str], folder: Path) -> None:
    """Run the script of the service `tokens`, with `zensim` of these sources."""
    program = folder / "bin" / "zensim"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m zensim "$@"\n')
    program.chmod(0o755)
    path = f"{program.parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["sh", "-ceu", *(one.replace("$$", "$") for one in script)],
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def deployment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployment]:
    folder = tmp_path_factory.mktemp("compose")
    services, router = read_services(), free_endpoint("tls")
    ports = {name: find_free_port() for name in ("server", *CLIENTS)}
    found = Deployment(ports, find_free_port(), folder)
    replaced = {
        "tls/0.0.0.0:7447": router,
        "--host=0.0.0.0": "--host=127.0.0.1",
        "--host server": "--host 127.0.0.1",
        "--port=8080": f"--port={found.page}",
        "/var/lib/zensim": str(folder / "state"),
        "/run/zensim": str(folder / "run"),
        "/run/secrets": str(folder),
    }
    for user in USERS:
        (folder / "run" / user).mkdir(parents=True)
    (folder / "state").mkdir()
    make_certificate(folder)

    def command_of(name: str) -> list[str]:
        words = place(services[name]["command"], replaced)
        return place(words, {"0.0.0.0:9464": f"127.0.0.1:{found.ports.get(name, '')}"})

    with ExitStack() as stack, pytest.MonkeyPatch.context() as environment:
        environment.setenv("XDG_STATE_HOME", str(folder / "state"))
        environment.chdir(folder / "state")
        environment.setenv("PYTHONPATH", str(ROOT))
        stack.enter_context(running(*command_of("server")))
        eventually(lambda: probe(found.ports["server"], "/readyz") == 200, WITHIN_S, "the server")
        write_tokens(place(services["tokens"]["command"], replaced), folder)
        for name in (*CLIENTS, "page"):
            stack.enter_context(running(*command_of(name)))
        yield found


def test_token_files_are_for_their_owner_only(deployment: Deployment) -> None:
    files = [deployment.folder / "run" / user / "token" for user in USERS]

    assert [oct(file.stat().st_mode & 0o777) for file in files] == [oct(0o600)] * len(USERS)
    assert len({file.read_text() for file in files}) == len(USERS)


@pytest.mark.parametrize("name", ["server", *CLIENTS])
def test_program_of_a_service_becomes_ready(deployment: Deployment, name: str) -> None:
    eventually(partial(is_ready, deployment.ports[name]), WITHIN_S, name)

    assert probe(deployment.ports[name], "/livez") == 200


def is_ready(port: str) -> bool:
    return probe(port, "/readyz") == 200


def has_two(port: str) -> bool:
    return scrape(port).get(("zensim_agent_robots",)) == 2


def test_both_pools_drive_and_the_recorder_records(deployment: Deployment) -> None:
    for name in CLIENTS:
        eventually(partial(is_ready, deployment.ports[name]), WITHIN_S, name)
    operator = ("token", "show", "operator", "--as", "token")
    token = zensim(*operator).stdout.strip()
    spawned = zensim("fleet", "box_bot", "--robots", str(ROBOTS), "--join", token)

    assert spawned.returncode == ExitCode.OK, spawned.stderr
    for pool in ("pool-1", "pool-2"):
        eventually(partial(has_two, deployment.ports[pool]), WITHIN_S, f"robots of {pool}")
    eventually(
        lambda: (
            scrape(deployment.ports["recorder"]).get(("zensim_recorder_messages_total",), 0) > 50
        ),
        WITHIN_S,
        "recorded messages",
    )
    assert list((deployment.folder / "state").glob("zensim_*/*.mcap"))


def test_page_asks_for_its_token(deployment: Deployment) -> None:
    context = ssl.create_default_context(cafile=str(deployment.folder / "page.pem"))

    def get_status() -> int | None:
        try:
            url = f"https://127.0.0.1:{deployment.page}/"
            with urllib.request.urlopen(url, timeout=10.0, context=context) as found:
                return int(found.status)
        except urllib.error.HTTPError as error:
            return error.code
        except OSError:
            return None

    assert eventually(get_status, WITHIN_S, "the page") == 401
    assert (deployment.folder / "state" / "page.token").is_file()


def run_health_check(port: str) -> int:
    """Run the health check of the page against a port of this host."""
    _, python, flag, script = read_services()["page"]["healthcheck"]["test"]
    assert (python, flag) == ("python3", "-c")
    words = [sys.executable, flag, script.replace("8080", port)]
    return subprocess.run(words, capture_output=True, timeout=WITHIN_S, check=False).returncode


def test_health_check_of_the_page_asks_the_page_itself(deployment: Deployment) -> None:
    eventually(lambda: run_health_check(deployment.page) == 0, WITHIN_S, "the page")

    with socket.create_server(("127.0.0.1", 0)) as hanging:  # accepts, and never replies
        assert run_health_check(str(hanging.getsockname()[1])) != 0
