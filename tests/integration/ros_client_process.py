"""Asking as ROS 2 does: by an independent client in a process of its own, and by raw bytes."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import zenoh

from tests.integration.processes import end

ANSWER_S = 10.0
Ask = Callable[..., dict[str, object] | None]
Do = Callable[..., Any]


class Router(Protocol):
    """What the network of a test is joined at."""

    @property
    def endpoint(self) -> str:
        """Where it listens."""


@contextmanager
def observing(server: Router, domain: int, type_hash: str = "") -> Iterator[Do]:
    """Run the independent client, and tell it what to do.

    Args:
        server: Whose network it joins.
        domain: Of ROS 2.
        type_hash: What stands for the hash of every topic's type; empty for the true ones.
    """
    port = server.endpoint.rsplit(":", 1)[1]
    arguments = (port, str(domain), *([type_hash] if type_hash else []))
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.integration.ros_observer", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )

    def do(what: str, **given: object) -> object:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps({"do": what, **given}) + "\n")
        process.stdin.flush()
        return json.loads(process.stdout.readline())

    try:
        yield do
    finally:
        if process.stdin is not None:
            process.stdin.close()
        end(process)


@contextmanager
def ros_client(server: Router, domain: int = 0) -> Iterator[Ask]:
    """Run the independent client, and ask it to call."""
    with observing(server, domain) as do:
        yield asking(do)


def asking(do: Do) -> Ask:
    """Let the client call services."""

    def ask(name: str, kind: str, type_hash: str, /, **fields: object) -> dict[str, object] | None:
        answer: dict[str, object] | None = do(
            "call", name=name, kind=kind, type_hash=type_hash, fields=fields
        )
        return answer

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
    """Ask as rmw_zenoh does: every queryable that is complete, and no answer is merged."""
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


def result_of(answer: dict[str, object] | None) -> int:
    assert answer is not None
    result = answer["result"]
    assert isinstance(result, dict)
    return int(result["result"])
