"""When the models of a world are requested, and what is kept without a reply."""

from typing import Final

import pytest

from tests.fakes import ManualClock, MemoryBus
from tests.spawner.page.builders import FakeServer, make_models, make_robot
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.telemetry_messages import (
    Event,
    EventKind,
    GetModelsRequest,
    GetModelsResponse,
)
from zensim.proto.topic_catalog import EVENTS
from zensim.spawner.client.world_follower import (
    AGENT_EVENTS,
    ENTITY_EVENTS,
    PERIOD_S,
    SETTLE_S,
    SHARE,
    WorldFollower,
)

WORLD: Final = "default"


class Followed:
    """A follower, and the server of its world."""

    def __init__(self, *, period_s: float = PERIOD_S, is_of_entities: bool = False) -> None:
        self.bus, self.clock = MemoryBus(), ManualClock()
        self.server = FakeServer(self.bus, make_models(r1=make_robot("r1")))
        self.token = self.bus.token(keys.alive_server(WORLD))
        kinds = ENTITY_EVENTS if is_of_entities else AGENT_EVENTS
        self.follower = WorldFollower(
            self.bus, WORLD, kinds=kinds, period_s=period_s, clock=self.clock
        )

    @property
    def calls(self) -> int:
        return self.server.count(GetModelsRequest)

    def publish(self, kind: EventKind) -> None:
        self.bus.put_message(EVENTS.key(WORLD), Event(kind, "r1"), Format.MSGPACK)

    def poll(self, *, after_s: float = 0.0) -> bool:
        self.clock.sleep(after_s)
        self.follower.take()
        return self.follower.poll()


def test_models_are_requested_at_first_and_then_not() -> None:
    followed = Followed()

    assert followed.poll()
    assert not followed.poll(after_s=100.0)
    assert followed.follower.models == followed.server.models


@pytest.mark.parametrize("kind", sorted(AGENT_EVENTS))
def test_an_event_makes_them_due_once_a_group_has_come(kind: EventKind) -> None:
    followed = Followed()
    followed.poll()
    followed.clock.sleep(PERIOD_S)

    followed.publish(kind)
    too_early = followed.poll()
    followed.publish(kind)

    assert not too_early
    assert followed.poll(after_s=SETTLE_S)
    assert followed.calls == 2


def test_events_of_agents_can_be_ignored() -> None:
    followed = Followed(is_of_entities=True)
    followed.poll()

    followed.publish("claimed")

    assert not followed.poll(after_s=PERIOD_S)
    followed.publish("spawned")
    followed.poll()
    assert followed.poll(after_s=SETTLE_S)


def test_another_roster_makes_them_due() -> None:
    followed = Followed()
    followed.poll()
    roster = followed.server.models.roster

    followed.follower.note_roster(roster)
    same = followed.poll(after_s=PERIOD_S)
    followed.follower.note_roster(roster + 1)

    assert not same
    assert followed.poll()


@pytest.mark.parametrize("period_s", [PERIOD_S, 0.0])
def test_least_time_between_two_calls_holds_if_there_is_one(period_s: float) -> None:
    followed = Followed(period_s=period_s)
    followed.poll()

    followed.follower.note_roster(7)

    assert followed.poll(after_s=PERIOD_S / 2.0) == (period_s == 0.0)


def test_calls_that_take_long_are_made_less_often() -> None:
    followed, wait_s = Followed(), 2.0
    followed.bus.pumps.insert(0, lambda: followed.clock.sleep(wait_s))
    followed.poll()
    passed_s = followed.clock()

    followed.follower.note_roster(7)
    while not followed.poll():
        followed.clock.sleep(0.1)

    assert followed.clock() - passed_s >= wait_s / SHARE - 0.1


def test_models_of_another_server_are_requested_at_once() -> None:
    followed = Followed()
    followed.poll()
    followed.token.close()
    gone = followed.follower.take().servers
    followed.bus.token(keys.alive_server(WORLD))

    came = followed.follower.take().servers

    assert (gone, came) == ((False,), (True,))
    assert followed.follower.models is not None
    assert not followed.follower.is_current
    assert followed.follower.poll()
    assert followed.follower.is_current


def test_a_refusal_leaves_the_models_and_is_tried_again() -> None:
    followed = Followed()
    followed.poll()
    models = followed.follower.models
    refusal = Result(ResultCode.OPERATION_FAILED, "refused")
    followed.server.responses["get_models"] = GetModelsResponse(refusal)
    followed.publish("spawned")
    followed.poll()

    assert not followed.poll(after_s=PERIOD_S)
    assert followed.calls == 2
    assert (followed.follower.models, "refused" in followed.follower.problem) == (models, True)
    del followed.server.responses["get_models"]
    assert followed.poll(after_s=PERIOD_S)
    assert followed.follower.problem == ""


def test_a_call_that_another_thread_makes_is_taken_once() -> None:
    followed = Followed()

    fetch = followed.follower.take_fetch()
    second = followed.follower.take_fetch()

    assert fetch is not None
    assert second is None
    assert fetch() == followed.server.models
    assert followed.follower.models is None


def test_events_are_handed_over_and_malformed_ones_left_out() -> None:
    followed = Followed()

    followed.bus.put(EVENTS.key(WORLD), b"\xff")
    followed.publish("paused")

    assert [one.kind for one in followed.follower.take().events] == ["paused"]


def test_closed_follower_has_no_subscription() -> None:
    followed = Followed()

    followed.follower.close()

    assert not followed.bus.has_subscriber(EVENTS.key(WORLD))
