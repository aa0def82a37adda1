"""Loop: the log of inputs begins and ends with its subscribers, and has requests and calls."""

from tests.sim_server.fakes import ServerFixture, a_server
from zensim.proto.messages.input_messages import Inputs
from zensim.proto.messages.simulation_messages import ResetSimulationRequest
from zensim.proto.messages.spawn_messages import DeleteEntityRequest
from zensim.proto.messages.telemetry_messages import InfoRequest
from zensim.proto.topic_catalog import INPUTS
from zensim.sim_server.input_log.input_records import AnyRecord, LogStart, StateSums, read_records
from zensim.sim_server.physics.engine_calls import Remove, Steps
from zensim.sim_server.physics.logged_engine import LoggedEngine

PERIOD_S = 0.06


def a_watched_server(*names: str) -> ServerFixture:
    server = a_server(*names)
    server.publisher.unwanted.discard(INPUTS.suffix)
    server.turn_for(PERIOD_S)
    return server


def records_of(server: ServerFixture) -> list[AnyRecord]:
    messages = [one for one in server.publisher.on("inputs") if isinstance(one, Inputs)]
    return [record for one in messages if one.records for record in read_records(one.records)]


def test_log_begins_with_a_subscriber_and_counts_all_steps() -> None:
    server = a_watched_server("r0")

    server.turn_for(1.0)

    records = records_of(server)
    start = records[0]
    assert isinstance(start, LogStart)
    assert start.origin == "bodies"
    made = sum(one.count for one in records if isinstance(one, Steps))
    last = [one for one in records if isinstance(one, StateSums)][-1]
    assert start.step + made >= last.step > 200


def test_messages_are_numbered() -> None:
    server = a_watched_server("r0")

    server.turn_for(1.0)

    messages = [one for one in server.publisher.on("inputs") if isinstance(one, Inputs)]
    assert [one.sequence for one in messages] == list(range(len(messages)))
    assert len({one.log for one in messages}) == 1
    assert 15 <= len(messages) <= 25


def test_requests_that_change_the_world_are_logged_with_their_calls() -> None:
    server = a_watched_server("r0", "r1")

    server.request("info", InfoRequest())
    server.request("delete_entity", DeleteEntityRequest("r1"))
    server.request("delete_entity", DeleteEntityRequest("nobody"))
    server.turn_for(PERIOD_S)

    messages = [one for one in server.publisher.on("inputs") if isinstance(one, Inputs)]
    requests = [request for one in messages for request in one.requests]
    assert [one.service for one in requests] == ["delete_entity", "delete_entity"]
    assert [one.message == "" for one in requests] == [True, False]
    assert sum(isinstance(one, Remove) for one in records_of(server)) == 1


def test_reset_offers_another_start() -> None:
    server = a_watched_server("r0")

    server.request("reset_simulation", ResetSimulationRequest())
    server.turn_for(2 * PERIOD_S)

    starts = [one for one in records_of(server) if isinstance(one, LogStart)]
    assert [one.epoch for one in starts] == [0, 1]


def test_layer_goes_with_the_last_subscriber() -> None:
    server = a_watched_server("r0")
    assert isinstance(server.world.engine, LoggedEngine)

    server.publisher.unwanted.add(INPUTS.suffix)
    server.turn_for(PERIOD_S)

    engine: object = server.world.engine
    assert engine is server.engine
