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
"""With these, 52 bytes of CDR are a Twist."""


class FleetCmdVel:
    """The twists that hold now, a row a robot; robots stand until they are told."""

    def __init__(self, network: AgentNetwork, timeout_ns: int, domain: int | None = None) -> None:
        """Begin to listen to nobody.

        Args:
            network: Where.
            timeout_ns: Simulation time that a twist holds after it was first seen; 0 = for ever.
            domain: Where ROS 2 is heard too; None = nowhere.
        """
        self._domain = domain
        self._network = network
        self._timeout_ns = timeout_ns
        self._subscriptions: dict[str, TopicSubscription] = {}
        self._rows: dict[str, tuple[int, ...]] = {}
        self._twists = np.zeros((0, TWIST_COLUMNS))
        self._seen_ns = np.zeros(0, dtype=np.int64)
        self._faults: dict[str, tuple[int, str]] = {}

    def listen(self, key: str) -> None:
        """Hear a key from now on; its robot gets a row later."""
        pattern = keys.make_pattern(key)
        if pattern not in self._subscriptions:
            self._subscriptions[pattern] = self._subscribe(pattern)

    def _subscribe(self, pattern: str) -> TopicSubscription:
        plain = self._network.subscribe(pattern, FLEET_CMD_VEL_DEPTH)
        if self._domain is None:
            return TopicSubscription(plain, ())
        forms = [
            make_data_key(self._domain, pattern, kind.ros_type, ANY_HASH)
            for kind in (Twist, TwistStamped)
        ]
        return TopicSubscription(
            plain, [self._network.subscribe(one, FLEET_CMD_VEL_DEPTH) for one in forms]
        )

    def remap(self, robots: Sequence[str], before: IntArray) -> None:
        """Carry rows over; see `rows.carried`.

        Args:
            robots: The key of each row; empty for one that is not commanded here.
            before: Where each row was.
        """
        self._twists = remap_floats(self._twists, before)
        self._seen_ns = remap_ints(self._seen_ns, before)
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
        """Forget all twists; those that wait in a channel still count."""
        self._twists[:] = 0.0

    def at(self, time_ns: int) -> FloatArray:
        """Find the twists (n, 6) at a moment of simulation time."""
        heard = self._take_samples()
        if heard:
            self._read(heard, time_ns)
        if self._timeout_ns:
            self._twists[time_ns - self._seen_ns > self._timeout_ns] = 0.0
        return self._twists

    def take_malformed_reports(self) -> Iterator[tuple[str, str]]:
        """Say which keys had malformed commands since the last time, and what was wrong."""
        faults, self._faults = self._faults, {}
        for key, (count, reason) in faults.items():
            yield key, f"malformed={count} reason={reason!r}"

    def _take_samples(self) -> dict[tuple[int, ...], list[Sample]]:
        heard: dict[tuple[int, ...], list[Sample]] = {}
        for subscription in self._subscriptions.values():
            for sample in subscription.take():
                # The robots of other pools are heard too.
                if (rows := self._rows.get(sample.key)) is not None:
                    heard.setdefault(rows, []).append(sample)
        return heard

    def _read(self, heard: dict[tuple[int, ...], list[Sample]], time_ns: int) -> None:
        plain = {rows: samples for rows, samples in heard.items() if _is_plain_twist(samples[-1])}
        if plain:
            image = b"".join([samples[-1].payload for samples in plain.values()])
            numbers = np.frombuffer(image, dtype=TWIST_DTYPE)["numbers"]
            is_finite = np.isfinite(numbers).all(axis=1)
            for rows, fits in zip(list(plain), is_finite.tolist(), strict=True):
                if not fits:
                    del plain[rows]
            self._store(list(plain), numbers[is_finite], time_ns)
        for rows in heard.keys() - plain.keys():
            if (twist := self._newest_good(heard[rows])) is not None:
                linear, angular = twist.linear, twist.angular
                row = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
                self._store([rows], np.array([row]), time_ns)

    def _store(self, robots: list[tuple[int, ...]], twists: FloatArray, time_ns: int) -> None:
        rows = [row for several in robots for row in several]
        if len(rows) != len(robots):
            twists = np.repeat(twists, [len(several) for several in robots], axis=0)
        self._twists[rows] = twists
        self._seen_ns[rows] = time_ns

    def _newest_good(self, samples: list[Sample]) -> Twist | None:
        """Read the newest that is a command: a bad one does not hide the good one before it."""
        for sample in reversed(samples):
            if (twist := self._read_one(sample)) is not None:
                return twist
        return None

    def _read_one(self, sample: Sample) -> Twist | None:
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
