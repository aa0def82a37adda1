"""Order of messages by time, topic and content."""

import random

from tests.recording.recordings import make_topic
from zensim.proto.messages.standard_messages import Odometry
from zensim.recording.message_order import HOLD_NS, MessageOrder

TOPICS = [make_topic(f"r{number}/odom", Odometry) for number in range(3)]
MILLISECOND = 1_000_000


def test_messages_that_arrive_in_another_order_come_out_in_one() -> None:
    messages = [
        (topic, step * 20 * MILLISECOND, 0, bytes([step % 256]))
        for step in range(500)
        for topic in TOPICS
    ]
    outcomes = []
    for seed in range(3):
        chance = random.Random(seed)
        arrived = sorted(messages, key=lambda one: one[1] + chance.uniform(0.0, 0.5 * HOLD_NS))
        order = MessageOrder()
        found = [one for message in arrived for one in order.add([message])]
        assert len(found) > len(messages) / 2
        outcomes.append(found + order.release())

    assert outcomes == [messages, messages, messages]


def test_messages_after_a_release_begin_anew() -> None:
    order = MessageOrder()
    order.add([(TOPICS[0], 100 * HOLD_NS, 0, b"")])
    order.release()

    assert order.add([(TOPICS[0], 0, 0, b"")]) == []
    assert len(order.release()) == 1
