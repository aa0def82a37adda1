"""NodeAnswers: ROS nodes in lockstep, by parameters of the server's node.

The parameter `lockstep./box_bot0/cmd_vel` with the value `/box_bot0/scan` lets time wait for a
message on the first topic after each message on the second.
"""

import logging
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.drive_topic_keys import resolve_cmd_vel_key
from zensim.proto.messages.agent_messages import TwistCommands
from zensim.proto.names import InvalidName, check_namespace
from zensim.proto.network_protocols import Sample, SubscribingNetwork, Subscription, TokenWatch
from zensim.proto.ros2.node_services import NodeParameter, ParameterContent
from zensim.proto.ros2.rmw_keys import mangle_name
from zensim.sim_server.pacing.joined_clients import JoinedState
from zensim.sim_server.pacing.topic_answers import CLIENT_PREFIX, CLOCK_TOPIC, MAX_ANSWERS
from zensim.sim_server.service_parts import ServerParts

PREFIX: Final = "lockstep."
DEPTH: Final = 64
"""Messages that wait: few come while time waits."""
MAX_TRIGGER_BYTES: Final = 64 << 20
LOG = logging.getLogger(__name__)


@dataclass
class AnsweringTopic:
    """Subscriptions to an awaited topic, and to the tokens of its publishers."""

    messages: tuple[Subscription, ...]
    tokens: tuple[TokenWatch, ...]
    alive: set[str] = field(default_factory=set)

    def close(self) -> None:
        """Undeclare all."""
        for one in (*self.messages, *self.tokens):
            one.close()


