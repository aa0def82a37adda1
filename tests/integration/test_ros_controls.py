"""Negative controls: an independent client finds each injected fault, and no other.

Production code runs on a bus with one fault. An independent client checks the result, or the
rules of rmw_zenoh where that client is lenient.
"""

import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, cast

import pytest
import zenoh

from tests.integration import ros_interfaces as ros
from tests.integration.processes import free_endpoint
from tests.integration.ros_client_process import replies, run_observer, session_of
from tests.integration.ros_grammar import InvalidToken, check_hash, parse_endpoints
from tests.integration.ros_rules import BrokenRule, ReceivedSample, check_topic, to_received_sample
from tests.integration.ros_subscriptions import tokens
from tests.proto.ros_hashes import hash_of_message
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, BusPublisher, open_bus
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.spawn_messages import DeleteEntityResponse
from zensim.proto.messages.standard_messages import Odometry
from zensim.proto.ros2.ros_graph import RosTopic
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.sample_messages import make_sample_message
from zensim.sim_server.ros2_node.server_node import start_server_node

ODOMETRY = "nav_msgs/msg/Odometry"
ODOM_KEY = f"0/r1/odom/nav_msgs::msg::dds_::Odometry_/{hash_of_message(ODOMETRY)}"
DELETE = "simulation_interfaces/srv/DeleteEntity"
DELETE_KEY = f"0/delete_entity/simulation_interfaces::srv::dds_::DeleteEntity_/{ros.DELETE_HASH}"
ASKED = struct.pack("<qqB", 41, 7, 16) + bytes(range(16))
EMPTY = b"\x00\x01\x00\x00\x01\x00\x00\x00\x00"
LOST_S = 3.0
"""Wait for what a fault makes impossible."""
PATIENCE_S = 60.0
EVERY_S = 0.02


@dataclass(frozen=True)
class Fault:
    """One fault: functions that alter attachments, tokens and keys."""

    attachment: Callable[[bytes], bytes] = bytes
    token: Callable[[str], str] = str
    key: Callable[[str], str] = str
    is_complete: bool = True


def other_hash(key: str) -> str:
    before, _, last = key.rpartition("/RIHS01_")
    return f"{before}/RIHS01_0{last[1:]}" if before else key


def no_pattern(key: str) -> str:
    return f"{key[:-1]}RIHS01_0" if key.endswith("::$*/*") else other_hash(key)


def token_of_other_hash(token: str) -> str:
    before, separator, rest = token.partition("/RIHS01_")
    return f"{before}{separator}0{rest[1:]}" if separator else token


def without_endpoints(token: str) -> str:
    return token if "/NN/" in token else f"nothing/{abs(hash(token))}"


NO_FAULT = Fault()
BROKEN = {
    "attachment": replace(NO_FAULT, attachment=lambda _: b""),
    "attachment that is short": replace(NO_FAULT, attachment=lambda attached: attached[:-1]),
    "gid": replace(NO_FAULT, attachment=lambda attached: attached[:17] + bytes(len(attached[17:]))),
    "tokens": replace(NO_FAULT, token=without_endpoints),
    "complete flag": replace(NO_FAULT, is_complete=False),
    "hash": replace(NO_FAULT, key=no_pattern),
    "hash in tokens": replace(NO_FAULT, token=token_of_other_hash),
    "qos string": replace(NO_FAULT, token=lambda token: token.removesuffix(":,:,:,,")),
}
FOUND = {
    "attachment": {"by the rules", "signed"},
    "attachment that is short": {"by the rules", "signed"},
    "gid": {"by the rules", "signed"},
    "tokens": {"listed", "by the rules"},
    "complete flag": {"answered", "signed"},
    "hash": {"heard", "answered", "signed", "by the rules"},
    "hash in tokens": {"by the rules"},
    "qos string": {"by the rules"},
}
"""Checks of `find_complaints` that fail for each fault."""


class BrokenPublisher:
    """Publishes payloads with an altered attachment."""

    def __init__(self, publisher: BusPublisher, fault: Fault) -> None:
        self._publisher, self._fault = publisher, fault

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return getattr(self._publisher, name)

    def send(self, payload: bytes, attachment: bytes = b"", *stamp: Any) -> None:  # noqa: ANN401
        self._publisher.send(payload, self._fault.attachment(attachment), *stamp)


class BrokenCall:
    """A request whose reply has an altered attachment."""

    def __init__(self, call: Any, fault: Fault) -> None:  # noqa: ANN401
        self._call, self._fault = call, fault

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return getattr(self._call, name)

    def reply(self, payload: bytes, encoding: str, key: str = "", attachment: bytes = b"") -> None:
        self._call.reply(payload, encoding, key, attachment=self._fault.attachment(attachment))


