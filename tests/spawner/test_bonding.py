"""Bonds: patience with a server that has not seen the token, and an end in any case."""

from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus
from zensim.proto.bus import NoServer
from zensim.proto.messages.entity_messages import EntityFilters, EntityState
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.spawn_messages import SpawnEntityOrder, SpawnEntityReport
from zensim.spawner import bonding
from zensim.spawner.bonding import bond_name, spawn_bonded, stay_with, wait_for_entity
from zensim.spawner.client import SimClient

if TYPE_CHECKING:
    from zensim.proto.bus import Bus


def refusal(code: ResultCode) -> ServiceError:
    return ServiceError("service", code, code.name, "no")


class Answers(SimClient):
    """Fails with each of these in turn, then does what it is asked."""

    def __init__(self, *failures: Exception) -> None:
        super().__init__(cast("Bus", MemoryBus()))
        self.failures = list(failures)
        self.deleted: list[str] = []

    def spawn(self, order: SpawnEntityOrder) -> SpawnEntityReport:
        self._fail()
        return SpawnEntityReport(entity_name=order.name)

    def entity_state(self, entity: str, reference_frame: str = "") -> EntityState:
        del entity, reference_frame
        self._fail()
        return EntityState()

    def entities(self, filters: EntityFilters | None = None) -> tuple[str, ...]:
        del filters
        return ("r1",)

    def delete(self, entity: str) -> None:
        self._fail()
        self.deleted.append(entity)

    def _fail(self) -> None:
        if self.failures:
            raise self.failures.pop(0)


def test_bond_names_differ() -> None:
    assert bond_name() != bond_name()


def test_spawn_is_asked_for_again_until_the_token_is_seen() -> None:
    early = refusal(ResultCode.INCORRECT_STATE)

    report = spawn_bonded(Answers(early, early), SpawnEntityOrder("r1", bond="b"))

    assert report.entity_name == "r1"


@pytest.mark.parametrize(
    ("code", "bond"), [(ResultCode.INCORRECT_STATE, ""), (ResultCode.OPERATION_FAILED, "b")]
)
def test_spawn_that_is_refused_otherwise_is_not_repeated(code: ResultCode, bond: str) -> None:
    client = Answers(refusal(code))

    with pytest.raises(ServiceError):
        spawn_bonded(client, SpawnEntityOrder("r1", bond=bond))


def test_entity_is_deleted_when_it_is_over() -> None:
    client = Answers()

    assert stay_with(client, "r1", lambda: True)

    assert client.deleted == ["r1"]


def test_entity_that_had_gone_already_is_no_failure() -> None:
    assert not stay_with(Answers(refusal(ResultCode.NOT_FOUND)), "r1", lambda: True)


def test_bond_ends_when_the_entity_has_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bonding, "ASK_EVERY_S", 0.0)
    client = Answers(NoServer("away"), TimeoutError("away"), refusal(ResultCode.NOT_FOUND))

    assert not stay_with(client, "r1", lambda: False)


def test_waiting_for_an_entity_ends() -> None:
    wait_for_entity(Answers(), "r1", 0.0)

    with pytest.raises(TimeoutError, match=r"entity 'r9' did not come within 0\.1 s"):
        wait_for_entity(Answers(), "r9", 0.1)
