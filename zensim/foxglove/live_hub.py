"""Clients, their subscriptions, and the messages that they get; no sockets and no threads."""

import secrets
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from itertools import islice
from threading import BoundedSemaphore
from typing import TYPE_CHECKING, Final, Protocol, TypeAlias

from zensim.foxglove import foxglove_protocol as protocol
from zensim.foxglove.foxglove_protocol import AnyClientMessage, ServerMessage, WorldParameter
from zensim.foxglove.live_topics import LiveTopic
from zensim.foxglove.topic_sources import TimedPayload, TopicSource, make_source
from zensim.foxglove.world_control import FAILURES, DriverChannel, WorldControl
from zensim.foxglove.world_topics import WorldTopics
from zensim.proto.bus.bus_session import Bus
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.standard_messages import ns_from_time
from zensim.proto.messages.telemetry_messages import WorldClock
from zensim.proto.topic_catalog import CLOCK
from zensim.spawner.client.topic_reader import read_topic

if TYPE_CHECKING:
    from zensim.spawner.client.topic_reader import TopicReader

NAME: Final = "zensim"
CONTROL_IS_OFF: Final = "control is off; start 'zensim foxglove' with --allow-control"
MAX_SUBSCRIPTIONS: Final = 100_000
MAX_PUBLISHED: Final = 1_000
"""Most channels that one client advertises."""
MAX_WARNINGS: Final = 8
"""Errors that a client gets between two calls of `tick`; of others it gets the number."""
ERRORS_ID: Final = "errors"
"""Id of the status with the number of errors left out; clients replace the last one of an id."""
FETCHERS: Final = 2
"""Queries for latched messages at the same time."""
FETCHED_TOGETHER: Final = 16
"""Topics that one of them takes."""

Outcome: TypeAlias = str | bytes | Callable[[], None] | None
"""A message to the client, or what remains to be done in the thread of the hub."""
Job: TypeAlias = Callable[[], Outcome]
"""Work that blocks, for another thread."""
ReadAsset: TypeAlias = Callable[[str], bytes]


class ClientJob:
    """Work that blocks, of a message of a client.

    Attributes:
        size: Of the message [bytes].
    """

    def __init__(self, job: Job, message: AnyClientMessage, size: int) -> None:
        self._job, self._message, self.size = job, message, size

    def __call__(self) -> Outcome:
        """Do the work."""
        return self._job()

    def fail(self, text: str) -> str | bytes:
        """Make the reply to the client for an error that the work did not handle."""
        match self._message:
            case protocol.FetchAsset():
                return protocol.encode_asset(self._message.request_id, None, text)
            case protocol.ServiceCallRequest():
                numbers = self._message.service_id, self._message.call_id
                return protocol.encode_text(protocol.ServiceCallFailure(*numbers, text))
            case _:
                return protocol.encode_text(protocol.Status(protocol.ERROR, text))


class ClientLink(Protocol):
    """Link to a client; nothing blocks, and messages of topics are left out while it is slow."""

    def send(self, message: str | bytes) -> None:
        """Send a message."""

    def send_data(self, frames: bytes, messages: int) -> bool:
        """Send whole frames with this number of messages of topics; False if they are left out."""

    def is_slow(self) -> bool:
        """Whether messages of topics are left out now."""


class HubClient:
    """What one client has asked for."""

    def __init__(self, link: ClientLink) -> None:
        self.link = link
        self.subscriptions: dict[int, int] = {}
        """Number of the channel by id of the subscription."""
        self.published: dict[int, DriverChannel] = {}
        self.parameters: set[str] | None = set()
        """Parameters whose changes it gets; None = all."""
        self.missed: set[int] = set()
        """Subscriptions of which messages were left out."""
        self._frames: list[bytes] = []
        self._framed: set[int] = set()
        """Subscriptions of the frames."""
        self._warnings = 0

    def send(self, message: ServerMessage) -> None:
        """Send a text."""
        self.link.send(protocol.encode_text(message))

    def warn(self, text: str) -> None:
        """Send an error to the user, unless there were many since `count_errors`."""
        self._warnings += 1
        if self._warnings <= MAX_WARNINGS:
            self.send(protocol.Status(protocol.ERROR, text))

    def warn_of(self, reasons: Iterable[str]) -> None:
        """Send one error for all that is wrong in a message; empty reasons are none."""
        wrong = [one for one in reasons if one]
        if wrong:
            more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
            self.warn(f"{wrong[0]}{more}")

    def count_errors(self) -> None:
        """Send how many errors `warn` has left out since the last call."""
        left_out, self._warnings = self._warnings - MAX_WARNINGS, 0
        if left_out > 0:
            text = f"{left_out} more errors"
            self.send(protocol.Status(protocol.ERROR, text, ERRORS_ID))

    def add_data(self, subscription: int, messages: Iterable[TimedPayload]) -> None:
        """Collect messages of a topic."""
        for time_ns, payload in messages:
            self._frames.append(protocol.frame_data(subscription, time_ns, payload))
            self._framed.add(subscription)

    def flush(self) -> None:
        """Send the collected messages at once; note of which subscriptions they were left out."""
        if self._frames:
            if not self.link.send_data(b"".join(self._frames), len(self._frames)):
                self.missed |= self._framed
            self._frames, self._framed = [], set()


