"""StepChannel: requests of steps over two topics, at half the cost of a query and its reply."""

import time

from zensim.proto import keys
from zensim.proto.bus.bus_session import Bus
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.simulation_messages import SimulateStepsRequest, SimulateStepsResponse

RETRY_S = 1.0
"""Wall time after which the request is repeated as a query, since a topic may lose messages."""

REPLY_ENCODING = make_encoding(SimulateStepsResponse, Format.MSGPACK)
"""Requests are in MessagePack, and responses are in the format of their request."""


class StepChannel:
    """The two topics of one client that steps.

    Attributes:
        request_id: Of the last request.
    """

    def __init__(self, bus: Bus, world: str, client: str) -> None:
        self.request_id = ""
        self._client = client
        self._number = 0
        encoding = make_encoding(SimulateStepsRequest, Format.MSGPACK)
        self._publisher = bus.advertise(keys.requested_steps(world, client), encoding)
        self._replies = bus.receive(keys.made_steps(world, client))

    def call(self, request: SimulateStepsRequest, timeout_s: float) -> SimulateStepsResponse | None:
        """Request steps, and return the response; None if there was none within some time.

        Args:
            request: Of this client, with steps that it may make.
            timeout_s: Wall time; at most `RETRY_S` is waited.

        Raises:
            MalformedPayload: The reply is not a response.
        """
        self._number += 1
        self.request_id = f"{self._client}-{self._number}"
        wanted = self.request_id.encode()
        self._publisher.send(encode(request, Format.MSGPACK), wanted)
        deadline = time.monotonic() + min(timeout_s, RETRY_S)
        while (found := self._replies.wait(deadline - time.monotonic())) is not None:
            payload, request_id = found
            if request_id == wanted:
                return decode(SimulateStepsResponse, payload, REPLY_ENCODING)
        return None

    def close(self) -> None:
        """Undeclare the topics."""
        self._publisher.close()
        self._replies.close()
