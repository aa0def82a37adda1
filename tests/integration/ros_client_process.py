"""Calls of ROS 2 services: by an independent client in a separate process, and by raw bytes."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import zenoh

from tests.integration.processes import end

ANSWER_S = 60.0
CallService = Callable[..., dict[str, object] | None]
CallObserver = Callable[..., Any]


class Router(Protocol):
    """The endpoint of a test network."""

    @property
    def endpoint(self) -> str:
        """Endpoint that it listens on."""


@contextmanager
def run_observer(server: Router, domain: int, type_hash: str = "") -> Iterator[CallObserver]:
    """Run the independent client, and yield a function that calls its methods.

    Args:
        server: Network to connect to.
        domain: ROS 2 domain.
        type_hash: Replacement of all type hashes; empty for the actual ones.
    """
    port = server.endpoint.rsplit(":", 1)[1]
    arguments = (port, str(domain), *([type_hash] if type_hash else []))
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.integration.ros_observer", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )

    def observe(what: str, **given: object) -> object:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps({"do": what, **given}) + "\n")
        process.stdin.flush()
        return json.loads(process.stdout.readline())

    try:
        yield observe
    finally:
        if process.stdin is not None:
            process.stdin.close()
        end(process)


@contextmanager
def ros_client(server: Router, domain: int = 0) -> Iterator[CallService]:
    """Run the independent client, and yield a function that calls services."""
    with run_observer(server, domain) as observe:
        yield make_service_call(observe)


def make_service_call(observe: CallObserver) -> CallService:
    """Make a function that calls services with the client."""

    def ask(name: str, kind: str, type_hash: str, /, **fields: object) -> dict[str, object] | None:
        response: dict[str, object] | None = observe(
            "call", name=name, kind=kind, type_hash=type_hash, fields=fields
        )
        return response

    return ask


@contextmanager
def session_of(server: Router) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([server.endpoint]))
    config.insert_json5("timestamping/enabled", "true")
    with zenoh.open(config) as found:
        yield found


def replies(
    server: Router, key: str, payload: bytes, attachment: bytes | None
) -> list[zenoh.Sample]:
    """Query like rmw_zenoh: all complete queryables, without consolidation."""
    with session_of(server) as session:
        found = session.get(
            key,
            payload=payload,
            attachment=attachment,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=ANSWER_S,
        )
        return [reply.ok for reply in found if reply.ok is not None]


def result_of(response: dict[str, object] | None) -> int:
    assert response is not None
    result = response["result"]
    assert isinstance(result, dict)
    return int(result["result"])
