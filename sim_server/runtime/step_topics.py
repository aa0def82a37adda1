"""StepTopics: requests of steps that clients publish, at half the cost of a query and its reply."""

from collections import OrderedDict
from typing import TypeVar

import msgspec

from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, make_encoding
from zensim.proto.messages.simulation_messages import SimulateStepsRequest, SimulateStepsResponse
from zensim.proto.network_protocols import MAX_REQUEST_ID_BYTES, Publisher, Sample, TopicNetwork
from zensim.proto.security.roles import STEPS_USER
from zensim.proto.service_catalog import SIMULATE_STEPS

Message = TypeVar("Message", bound=msgspec.Struct)
DEPTH = 64
"""Requests that wait; one client steps at a time, and waits for each reply."""
MAX_CLIENTS = 16
"""Clients whose publishers are kept."""


class PublishedCall:
    """A published request of steps; the reply is published with the same request id."""

    name = SIMULATE_STEPS.name
    user = STEPS_USER
    session = ""

    def __init__(self, sample: Sample, topics: "StepTopics") -> None:
        self.payload, self.start = sample.payload, sample.payload[:1]
        self.encoding = sample.encoding
        self.request_id = sample.attachment[: MAX_REQUEST_ID_BYTES + 1]
        self.size = len(sample.payload)
        self.client = keys.parse_stepping_client(sample.key)
        self._topics = topics

    def read(self, kind: type[Message]) -> Message:
        """Decode the request.

        Raises:
            MalformedPayload: The bytes are not that message, or not of the client of the key.
        """
        request = decode(kind, self.payload, self.encoding)
        if not isinstance(request, SimulateStepsRequest) or request.client != self.client:
            raise MalformedPayload(f"the request is not of client '{self.client}'")
        return request

    def reply(self, payload: bytes, encoding: str, key: str = "") -> None:
        """Publish the response."""
        del encoding, key
        self._topics.find_publisher(self.client).send(payload, self.request_id)

    def drop(self) -> None:
        """End the request without a reply."""


class StepTopics:
    """Source of the requests that clients of one world publish."""

    def __init__(self, network: TopicNetwork, world: str) -> None:
        self._network = network
        self._world = world
        self._requests = network.subscribe(keys.requested_steps(world, "*"), DEPTH)
        self._publishers: OrderedDict[str, Publisher] = OrderedDict()

    def take(self) -> list[PublishedCall]:
        """Take all requests received, oldest first."""
        return [PublishedCall(sample, self) for sample in self._requests.take()]

    def find_publisher(self, client: str) -> Publisher:
        """Find the publisher of the responses to a client; that of the oldest client is closed."""
        if client not in self._publishers:
            if len(self._publishers) >= MAX_CLIENTS:
                self._publishers.popitem(last=False)[1].close()
            encoding = make_encoding(SimulateStepsResponse, Format.MSGPACK)
            self._publishers[client] = self._network.advertise(
                keys.made_steps(self._world, client), encoding
            )
        return self._publishers[client]
