"""Spawns whose client has given up: the same request again is their retry."""

import signal

import pytest

from tests.integration.processes import START_S, serving
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.service_catalog import SPAWN_ENTITY

GIVES_UP_S = 0.3


@pytest.mark.parametrize("name", ["r1", ""], ids=["named", "without a name"])
def test_spawn_that_got_no_reply_in_time_succeeds_when_it_is_repeated(name: str) -> None:
    with serving() as server:
        order = SpawnEntityOrder(
            name=name, allow_renaming=not name, entity_resource=Resource("box_bot")
        )
        server.process.send_signal(signal.SIGSTOP)
        try:
            with pytest.raises(TimeoutError):
                server.bus.call(SPAWN_ENTITY, order, world="default", timeout_s=GIVES_UP_S)
        finally:
            server.process.send_signal(signal.SIGCONT)

        report = server.bus.call(SPAWN_ENTITY, order, world="default", timeout_s=START_S)

        assert server.client.entities() == (report.entity_name,)
        if name:
            with pytest.raises(ServiceError) as refused:
                server.bus.call(SPAWN_ENTITY, order, world="default", timeout_s=START_S)
            assert refused.value.code_name == "NAME_NOT_UNIQUE"