class LiveHub:
    """Sends clients the topics that they subscribe to; call `tick` periodically."""

    def __init__(
        self,
        bus: Bus,
        world: str,
        domain: int | None,
        *,
        control: WorldControl | None,
        read_asset: ReadAsset,
    ) -> None:
        """Subscribe to nothing yet.

        Args:
            bus: Open session.
            world: Its name.
            domain: Of ROS 2; None = without its topics.
            control: What clients may change; None = nothing.
            read_asset: Reads a file by its URI.
        """
        self._bus, self._world, self._domain = bus, world, domain
        self._control, self._read_asset = control, read_asset
        self._session = secrets.token_hex(8)
        self._clients: dict[ClientLink, HubClient] = {}
        self._watch: WorldTopics | None = None
        self._topics: dict[int, LiveTopic] = {}
        self._numbers: dict[str, int] = {}
        self._next_number = 1
        self._sources: dict[int, TopicSource] = {}
        self._subscribers: dict[int, dict[HubClient, int]] = {}
        self._clock: TopicReader[WorldClock] | None = None
        self._now_ns = 0
        self._unfetched: dict[int, Callable[[], None]] = {}
        """Queries for latched messages that wait, by number of the topic."""
        self._fetchers = BoundedSemaphore(FETCHERS)

    @property
    def has_clients(self) -> bool:
        """Whether a client is connected."""
        return bool(self._clients)

    @property
    def has_subscribers(self) -> bool:
        """Whether a client subscribes to a topic."""
        return bool(self._sources)

    def join(self, link: ClientLink) -> None:
        """Add a client, and send it the capabilities, topics and services."""
        client = self._clients[link] = HubClient(link)
        if self._watch is None:
            self._watch = WorldTopics(self._bus, self._world, self._domain)
        client.send(self._make_info())
        if self._topics:
            client.send(self._advertise(self._topics))
        if self._control is not None:
            client.send(protocol.AdvertiseServices(self._control.list_services()))

    def leave(self, link: ClientLink) -> None:
        """Forget a client; a robot that it has driven stops."""
        client = self._clients.pop(link)
        with ExitStack() as ending:  # all of it, whatever fails; robots stop first
            if not self._clients:
                ending.callback(self._forget_topics)
            for subscription in client.subscriptions:
                ending.callback(self._unsubscribe, client, subscription)
            for publisher in client.published.values():
                ending.callback(publisher.close)

    def close(self) -> None:
        """Remove all clients, and end all subscriptions."""
        for link in [*self._clients]:
            self.leave(link)

    def receive(self, link: ClientLink, raw: str | bytes) -> list[ClientJob]:
        """Handle a message of a client; return the work that blocks."""
        client = self._clients[link]
        try:
            message = protocol.decode_client_message(raw)
            return [ClientJob(job, message, len(raw)) for job in self._handle(client, message)]
        except protocol.MalformedMessage as error:
            client.warn(str(error))
            return []

    def take_jobs(self) -> Sequence[Job]:
        """Take the work that the hub itself needs to be done."""
        jobs: list[Job] = [*self._watch.take_jobs()] if self._watch is not None else []
        while self._unfetched and self._fetchers.acquire(blocking=False):
            numbers = [*islice(self._unfetched, FETCHED_TOGETHER)]
            jobs.append(partial(self._fetch, [self._unfetched.pop(one) for one in numbers]))
        return jobs

    def tick(self) -> None:
        """Send what is new since the last call."""
        for client in self._clients.values():
            client.count_errors()
        if self._watch is None:
            return
        if (topics := self._watch.take()) is not None:
            self._set_topics(topics)
        if not self._sources:
            return
        self._take_clock()
        for number, source in self._sources.items():
            self._collect(self._subscribers[number], source.take(self._now_ns))
        for client in self._clients.values():
            self._resend(client)
            client.flush()

    def _collect(self, subscribers: dict[HubClient, int], messages: list[TimedPayload]) -> None:
        for client, subscription in subscribers.items() if messages else ():
            client.add_data(subscription, messages)

    def _resend(self, client: HubClient) -> None:
        """Send again what is sent once, as soon as a slow link has caught up."""
        if not client.missed or client.link.is_slow():
            return
        missed, client.missed = client.missed, set()
        for subscription in missed & client.subscriptions.keys():
            source = self._sources[client.subscriptions[subscription]]
            client.add_data(subscription, source.take_latched(self._now_ns))

    def _fetch(self, fetches: Iterable[Callable[[], None]]) -> None:
        """Query latched messages; blocks."""
        try:
            for fetch in fetches:
                with suppress(*FAILURES):
                    fetch()
        finally:
            self._fetchers.release()

    def _make_info(self) -> protocol.ServerInfo:
        has_control = self._control is not None
        control = protocol.CONTROL_CAPABILITIES if has_control else ()
        encodings = protocol.CONTROL_ENCODINGS if has_control else ()
        return protocol.ServerInfo(
            f"{NAME} {self._world}",
            (*protocol.WATCH_CAPABILITIES, *control),
            encodings,
            {"world": self._world},
            self._session,
        )

    def _advertise(self, topics: Mapping[int, LiveTopic]) -> protocol.Advertise:
        return protocol.Advertise(
            tuple(topic.to_channel(number) for number, topic in topics.items())
        )

    def _set_topics(self, topics: Mapping[str, LiveTopic]) -> None:
        """Send clients which topics are new and which are gone."""
        gone = [
            number
            for name, number in self._numbers.items()
            if topics.get(name) != self._topics[number]
        ]
        for number in gone:
            self._drop_topic(number)
        new = {}
        for name, topic in topics.items():
            if name not in self._numbers:
                number, self._next_number = self._next_number, self._next_number + 1
                new[number] = self._topics[number] = topic
                self._numbers[name] = number
        for client in self._clients.values():
            if gone:
                client.send(protocol.Unadvertise(tuple(gone)))
            if new:
                client.send(self._advertise(new))

    def _drop_topic(self, number: int) -> None:
        del self._numbers[self._topics.pop(number).name]
        for client, subscription in [*self._subscribers.get(number, {}).items()]:
            self._unsubscribe(client, subscription)

    def _forget_topics(self) -> None:
        """End all subscriptions until a client connects."""
        if self._watch is not None:
            self._watch.close()
            self._watch = None
        self._topics, self._numbers = {}, {}

    def _take_clock(self) -> None:
        clock = self._clock.newest() if self._clock is not None else None
        if clock is None:
            return
        now_ns = max(0, ns_from_time(clock.clock))
        if now_ns != self._now_ns:
            self._now_ns = now_ns
            for client in self._clients.values():
                client.link.send(protocol.encode_time(now_ns))

    def _handle(self, client: HubClient, message: AnyClientMessage) -> Iterable[Job]:
        """Handle a message; return the work that blocks."""
        match message:
            case protocol.Subscribe():
                client.warn_of([self._subscribe(client, one) for one in message.subscriptions])
            case protocol.Unsubscribe():
                known = [*filter(client.subscriptions.__contains__, {*message.subscription_ids})]
                for number in known:
                    self._unsubscribe(client, number)
                if unknown := len(message.subscription_ids) - len(known):
                    client.warn(f"{unknown} of the subscriptions do not exist")
            case protocol.FetchAsset():
                return [partial(self._fetch_asset, message)]
            case protocol.SubscribeConnectionGraph() | protocol.UnsubscribeConnectionGraph():
                client.warn("the connection graph is not offered; see 'zensim topic info'")
            case _ if self._control is None:
                self._refuse(client, message)
            case _:
                return self._handle_control(client, message, self._control)
        return ()

    def _refuse(self, client: HubClient, message: AnyClientMessage) -> None:
        if isinstance(message, protocol.ServiceCallRequest):
            numbers = message.service_id, message.call_id
            client.send(protocol.ServiceCallFailure(*numbers, CONTROL_IS_OFF))
        else:
            client.warn(CONTROL_IS_OFF)

    def _subscribe(self, client: HubClient, wanted: protocol.ChannelSubscription) -> str:
        """Subscribe; return why not, if it is refused."""
        number, subscription = wanted.channel_id, wanted.id
        topic = self._topics.get(number)
        subscribers = self._subscribers.get(number, {})
        is_taken = subscription in client.subscriptions or client in subscribers
        if (
            self._watch is None
            or topic is None
            or is_taken
            or len(client.subscriptions) >= MAX_SUBSCRIPTIONS
        ):
            reason = "no such channel" if topic is None else "subscribed already, or too many"
            return f"subscription {subscription} to channel {number} is refused: {reason}"
        known = self._sources.get(number)
        try:
            source = known or make_source(self._bus, topic, self._watch)
            if self._clock is None:
                self._clock = read_topic(self._bus, CLOCK.key(self._world), WorldClock)
        except FAILURES as error:
            return f"subscription {subscription} is refused: {_to_text(error)}"
        client.subscriptions[subscription] = number
        subscribers = self._subscribers.setdefault(number, {})
        subscribers[client] = subscription
        self._sources[number] = source
        if known is not None:
            self._collect({client: subscription}, known.take_latched(self._now_ns))
        elif (fetch := getattr(source, "fetch", None)) is not None:
            self._unfetched[number] = fetch
        return ""

    def _unsubscribe(self, client: HubClient, subscription: int) -> None:
        number = client.subscriptions.pop(subscription)
        client.missed.discard(subscription)
        subscribers = self._subscribers[number]
        del subscribers[client]
        if not subscribers:
            del self._subscribers[number]
            self._unfetched.pop(number, None)
            self._sources.pop(number).close()
        if not self._sources and self._clock is not None:
            self._clock.close()
            self._clock = None

    def _fetch_asset(self, wanted: protocol.FetchAsset) -> bytes:
        try:
            content = self._read_asset(wanted.uri)
        except (*FAILURES, OSError) as error:
            return protocol.encode_asset(wanted.request_id, None, _to_text(error))
        return protocol.encode_asset(wanted.request_id, content)

    def _handle_control(
        self, client: HubClient, message: AnyClientMessage, control: WorldControl
    ) -> Iterable[Job]:
        match message:
            case protocol.ServiceCallRequest():
                return [partial(_call, control, message)]
            case protocol.ClientData():
                self._publish(client, message)
            case protocol.ClientAdvertise():
                client.warn_of([self._open(client, one, control) for one in message.channels])
            case protocol.ClientUnadvertise():
                for number in message.channel_ids:
                    if (publisher := client.published.pop(number, None)) is not None:
                        publisher.close()
            case _:
                return self._handle_parameters(client, message, control)
        return ()

    def _handle_parameters(
        self, client: HubClient, message: AnyClientMessage, control: WorldControl
    ) -> Iterable[Job]:
        match message:
            case protocol.GetParameters():
                return [partial(_read, control, message)]
            case protocol.SetParameters():
                return [partial(self._set, client, control, message)]
            case protocol.SubscribeParameterUpdates():
                names = {*message.parameter_names}
                client.parameters = (client.parameters or set()) | names if names else None
            case protocol.UnsubscribeParameterUpdates():
                kept = (client.parameters or set()) - {*message.parameter_names}
                client.parameters = kept if message.parameter_names else set()
        return ()

    def _publish(self, client: HubClient, message: protocol.ClientData) -> None:
        publisher = client.published.get(message.channel_id)
        if publisher is None:
            client.warn(f"channel {message.channel_id} is not advertised, or is refused")
            return
        try:
            publisher.publish(message.payload)
        except (MalformedPayload, ValueError) as error:
            client.warn(str(error))

    def _open(
        self, client: HubClient, channel: protocol.ClientChannel, control: WorldControl
    ) -> str:
        """Declare a topic that a client publishes; return why not, if it is refused."""
        if channel.id in client.published or len(client.published) >= MAX_PUBLISHED:
            return f"channel {channel.id} is advertised already, or there are {MAX_PUBLISHED}"
        try:
            client.published[channel.id] = control.open_publisher(channel)
        except FAILURES as error:
            return _to_text(error)
        return ""

    def _set(
        self, client: HubClient, control: WorldControl, message: protocol.SetParameters
    ) -> Outcome:
        try:
            control.set_parameters(message.parameters)
            values = control.read_parameters(())
        except FAILURES as error:
            return protocol.encode_text(protocol.Status(protocol.ERROR, _to_text(error)))
        return partial(self._announce_values, client, values, message.id)

    def _announce_values(
        self, setter: HubClient, values: tuple[WorldParameter, ...], request_id: str | None
    ) -> None:
        if request_id is not None:
            setter.send(protocol.ParameterValues(values, request_id))
        for client in self._clients.values():
            self._announce(client, values)

    def _announce(self, client: HubClient, values: tuple[WorldParameter, ...]) -> None:
        wanted = client.parameters
        chosen = tuple(one for one in values if wanted is None or one.name in wanted)
        if chosen:
            client.send(protocol.ParameterValues(chosen))


def _call(control: WorldControl, request: protocol.ServiceCallRequest) -> Outcome:
    try:
        return protocol.encode_response(request, control.call(request))
    except FAILURES as error:
        numbers = request.service_id, request.call_id
        return protocol.encode_text(protocol.ServiceCallFailure(*numbers, _to_text(error)))


def _read(control: WorldControl, message: protocol.GetParameters) -> Outcome:
    try:
        values = control.read_parameters(message.parameter_names)
    except FAILURES as error:
        return protocol.encode_text(protocol.Status(protocol.ERROR, _to_text(error)))
    return protocol.encode_text(protocol.ParameterValues(values, message.id))


def _to_text(error: Exception) -> str:
    return error.message if isinstance(error, ServiceError) else str(error)
