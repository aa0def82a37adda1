"""Quality of service, as rmw_zenoh writes it in its tokens: fields at their default are empty.

Source: rmw_zenoh_cpp, liveliness_utils.
"""

import re
from typing import Final, Literal, TypeVar

import msgspec

from zensim.proto.header import NANOSECONDS

Reliability = Literal["reliable", "best_effort"]
Durability = Literal["transient_local", "volatile"]
History = Literal["keep_last", "keep_all"]
Liveliness = Literal["automatic", "manual_by_node", "manual_by_topic"]
Word = TypeVar("Word", bound=str)

RELIABILITY: Final[dict[Reliability, int]] = {"reliable": 1, "best_effort": 2}
DURABILITY: Final[dict[Durability, int]] = {"transient_local": 1, "volatile": 2}
HISTORY: Final[dict[History, int]] = {"keep_last": 1, "keep_all": 2}
LIVELINESS: Final[dict[Liveliness, int]] = {
    "automatic": 1,
    "manual_by_node": 2,
    "manual_by_topic": 3,
}
"""Numbers of rmw."""

INFINITE_NS: Final = (1 << 63) - 1
SPAN: Final = "([0-9]{0,10}),([0-9]{0,10})"
FORM: Final = re.compile(
    rf"([12]?):([12]?):([12]?),([0-9]{{0,20}}):{SPAN}:{SPAN}:([123]?),{SPAN}(?::|$)"
)


class Qos(msgspec.Struct, frozen=True, kw_only=True):
    """A profile; its defaults are those of rmw_zenoh."""

    reliability: Reliability = "reliable"
    durability: Durability = "volatile"
    history: History = "keep_last"
    depth: int = 42
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: Liveliness = "automatic"
    lease_ns: int = INFINITE_NS


DEFAULT: Final = Qos()
RELIABLE_10: Final = Qos(depth=10)
"""What `create_publisher(topic, 10)` and `create_service` of ROS 2 give."""
LATCHED: Final = Qos(durability="transient_local", depth=1)
"""The last value is for those too who come late."""


def write_qos(qos: Qos) -> str:
    """Write a profile as the last chunk of a token."""
    depth = "" if qos.depth == DEFAULT.depth else str(qos.depth)
    return ":".join(
        (
            _number(RELIABILITY, qos.reliability, DEFAULT.reliability),
            _number(DURABILITY, qos.durability, DEFAULT.durability),
            f"{_number(HISTORY, qos.history, DEFAULT.history)},{depth}",
            _span(qos.deadline_ns),
            _span(qos.lifespan_ns),
            f"{_number(LIVELINESS, qos.liveliness, DEFAULT.liveliness)},{_span(qos.lease_ns)}",
        )
    )


def read_qos(text: str) -> Qos | None:
    """Read what `write_qos` writes, and whatever follows; None when it is no profile."""
    found = FORM.match(text)
    if found is None:
        return None
    reliability, durability, history, depth, *spans, liveliness, lease_s, lease_ns = found.groups()
    return Qos(
        reliability=_word(RELIABILITY, reliability, DEFAULT.reliability),
        durability=_word(DURABILITY, durability, DEFAULT.durability),
        history=_word(HISTORY, history, DEFAULT.history),
        depth=int(depth or DEFAULT.depth),
        deadline_ns=_ns(spans[0], spans[1]),
        lifespan_ns=_ns(spans[2], spans[3]),
        liveliness=_word(LIVELINESS, liveliness, DEFAULT.liveliness),
        lease_ns=_ns(lease_s, lease_ns),
    )


def _number(numbers: dict[Word, int], word: Word, default: Word) -> str:
    return "" if word == default else str(numbers[word])


def _word(numbers: dict[Word, int], number: str, default: Word) -> Word:
    return next((word for word, known in numbers.items() if str(known) == number), default)


def _span(span_ns: int) -> str:
    seconds, rest = divmod(span_ns, NANOSECONDS)
    return "," if span_ns == INFINITE_NS else f"{seconds},{rest}"


def _ns(seconds: str, rest: str) -> int:
    if not (seconds or rest):
        return INFINITE_NS
    return int(seconds or 0) * NANOSECONDS + int(rest or 0)
