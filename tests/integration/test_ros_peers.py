"""Two ROS 2 processes that have only zensim between them exchange samples, replies and tokens."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import zenoh

from tests.integration.processes import (
    connected,
    eventually,
    free_endpoint,
    read_json_line,
    running,
    zensim,
)
from tests.integration.rmw_sessions import open_rmw_session

SAMPLES = 10
KEY = "0/chatter/std_msgs::msg::dds_::String_/RIHS01_0"
SERVICE = "0/add_two_ints/example_interfaces::srv::dds_::AddTwoInts_/RIHS01_0"
TOKEN = "@ros2_lv/0/{}/0/0/NN/%/%/talker"
WITHIN_S = 20.0
Deployment = tuple[str, dict[str, object]]
"""Endpoint, and settings that override those of rmw_zenoh."""
ROBOTLESS = ("--engine", "mujoco")


@contextmanager
def router(*_: object) -> Iterator[Deployment]:
    endpoint = free_endpoint()
    with running("router", "--listen", endpoint), connected(endpoint):
        yield endpoint, {}


@contextmanager
def clients_of_router(*_: object) -> Iterator[Deployment]:
    """Run a router for ROS 2 hosts that cannot reach each other, with the documented override."""
    with router() as (endpoint, _overrides):
        yield endpoint, {"mode": "client", "listen/endpoints": []}


@contextmanager
def serve(*_: object) -> Iterator[Deployment]:
    endpoint = free_endpoint()
    with running("serve", "--listen", endpoint, *ROBOTLESS), connected(endpoint):
        yield endpoint, {}


@contextmanager
def up(*_: object) -> Iterator[Deployment]:
    options = ("--robots", "1", "--no-viewer", "--sensors", "0")
    endpoint = free_endpoint()
    with running("up", "--listen", endpoint, "--json", *ROBOTLESS, *options) as process:
        read_json_line(process)
        yield endpoint, {}


@contextmanager
def secured(folder: object, patch: pytest.MonkeyPatch) -> Iterator[Deployment]:
    """Run a secured server; its ROS 2 hosts use what `zensim token` prints for them."""
    patch.setenv("XDG_STATE_HOME", str(folder))
    endpoint = free_endpoint("tls")
    with running("serve", "--secure", "--listen", endpoint, "--announce", *ROBOTLESS) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        assert zensim("token", "create", "--role", "ros", "--name", "host").returncode == 0
        printed = zensim("token", "show", "host", "--as", "zenoh-config").stdout
        yield "", flatten(json.loads(printed))


def flatten(settings: dict[str, object], prefix: str = "") -> dict[str, object]:
    found: dict[str, object] = {}
    for name, value in settings.items():
        if isinstance(value, dict):
            found |= flatten(value, f"{prefix}{name}/")
        else:
            found[f"{prefix}{name}"] = value
    return found


DEPLOYMENTS = [
    pytest.param(router, marks=pytest.mark.long_form),
    clients_of_router,
    serve,
    pytest.param(up, marks=pytest.mark.long_form),
    secured,
]


@pytest.fixture(scope="module", params=DEPLOYMENTS, ids=lambda one: one.__name__)
def deployment(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Deployment]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))
        with request.param(tmp_path_factory.mktemp("state"), patch) as found:
            yield found


@pytest.fixture(scope="module")
def peers(deployment: Deployment) -> Iterator[tuple[zenoh.Session, zenoh.Session]]:
    with open_rmw_session(*deployment) as one, open_rmw_session(*deployment) as other:
        yield one, other


Peers = tuple[zenoh.Session, zenoh.Session]


def test_peer_receives_every_sample_of_another(peers: Peers) -> None:
    one, other = peers
    received: list[str] = []
    subscriber = other.declare_subscriber(KEY, lambda one: received.append(one.payload.to_string()))
    publisher = one.declare_publisher(KEY)
    # The stub says bool; it is a MatchingStatus.
    eventually(lambda: publisher.matching_status.matching, WITHIN_S, "matching")  # type: ignore[attr-defined]

    for number in range(SAMPLES):
        publisher.put(str(number))

    eventually(lambda: len(received) >= SAMPLES, WITHIN_S, "samples")
    assert received == [str(number) for number in range(SAMPLES)]
    subscriber.undeclare()
    publisher.undeclare()


def test_peer_gets_the_reply_of_another(peers: Peers) -> None:
    one, other = peers
    queryable = one.declare_queryable(SERVICE, reply_with(b"3"), complete=True)

    def call() -> list[bytes]:
        replies = other.get(
            SERVICE,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=2.0,
        )
        return [reply.ok.payload.to_bytes() for reply in replies if reply.ok]

    assert eventually(lambda: call() or None, WITHIN_S, "a reply") == [b"3"]
    queryable.undeclare()


def reply_with(payload: bytes) -> Callable[[zenoh.Query], None]:
    def reply(query: zenoh.Query) -> None:
        with query:
            query.reply(SERVICE, payload)

    return reply


def test_peer_gets_the_token_of_another(peers: Peers) -> None:
    one, other = peers
    tokens, lock = set[str](), threading.Lock()

    def note(sample: zenoh.Sample) -> None:
        with lock:
            change = tokens.add if sample.kind == zenoh.SampleKind.PUT else tokens.discard
            change(str(sample.key_expr))

    watch = other.liveliness().declare_subscriber("@ros2_lv/0/**", note, history=True)
    wanted = TOKEN.format(one.info.zid())
    token = one.liveliness().declare_token(wanted)

    eventually(lambda: wanted in tokens, WITHIN_S, "the token")
    token.undeclare()
    eventually(lambda: wanted not in tokens, WITHIN_S, "its end")
    watch.undeclare()
