"""Records of the audit: one an action up to a burst, then counts; addresses; sessions."""

from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import msgspec
import pytest

from zensim.proto.messages.entity_messages import SetEntityInfoRequest
from zensim.proto.messages.simulation_messages import (
    SetSimulationStateRequest,
    SimulationState,
    State,
)
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, Resource, SpawnEntityOrder
from zensim.proto.messages.telemetry_messages import AuditRecord
from zensim.proto.security.roles import User
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.runtime.audit_trail import (
    BURST,
    LOCATE_NS,
    MAX_SUBJECT,
    POLL_NS,
    REFILL_NS,
    AuditTrail,
    describe_request,
)
from zensim.sim_server.security.user_sessions import SessionChange

if TYPE_CHECKING:
    from zensim.proto.network_protocols import ServiceCall


class Users:
    def __init__(self) -> None:
        self.changes: list[SessionChange] = []
        self.addresses: dict[str, str] = {}
        self.kept: list[AuditRecord] = []

    def find_user(self, name: str) -> User | None:
        return User(name, "operator") if name else None

    def find_address(self, session: str, user: str) -> str | None:
        del user
        return self.addresses.get(session)

    def take_changes(self) -> list[SessionChange]:
        taken, self.changes = self.changes, []
        return taken

    def keep(self, record: AuditRecord) -> None:
        self.kept.append(record)


class Trail:
    def __init__(self) -> None:
        self.now_ns = 0
        self.stats = LoopStats(0)
        self.users = Users()
        self.audit = AuditTrail(self.users, self.stats, lambda: self.now_ns, lambda: 1234)

    def act(self, service: str = "delete_entity", reason: str = "", session: str = "") -> None:
        call = SimpleNamespace(user="anna", name=service, session=session)
        self.audit.note_request(
            cast("ServiceCall", call), "operator", DeleteEntityRequest("r1"), reason
        )

    def take(self, after_ns: int = POLL_NS) -> list[AuditRecord]:
        self.now_ns += after_ns
        return self.audit.take()


@pytest.fixture
def trail() -> Trail:
    return Trail()


def test_record_says_who_did_what(trail: Trail) -> None:
    trail.act()
    trail.act(reason="may not")

    accepted, refused = trail.take()

    assert accepted == AuditRecord(
        action="accepted",
        user="anna",
        role="operator",
        service="delete_entity",
        subject="entity=r1",
        time_ns=1234,
    )
    assert refused == msgspec.structs.replace(accepted, action="refused", reason="may not")
    assert trail.users.kept == [accepted, refused]
    assert (trail.stats.accepted, trail.stats.refused) == (1, 1)
    assert trail.take() == []


def test_actions_beyond_a_burst_are_counted(trail: Trail) -> None:
    for _ in range(BURST + 5):
        trail.act(reason="may not")
    trail.act()

    first = trail.take()
    soon = trail.take()
    later = trail.take(REFILL_NS)

    assert [one.count for one in first] == [1] * (BURST + 1)
    assert soon == []
    assert [(one.action, one.count) for one in later] == [("refused", 5)]
    assert trail.stats.refused == BURST + 5


def test_stream_of_actions_is_a_record_each_period(trail: Trail) -> None:
    records: list[AuditRecord] = []
    for _ in range(20):
        for _ in range(100):
            trail.act("simulate_steps")
        records += trail.take(REFILL_NS // 10)
    trail.audit.close()

    assert len(records) <= BURST + 2
    assert sum(one.count for one in trail.users.kept) == 2000 == trail.stats.accepted


def test_idle_user_has_a_burst_again(trail: Trail) -> None:
    for _ in range(2):
        for _ in range(BURST):
            trail.act()
        assert [one.count for one in trail.take(BURST * REFILL_NS)] == [1] * BURST


def test_record_waits_a_moment_for_its_address(trail: Trail) -> None:
    trail.act(session="aa")
    trail.act("set_entity_info")

    assert trail.take() == []
    trail.users.addresses["aa"] = "tls/10.0.0.1:7"
    assert [(one.service, one.address) for one in trail.take()] == [
        ("delete_entity", "tls/10.0.0.1:7"),
        ("set_entity_info", ""),
    ]
    trail.act(session="unknown")
    assert [one.address for one in trail.take(LOCATE_NS)] == [""]


def test_sessions_are_recorded_and_counted(trail: Trail) -> None:
    for user in ("anna", ""):
        trail.users.changes += [
            SessionChange(action="joined", user=user, address="tls/a:1"),
            SessionChange(action="left", user=user, address="tls/a:1"),
        ]
    trail.users.changes.append(SessionChange(action="refused", address="", reason="password"))

    assert [(one.action, one.user, one.role, one.address) for one in trail.take()] == [
        ("joined", "anna", "operator", "tls/a:1"),
        ("left", "anna", "operator", "tls/a:1"),
        ("joined", "", "", "tls/a:1"),
        ("left", "", "", "tls/a:1"),
        ("refused", "", "", ""),
    ]
    assert (trail.stats.joined, trail.stats.refused) == (2, 1)
    assert trail.users.kept[-1].reason == "password"


def test_closing_keeps_what_waits(trail: Trail) -> None:
    for _ in range(BURST + 2):
        trail.act(session="unknown")

    trail.audit.close()

    assert sum(one.count for one in trail.users.kept) == BURST + 2


def test_request_is_described_in_short() -> None:
    spawn = SpawnEntityOrder(
        name="r1", entity_resource=Resource(resource_string="<robot>" * 1000), allow_renaming=True
    )
    quit_ = SetSimulationStateRequest(SimulationState(State.QUITTING))

    assert describe_request(spawn).startswith("name=r1 allow_renaming=True resource_string=<robot>")
    assert len(describe_request(spawn)) <= MAX_SUBJECT
    assert describe_request(quit_) == f"state={State.QUITTING}"
    assert describe_request(SetEntityInfoRequest("r1")) == "entity=r1"
    assert describe_request(DeleteEntityRequest()) == ""
