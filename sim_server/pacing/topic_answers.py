"""TopicAnswers: messages that are awaited after others, as ROS nodes answer sensors in lockstep."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from zensim.sim_server.pacing.joined_clients import JoinedState
from zensim.sim_server.pacing.lockstep import Lockstep

MAX_ANSWERS = 1024
"""Most topics that are awaited."""
CLOCK_TOPIC = "/clock"
CLIENT_PREFIX = "topic "
"""Prefix among the clients of `Lockstep`; agents have no space in their names."""


@dataclass
class AwaitedTopic:
    """A topic whose message is awaited after each message of another one.

    Attributes:
        after: The other topic.
        pending: Control step at which its message came, while the answer is awaited.
        early_step: Epoch and step of an answer that came before what it answers.
        early: Payload and encoding of that answer.
        is_late: Whether the last answer was not in time.
        is_gone: Whether its last publisher has disappeared.
    """

    after: str
    pending: JoinedState | None = None
    early_step: tuple[int, int] = (-1, -1)
    early: tuple[bytes, str] | None = None
    is_late: bool = False
    is_gone: bool = False


@dataclass
class TopicAnswers:
    """All topics that are awaited, by name; `Lockstep` says how long, and what happens then."""

    lockstep: Lockstep
    topics: dict[str, AwaitedTopic] = field(default_factory=dict)

    @property
    def has_topics(self) -> bool:
        """Whether any topic is awaited, so that the world is in lockstep."""
        return bool(self.topics)

    def set(self, topic: str, after: str) -> None:
        """Await a topic after each message of another from now on; no topic ends it."""
        self.forget(topic)
        self.topics.pop(topic, None)
        if after:
            self.topics[topic] = AwaitedTopic(after)

    def forget(self, topic: str) -> None:
        """Await no answers, until a publisher appears or a message comes: its node is gone."""
        self.lockstep.forget(CLIENT_PREFIX + topic)
        if topic in self.topics:
            self.topics[topic] = AwaitedTopic(self.topics[topic].after, is_gone=True)

    def resume(self, topic: str) -> None:
        """Await answers again: there is a publisher."""
        self.topics[topic].is_gone = False

    def note_message(
        self, after: str, state: JoinedState, now_ns: int
    ) -> list[tuple[str, tuple[bytes, str]]]:
        """Await the answers to a message; a second message at a control step has no answer.

        Args:
            after: Topic of the message.
            state: The present control step.
            now_ns: Wall time.

        Returns:
            Answers that have come already, with their topics.
        """
        found = []
        for topic, awaited in self.topics.items():
            if awaited.after != after or awaited.pending is not None or awaited.is_gone:
                continue
            if awaited.early is not None and awaited.early_step == (state.epoch, state.step):
                found.append((topic, awaited.early))
                awaited.early = None
            elif self.lockstep.record_sent(CLIENT_PREFIX + topic, state, now_ns):
                awaited.pending = state
        return found

    def take_answer(self, topic: str, answer: tuple[bytes, str], step: tuple[int, int]) -> bool:
        """Take a message of an awaited topic; return whether it counts.

        Args:
            topic: Its name.
            answer: Payload and encoding.
            step: Epoch and step at present.
        """
        awaited = self.topics[topic]
        awaited.is_gone = False
        if awaited.pending is not None or awaited.is_late:
            last = awaited.pending or JoinedState(*step)
            self.lockstep.record_answer(CLIENT_PREFIX + topic, last)
            awaited.pending, awaited.is_late = None, False
            return True
        if awaited.early is None or awaited.early_step != step:
            awaited.early, awaited.early_step = answer, step
        return False

    def note_late(self) -> Iterable[str]:
        """List the topics whose answers are awaited no longer, although none came."""
        waited = set(self.lockstep.awaited)
        for topic, awaited in self.topics.items():
            if awaited.pending is not None and CLIENT_PREFIX + topic not in waited:
                awaited.pending, awaited.is_late = None, True
                yield topic
