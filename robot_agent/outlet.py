"""One topic of one robot: put when somebody listens, and its last value told to who asks."""

from collections.abc import Callable

import msgspec

from proto.codec import Format, encode, encoding_of
from robot_agent.network import Network

QUERY_DEPTH = 64


class Outlet:
    """A topic whose value is made only when it is wanted."""

    def __init__(
        self,
        network: Network,
        key: str,
        message_type: type[msgspec.Struct],
        value: Callable[[], msgspec.Struct | None],
    ) -> None:
        """Declare the topic.

        Args:
            network: Where.
            key: What to put on, and to be asked for.
            message_type: What `value` returns; it travels as CDR.
            value: The last value; None while there is none.
        """
        self._key = key
        self._encoding = encoding_of(message_type, Format.CDR)
        self._value = value
        self._was_matched = False
        self._publisher = network.advertise(key, self._encoding)
        self._queries = network.serve(key, QUERY_DEPTH)

    def publish(self) -> None:
        """Put the value if anybody listens."""
        if self._publisher.is_matched and (value := self._value()) is not None:
            self._publisher.send(encode(value, Format.CDR))

    def announce(self) -> None:
        """Put the value now, and later each time that somebody begins to listen."""
        is_matched = self._publisher.is_matched
        if is_matched and not self._was_matched:
            self.publish()
        self._was_matched = is_matched

    def answer(self) -> None:
        """Tell the value to everybody who has asked."""
        for call in self._queries.take():
            value = self._value()
            if value is None:
                call.drop()
            else:
                call.reply(encode(value, Format.CDR), self._encoding, self._key)

    def close(self) -> None:
        """Withdraw the topic."""
        self._publisher.close()
        self._queries.close()
