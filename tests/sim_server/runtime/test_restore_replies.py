"""RestoreReplies: the state of a server that restores, and requests that wait for its end."""

from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.messages.simulation_messages import GetSimulationStateRequest, State
from zensim.proto.messages.telemetry_messages import InfoRequest
from zensim.proto.service_catalog import GET_ENTITIES, GET_SIMULATION_STATE, INFO
from zensim.recording.recorder import RecorderSettings
from zensim.recording.recording_session import make_start
from zensim.sim_server.journal.restore_progress import RestoreProgress
from zensim.sim_server.runtime.restore_replies import MAX_HELD_BYTES, RestoreReplies
from zensim.spawner.client.service_client import ServiceClient

if TYPE_CHECKING:
    from zensim.proto.network_protocols import ServerNetwork


def some_replies(bus: MemoryBus, progress: RestoreProgress | None = None) -> RestoreReplies:
    network = cast("ServerNetwork", bus)
    replies = RestoreReplies(network, "w", progress or RestoreProgress(), is_secured=False)
    bus.pumps.append(replies.poll)
    return replies


def test_info_has_the_progress_of_a_restore() -> None:
    bus, progress = MemoryBus(), RestoreProgress(total=20, done=7)
    some_replies(bus, progress)

    info = bus.call(INFO, InfoRequest(), world="w")

    assert (info.state, info.restored, info.to_restore) == ("restoring", 7, 20)


def test_simulation_is_loading_during_a_restore() -> None:
    bus = MemoryBus()
    some_replies(bus)

    response = bus.call(GET_SIMULATION_STATE, GetSimulationStateRequest(), world="w")

    assert response.state.state == State.LOADING_WORLD


def test_other_requests_wait_for_the_end_of_a_restore() -> None:
    bus = MemoryBus()
    replies = some_replies(bus)
    bus.pumps.clear()
    bus.ask(f"sim/w/{GET_ENTITIES.name}", b"", b"one")
    replies.poll()
    bus.ask(f"sim/w/{GET_ENTITIES.name}", b"", b"two")

    replies.close()
    taken = replies.take()
    bus.ask("sim/w/info", b"", b"three")

    assert [call.request_id for call in taken] == [b"one", b"two"]
    assert [call.request_id for call in replies.take()] == [b"three"]


def test_requests_beyond_the_bytes_that_may_wait_are_dropped() -> None:
    bus = MemoryBus()
    replies = some_replies(bus)
    bus.pumps.clear()
    large = bytes(MAX_HELD_BYTES // 2)
    for number in range(3):
        bus.ask(f"sim/w/{GET_ENTITIES.name}", large, str(number).encode())
    replies.poll()

    assert [call.request_id for call in replies.take()] == [b"0", b"1"]


def test_steps_to_a_time_are_not_counted_during_a_restore() -> None:
    bus = MemoryBus()
    some_replies(bus)

    with pytest.raises(TimeoutError):
        ServiceClient(bus, "w").steps_until(2_000_000_000)


def test_no_recording_begins_during_a_restore() -> None:
    bus = MemoryBus()
    some_replies(bus)

    with pytest.raises(NoServer):
        make_start(bus, RecorderSettings(world="w", domain=None))


def test_closing_twice_is_harmless() -> None:
    replies = some_replies(MemoryBus())
    replies.start()

    replies.close()
    replies.close()

    assert replies.take() == []