class NodeAnswers:
    """Awaits ROS nodes, and drives robots by the velocity commands that they answer with."""

    def __init__(self, parts: ServerParts, network: SubscribingNetwork, domain: int) -> None:
        """Await no node yet.

        Args:
            parts: Of the server.
            network: Session of the subscriptions.
            domain: Of ROS 2.
        """
        self._world, self._pacing = parts.world, parts.pacing
        self._answers = parts.pacing.answers
        self._network, self._domain = network, domain
        self._topics: dict[str, AnsweringTopic] = {}
        self._triggers: dict[str, Subscription] = {}
        self._robots: tuple[int, dict[str, str]] = -1, {}

    def list_parameters(self) -> tuple[NodeParameter, ...]:
        """List a parameter for each awaited topic."""
        return tuple(
            NodeParameter(
                PREFIX + topic, one.after, "Topic that is answered in lockstep.", reason=""
            )
            for topic, one in self._answers.topics.items()
        )

    def change(self, name: str, value: ParameterContent) -> str | None:
        """Await a topic after another one, or no longer, as a parameter says.

        Returns:
            Why it is refused; empty if it is done, None if the parameter has another name.
        """
        if not name.startswith(PREFIX):
            return None
        topic, after = name.removeprefix(PREFIX), value
        try:
            self._set(_check_topic(topic), "" if after == "" else _check_topic(after))
        except ValueError as error:
            return str(error)
        LOG.info("lockstep topic=%s after=%s", topic, after)
        return ""

    def serve(self) -> None:
        """Take what has come; call it when the replies of agents and sensors were taken.

        What these publish comes before their replies, so that no step is made without its answers.
        """
        if not self._topics:
            return
        # Answers first: what they answer came before them.
        answers = [
            (topic, sample)
            for topic, one in self._topics.items()
            for subscription in one.messages
            for sample in subscription.take()
        ]
        for after, trigger in self._triggers.items():
            if trigger.take():
                self._note_message(after)
        for topic, sample in answers:
            self._take(topic, sample)
        for topic, one in self._topics.items():
            self._follow_publishers(topic, one)
        for topic in self._answers.note_late():
            self._world.commanded_twists.end_client(CLIENT_PREFIX + topic)

    def note_clock(self) -> None:
        """Await the topics that answer the clock, which was published at a control step."""
        self._note_message(CLOCK_TOPIC)

    def close(self) -> None:
        """Undeclare all subscriptions."""
        for topic in tuple(self._topics):
            self._set(topic, "")

    def _set(self, topic: str, after: str) -> None:
        if after and topic not in self._topics and len(self._topics) >= MAX_ANSWERS:
            raise ValueError(f"{MAX_ANSWERS} topics are awaited; end one by an empty value")
        if after == topic:
            raise ValueError(
                f"topic '{topic}' cannot answer itself; name one that zensim publishes"
            )
        if (former := self._topics.pop(topic, None)) is not None:
            former.close()
        self._answers.set(topic, after)
        self._world.commanded_twists.end_client(CLIENT_PREFIX + topic)
        if after:
            self._topics[topic] = self._listen(topic)
        wanted = {one.after for one in self._answers.topics.values()} - {CLOCK_TOPIC}
        for gone in self._triggers.keys() - wanted:
            self._triggers.pop(gone).close()
        for new in wanted - self._triggers.keys():
            key = new.removeprefix("/")
            self._triggers[new] = self._network.subscribe(key, DEPTH, MAX_TRIGGER_BYTES)

    def _listen(self, topic: str) -> AnsweringTopic:
        name = topic.removeprefix("/")
        subscribe, watch = self._network.subscribe, self._network.watch_tokens
        publishers = f"@ros2_lv/{self._domain}/*/*/*/MP/*/*/*/{mangle_name(topic)}/**"
        bridged = f"@/*/@ros2_lv/MP/{name.replace('/', '§')}/**"
        return AnsweringTopic(
            (subscribe(f"{self._domain}/{name}/*/*", DEPTH), subscribe(name, DEPTH)),
            (watch(publishers), watch(bridged)),
        )

    @property
    def _step(self) -> tuple[int, int]:
        return self._world.clock.epoch, self._world.clock.steps

    def _note_message(self, after: str) -> None:
        state = JoinedState(*self._step, is_awaited=True)
        for topic, answer in self._answers.note_message(after, state, self._pacing.now_ns()):
            self._drive(topic, *answer)

    def _take(self, topic: str, sample: Sample) -> None:
        answer = sample.payload, sample.encoding
        if self._answers.take_answer(topic, answer, self._step):
            self._drive(topic, *answer)

    def _drive(self, topic: str, payload: bytes, encoding: str) -> None:
        """Order the twist of an answer that is a velocity command of a robot."""
        if (entity := self._find_robots().get(topic)) is None:
            return
        try:
            twist = decode_twist(payload, encoding)
        except MalformedPayload as error:
            self._world.claims.rejected["malformed"] += 1
            LOG.debug("answer dropped topic=%s reason=%s", topic, error)
            return
        row = np.array((twist.linear.x, twist.linear.y, twist.angular.z), dtype="<f8")
        order = TwistCommands(CLIENT_PREFIX + topic, (entity,), row.tobytes())
        self._world.commanded_twists.order(self._world.entities.index, order)

    def _find_robots(self) -> dict[str, str]:
        """Map the topics of velocity commands to robots."""
        roster = self._world.entities.roster_number
        if self._robots[0] != roster:
            found = {
                "/" + resolve_cmd_vel_key(one.namespace, one.model.drive): one.name
                for one in self._world.entities
                if one.model.drive
            }
            self._robots = roster, found
        return self._robots[1]

    def _follow_publishers(self, topic: str, one: AnsweringTopic) -> None:
        """Await no node whose last publisher has disappeared, until it answers again."""
        changes = [change for watch in one.tokens for change in watch.take()]
        for token, is_alive in changes:
            (one.alive.add if is_alive else one.alive.discard)(token)
        if changes and one.alive:
            self._answers.resume(topic)
        elif changes:
            self._answers.forget(topic)
            self._world.commanded_twists.end_client(CLIENT_PREFIX + topic)


def _check_topic(name: ParameterContent) -> str:
    """Return the name of a topic with its slash.

    Raises:
        ValueError: It is none.
    """
    if not isinstance(name, str) or not name.startswith("/"):
        raise ValueError(f"{name!r} is no topic; use its name with all slashes, as '/r1/cmd_vel'")
    try:
        return "/" + check_namespace(name)
    except InvalidName as error:
        raise ValueError(str(error)) from error