class BrokenQueue:
    """A queue of broken calls."""

    def __init__(self, queue: Any, fault: Fault) -> None:  # noqa: ANN401
        self._queue, self._fault = queue, fault

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return getattr(self._queue, name)

    def take(self) -> list[BrokenCall]:
        return [BrokenCall(call, self._fault) for call in self._queue.take()]


class BrokenBus:
    """A bus with a fault."""

    def __init__(self, bus: Bus, fault: Fault) -> None:
        self._bus, self._fault = bus, fault

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return getattr(self._bus, name)

    def advertise(self, key: str, encoding: str) -> BrokenPublisher:
        return BrokenPublisher(self._bus.advertise(self._fault.key(key), encoding), self._fault)

    def serve(self, key: str, depth: int = 4096, *, is_complete: bool = True) -> BrokenQueue:
        is_complete = is_complete and self._fault.is_complete
        queue = self._bus.serve(self._fault.key(key), depth, is_complete=is_complete)
        return BrokenQueue(queue, self._fault)

    def token(self, key: str) -> Any:  # noqa: ANN401
        return self._bus.token(self._fault.token(key))


@contextmanager
def publishing(fault: Fault) -> Iterator[Bus]:
    """Publish odometry and reply to services, on a network with a fault."""
    with open_bus(BusConfig(mode="router", listen=(free_endpoint(),))) as router:
        bus = cast("Bus", BrokenBus(router, fault))
        side, is_over = start_server_node(bus, RosSettings(), lambda: 0), threading.Event()
        odom = side.topics.publisher(RosTopic("r1/odom", Odometry))
        response, message = (
            encode(DeleteEntityResponse(), Format.CDR),
            make_sample_message(Odometry),
        )

        def run() -> None:
            while not is_over.wait(EVERY_S):
                odom.send(encode(message, Format.CDR))
                for call in (call for source in side.sources for call in source.take()):
                    call.reply(response, "application/cdr")

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield router
        finally:
            is_over.set()
            thread.join()
            side.close()


def find_complaints(router: Bus, expected: set[str]) -> set[str]:
    """Check the odometry of a robot and a service; return the names of failed checks."""
    heard_s, answered_s = (
        LOST_S if one in expected else PATIENCE_S for one in ("heard", "answered")
    )
    with run_observer(router, 0) as observe, session_of(router) as session:
        found_tokens = tokens(session, "@ros2_lv/**")
        request = {"name": "/delete_entity", "kind": DELETE, "type_hash": ros.DELETE_HASH}
        subscription = {
            "topic": "/r1/odom",
            "kind": ODOMETRY,
            "count": 1,
            "within_s": heard_s,
            "qos": "",
        }
        found = {
            "listed": "/r1/odom" in observe("topics") and "/delete_entity" in observe("services"),
            "heard": bool(observe("receive", **subscription)),
            "answered": observe("call", fields={"entity": "x"}, within_s=answered_s, **request)
            is not None,
            "by the rules": follows_rules(found_tokens, samples_of(session)),
            "signed": is_signed(replies(router, DELETE_KEY, EMPTY, ASKED)),
        }
    return {name for name, is_fine in found.items() if not is_fine}


def samples_of(session: zenoh.Session) -> list[ReceivedSample]:
    channel = session.declare_subscriber("0/r1/odom/*/*", zenoh.handlers.FifoChannel(64))
    samples = [to_received_sample(channel.recv()) for _ in range(3)]
    channel.undeclare()
    return samples


def follows_rules(found_tokens: list[str], samples: list[ReceivedSample]) -> bool:
    try:
        for one in parse_endpoints(found_tokens):
            check_hash(one, has_hashes=True)
        check_topic([one for one in found_tokens if "/MP/" in one and "%odom" in one], samples)
    except (BrokenRule, InvalidToken):
        return False
    return True


def is_signed(responses: list[zenoh.Sample]) -> bool:
    """Check that the reply has the sequence number and gid of the request."""
    attached = [one.attachment.to_bytes() if one.attachment else b"" for one in responses]
    return [(one[:8], one[16:]) for one in attached] == [(ASKED[:8], ASKED[16:])]


def test_unbroken_network_has_no_complaints() -> None:
    with publishing(NO_FAULT) as router:
        assert find_complaints(router, set()) == set()


@pytest.mark.parametrize(
    "what",
    [
        pytest.param(what, marks=() if what in ("tokens", "hash") else pytest.mark.long_form)
        for what in BROKEN
    ],
)
def test_each_fault_is_found_by_an_independent_client(what: str) -> None:
    with publishing(BROKEN[what]) as router:
        assert find_complaints(router, FOUND[what]) == FOUND[what]
