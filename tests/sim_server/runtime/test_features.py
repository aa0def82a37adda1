"""Every announced feature works, and every working feature is announced."""

from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus
from tests.feature_checks import FEATURE_CHECKS
from tests.sim_server.fakes import WallTime, a_world, make_parts
from zensim.proto.messages.simulation_messages import Feature
from zensim.proto.service_catalog import SERVICES
from zensim.sim_server.runtime.loop import ServerLoop
from zensim.sim_server.runtime.loop_channels import BusInbox, BusWorldPublisher
from zensim.sim_server.services.service_registry import FEATURES, SERVICE_TABLE
from zensim.spawner.client.sim_client import SimClient

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import Bus


def a_client() -> SimClient:
    """Make a client of a server of fakes, whose loop turns while the client waits."""
    network, wall = MemoryBus(), WallTime()
    bus = cast("Bus", network)
    inbox, publisher = BusInbox(bus, "default"), BusWorldPublisher(bus, "default")
    network.pumps.append(ServerLoop(make_parts(a_world(), wall), inbox, publisher, wall).turn)
    return SimClient(bus)


def test_features_are_announced_once_and_in_order() -> None:
    assert list(FEATURES) == sorted(set(FEATURES))
    assert a_client().features().features == tuple(FEATURES)


def test_each_service_is_offered_once() -> None:
    assert sorted(one.service.name for one in SERVICE_TABLE) == sorted(SERVICES)


def test_every_feature_is_announced_and_shown() -> None:
    assert set(FEATURES) == set(FEATURE_CHECKS) == set(Feature)


@pytest.mark.parametrize("feature", FEATURES, ids=lambda feature: feature.name)
def test_announced_feature_works(feature: Feature) -> None:
    FEATURE_CHECKS[feature](a_client())
