"""cmd_vel of many robots: one subscription per key pattern, decoded in one batch."""

from collections.abc import Iterator, Sequence

import numpy as np

from zensim.proto import keys
from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.codec.message_codec import Format, MalformedPayload, make_encoding
from zensim.proto.messages.standard_messages import Twist, TwistStamped
from zensim.proto.network_protocols import AgentNetwork, Sample
from zensim.proto.ros2.rmw_keys import ANY_HASH, make_data_key
from zensim.proto.topic_endpoints import TopicSubscription
from zensim.robot_agent.pool.robot_rows import FloatArray, IntArray, remap_floats, remap_ints

FLEET_CMD_VEL_DEPTH = 8192
TWIST_COLUMNS = 6
TWIST_BYTES = 52
TWIST_DTYPE = np.dtype([("header", "S4"), ("numbers", "<f8", TWIST_COLUMNS)])
LITTLE_ENDIAN = b"\x00\x01"
PLAIN_ENCODINGS = frozenset({make_encoding(Twist, Format.CDR), Format.CDR.value, "zenoh/bytes", ""})
"""Encodings with which 52 bytes of CDR are a Twist."""


class FleetCmdVel:
    """The current velocity commands, a row per robot; zero until the first one."""

    def __init__(self, network: AgentNetwork, timeout_ns: int, domain: int | None = None) -> None:
        """Create it without subscriptions.

        Args:
            network: Session of the subscriptions.
            timeout_ns: Simulation time for which a command is valid; 0 = for ever.
            domain: ROS 2 domain to subscribe in, too; None = none.
        """
        self._domain = domain
        self._network = network
        self._timeout_ns = timeout_ns
        self._subscriptions: dict[str, TopicSubscription] = {}
        self._rows: dict[str, tuple[int, ...]] = {}
        self._twists = np.zeros((0, TWIST_COLUMNS))
        self._received_ns = np.zeros(0, dtype=np.int64)
        self._faults: dict[str, tuple[int, str]] = {}

    def listen(self, key: str) -> None:
        """Subscribe to a key; its robot gets a row later."""
        pattern = keys.make_pattern(key)
        if pattern not in self._subscriptions:
            self._subscriptions[pattern] = self._subscribe(pattern)

    def _subscribe(self, pattern: str) -> TopicSubscription:
        plain = self._network.subscribe(pattern, FLEET_CMD_VEL_DEPTH)
        if self._domain is None:
            return TopicSubscription(plain, ())
        ros_keys = [
            make_data_key(self._domain, pattern, kind.ros_type, ANY_HASH)
            for kind in (Twist, TwistStamped)
        ]
        return TopicSubscription(
            plain, [self._network.subscribe(one, FLEET_CMD_VEL_DEPTH) for one in ros_keys]
        )

    def remap(self, robots: Sequence[str], before: IntArray) -> None:
        """Remap rows; see `remap_floats`.

        Args:
            robots: The key of each row; empty for a robot that is not in a group.
            before: Former row of each.
        """
        self._twists = remap_floats(self._twists, before)
        self._received_ns = remap_ints(self._received_ns, before)
        self._rows = {}
        for row, key in enumerate(robots):
            if not key:
                continue
            self._rows[key] = (*self._rows.get(key, ()), row)
            self.listen(key)
        patterns = {keys.make_pattern(key) for key in self._rows}
        for pattern in [one for one in self._subscriptions if one not in patterns]:
            self._subscriptions.pop(pattern).close()

    def reset(self) -> None:
        """Forget all commands; those that wait in a subscription still count."""
        self._twists[:] = 0.0

    def at(self, time_ns: int) -> FloatArray:
        """Find the commands (n, 6) at a simulation time."""
        received = self._take_samples()
        if received:
            self._store_newest(received, time_ns)
        if self._timeout_ns:
            self._twists[time_ns - self._received_ns > self._timeout_ns] = 0.0
        return self._twists

    def take_malformed_reports(self) -> Iterator[tuple[str, str]]:
        """Describe the malformed commands since the last call, by key."""
        faults, self._faults = self._faults, {}
        for key, (count, reason) in faults.items():
            yield key, f"malformed={count} reason={reason!r}"

    def _take_samples(self) -> dict[tuple[int, ...], list[Sample]]:
        received: dict[tuple[int, ...], list[Sample]] = {}
        for subscription in self._subscriptions.values():
            for sample in subscription.take():
                # The pattern matches robots of other pools, too.
                if (rows := self._rows.get(sample.key)) is not None:
                    received.setdefault(rows, []).append(sample)
        return received

    def _store_newest(self, received: dict[tuple[int, ...], list[Sample]], time_ns: int) -> None:
        plain = {
            rows: samples for rows, samples in received.items() if _is_plain_twist(samples[-1])
        }
        if plain:
            packed = b"".join([samples[-1].payload for samples in plain.values()])
            numbers = np.frombuffer(packed, dtype=TWIST_DTYPE)["numbers"]
            is_finite = np.isfinite(numbers).all(axis=1)
            for rows, fits in zip(list(plain), is_finite.tolist(), strict=True):
                if not fits:
                    del plain[rows]
            self._store(list(plain), numbers[is_finite], time_ns)
        for rows in received.keys() - plain.keys():
            if (twist := self._decode_newest(received[rows])) is not None:
                linear, angular = twist.linear, twist.angular
                row = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
                self._store([rows], np.array([row]), time_ns)

    def _store(self, robots: list[tuple[int, ...]], twists: FloatArray, time_ns: int) -> None:
        rows = [row for several in robots for row in several]
        if len(rows) != len(robots):
            twists = np.repeat(twists, [len(several) for several in robots], axis=0)
        self._twists[rows] = twists
        self._received_ns[rows] = time_ns

    def _decode_newest(self, samples: list[Sample]) -> Twist | None:
        """Decode the newest valid command: a malformed one does not hide the one before it."""
        for sample in reversed(samples):
            if (twist := self._decode(sample)) is not None:
                return twist
        return None

    def _decode(self, sample: Sample) -> Twist | None:
        try:
            return decode_twist(sample.payload, sample.encoding)
        except MalformedPayload as error:
            count, _ = self._faults.get(sample.key, (0, ""))
            self._faults[sample.key] = (count + 1, str(error))
            return None


def _is_plain_twist(sample: Sample) -> bool:
    return (
        len(sample.payload) == TWIST_BYTES
        and sample.payload[:2] == LITTLE_ENDIAN
        and sample.encoding in PLAIN_ENCODINGS
    )
