"""Gazebo's topics: told while somebody listens, twenty times a second, and on request."""

import msgspec
import pytest

from tests.sim_server.fakes import a_server, answer_of
from zensim.proto.messages.entity_messages import GetEntitiesRequest
from zensim.proto.messages.gazebo_messages import LinkStates, ModelStates

TOPICS = [("model_states", ModelStates), ("link_states", LinkStates)]


@pytest.mark.parametrize(("topic", "kind"), TOPICS)
def test_topic_is_told_twenty_times_a_second(topic: str, kind: type[msgspec.Struct]) -> None:
    server = a_server("r0", "r1")

    server.turn_for(1.0)

    told = server.publisher.on(topic)
    assert 19 <= len(told) <= 22
    assert all(isinstance(message, kind) for message in told)


@pytest.mark.parametrize(("topic", "kind"), TOPICS)
def test_topic_is_not_made_when_nobody_listens(topic: str, kind: type[msgspec.Struct]) -> None:
    server = a_server("r0")
    server.publisher.unwanted.add(topic)

    server.turn_for(0.5)

    assert server.publisher.on(topic) == []
    assert kind.__name__ == "".join(word.capitalize() for word in topic.split("_"))


@pytest.mark.parametrize(("topic", "kind"), TOPICS)
def test_topic_answers_a_get(topic: str, kind: type[msgspec.Struct]) -> None:
    server = a_server("r0")
    call = server.ask(topic, GetEntitiesRequest())

    server.loop.turn()

    answer = answer_of(call, kind)
    assert getattr(answer, "name")[0].startswith("r0")  # noqa: B009
