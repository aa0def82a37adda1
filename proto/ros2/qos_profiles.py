"""QoS profiles of topics, as rmw_zenoh writes them in its tokens."""

from typing import Final, Literal, TypeVar

import msgspec

from zensim.proto.messages.standard_messages import NANOSECONDS

Reliability = Literal["reliable", "best_effort"]
Durability = Literal["transient_local", "volatile"]
History = Literal["keep_last", "keep_all"]
Liveliness = Literal["automatic", "manual_by_node", "manual_by_topic"]
Word = TypeVar("Word", bound=str)
RMW_RELIABILITY: Final[dict[Reliability, int]] = {"reliable": 1, "best_effort": 2}
RMW_DURABILITY: Final[dict[Durability, int]] = {"transient_local": 1, "volatile": 2}
RMW_HISTORY: Final[dict[History, int]] = {"keep_last": 1, "keep_all": 2}
RMW_LIVELINESS: Final[dict[Liveliness, int]] = {
    "automatic": 1,
    "manual_by_node": 2,
    "manual_by_topic": 3,
}
"""Numbers of rmw."""
INFINITE_NS: Final = (1 << 63) - 1


class Qos(msgspec.Struct, frozen=True, kw_only=True):
    """QoS profile, with the defaults of rmw_zenoh."""

    reliability: Reliability = "reliable"
    durability: Durability = "volatile"
    history: History = "keep_last"
    depth: int = 42
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: Liveliness = "automatic"
    lease_ns: int = INFINITE_NS


DEFAULT_QOS: Final = Qos()
RELIABLE_10: Final = Qos(depth=10)
"""Profile of `create_publisher(topic, 10)` and `create_service` in ROS 2."""
RELIABLE_5: Final = Qos(depth=5)
"""Profile of the sensors of gazebo_ros: `SensorDataQoS().reliable()`."""
LATCHED: Final = Qos(durability="transient_local", depth=1)
"""Late subscribers get the last message."""


def write_qos(qos: Qos) -> str:
    """Write a profile as the last chunk of a token."""
    depth = "" if qos.depth == DEFAULT_QOS.depth else str(qos.depth)
    liveliness = _format_number(RMW_LIVELINESS, qos.liveliness, DEFAULT_QOS.liveliness)
    return ":".join(
        (
            _format_number(RMW_RELIABILITY, qos.reliability, DEFAULT_QOS.reliability),
            _format_number(RMW_DURABILITY, qos.durability, DEFAULT_QOS.durability),
            f"{_format_number(RMW_HISTORY, qos.history, DEFAULT_QOS.history)},{depth}",
            _format_span(qos.deadline_ns),
            _format_span(qos.lifespan_ns),
            f"{liveliness},{_format_span(qos.lease_ns)}",
        )
    )


def _format_number(numbers: dict[Word, int], word: Word, default: Word) -> str:
    return "" if word == default else str(numbers[word])


def _format_span(span_ns: int) -> str:
    seconds, rest = divmod(span_ns, NANOSECONDS)
    return "," if span_ns == INFINITE_NS else f"{seconds},{rest}"


def read_qos(chunk: str) -> Qos:
    """Read reliability, durability, history and depth of a profile; defaults for what is odd."""
    reliability, durability, history, *_ = [*chunk.split(":"), "", "", ""]
    kind, _, depth = history.partition(",")
    return Qos(
        reliability=_find_word(RMW_RELIABILITY, reliability, DEFAULT_QOS.reliability),
        durability=_find_word(RMW_DURABILITY, durability, DEFAULT_QOS.durability),
        history=_find_word(RMW_HISTORY, kind, DEFAULT_QOS.history),
        depth=int(depth) if depth.isdigit() else DEFAULT_QOS.depth,
    )


def _find_word(numbers: dict[Word, int], written: str, default: Word) -> Word:
    return next((word for word, number in numbers.items() if str(number) == written), default)
