"""Who may call which service, and on which entities."""

from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest

from zensim.proto.messages.agent_messages import ClaimEntityRequest, ClaimShareRequest
from zensim.proto.messages.entity_messages import SetEntityInfoRequest
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, SpawnEntityReport
from zensim.proto.messages.telemetry_messages import AuditRecord, Info
from zensim.proto.network_protocols import ServiceCall
from zensim.proto.security.roles import READING, ROLES, ROS_USER, User
from zensim.proto.service_catalog import SERVICES
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.runtime.audit_trail import AuditTrail
from zensim.sim_server.runtime.request_authorization import AccessDenied, RequestAuthorization
from zensim.sim_server.security.user_sessions import SessionChange

USERS = {role: User(role, role, ("r1",) if ROLES[role].has_robots else ()) for role in ROLES}


class Directory:
    def find_user(self, name: str) -> User | None:
        return USERS.get(name)

    def find_address(self, session: str, user: str) -> str | None:
        return f"tls/{session}:1" if user else None

    def take_changes(self) -> list[SessionChange]:
        return []

    def keep(self, record: AuditRecord) -> None:
        pass


class World:
    def __init__(self) -> None:
        self.by_name: dict[str, Any] = {}

    def add(self, name: str, born_ns: int = 0, namespace: str = "") -> None:
        self.by_name[name] = SimpleNamespace(name=name, born_ns=born_ns, namespace=namespace)


def an_authorization(world: World | None = None) -> RequestAuthorization:
    users = Directory()
    audit = AuditTrail(users, LoopStats(0), lambda: 0)
    return RequestAuthorization(users, world or World(), audit)


def a_call(user: str, service: str) -> ServiceCall:
    return cast("ServiceCall", SimpleNamespace(user=user, name=service, session=""))


def is_refused(
    authorization: RequestAuthorization, user: str, service: str, request: msgspec.Struct
) -> bool:
    try:
        authorization.check(a_call(user, service), request)
    except AccessDenied:
        return True
    return False


@pytest.mark.parametrize("service", SERVICES)
@pytest.mark.parametrize("role", ROLES)
def test_role_calls_its_services_only(role: str, service: str) -> None:
    request = ClaimEntityRequest(role) if service == "claim_entity" else SERVICES[service].request()
    if service == "claim_share":
        request = ClaimShareRequest("pool")
    is_allowed = service in ROLES[role].services and (role, service) != ("agent", "claim_share")

    assert is_refused(an_authorization(), role, service, request) != (
        is_allowed or service == "info"
    )


@pytest.mark.parametrize("user", ["", "nobody", "server", "router"])
def test_unknown_user_may_ask_for_info_only(user: str) -> None:
    authorization = an_authorization()

    assert is_refused(authorization, user, "get_entities", SERVICES["get_entities"].request())
    assert not is_refused(authorization, user, "info", SERVICES["info"].request())


@pytest.mark.parametrize("role", ROLES)
def test_info_has_the_role_of_its_caller(role: str) -> None:
    found = an_authorization().add_role(a_call(role, "info"), Info(version="1"))

    assert found == Info(version="1", role=role)


def test_info_has_no_role_for_an_unknown_user() -> None:
    found = an_authorization().add_role(a_call("nobody", "info"), Info())

    assert found == Info()


def test_ros_calls_have_the_role_of_ros() -> None:
    authorization = an_authorization()

    quitting = SERVICES["set_simulation_state"].request()
    assert is_refused(authorization, ROS_USER, "set_simulation_state", quitting)
    assert not is_refused(authorization, ROS_USER, "get_entities", quitting)


def test_user_gets_no_role_by_its_name() -> None:
    authorization = an_authorization()
    named_as_roles = {"ros": User("ros", "observer"), "operator": User("operator", "page")}

    authorization.users = SimpleNamespace(find_user=named_as_roles.get)

    for user in named_as_roles:
        assert is_refused(authorization, user, "spawn_entity", SERVICES["spawn_entity"].request())


@pytest.mark.parametrize(
    ("user", "request_", "refused"),
    [
        ("agent", ClaimEntityRequest("agent", ("r1",)), False),
        ("agent", ClaimEntityRequest("agent", ("r2",)), True),
        ("agent", ClaimEntityRequest("agent", ("r1", "r2")), True),
        ("agent", ClaimEntityRequest("pool", ("r1",)), True),
        ("agent", ClaimEntityRequest("agent", ("elsewhere",)), True),
        ("agent", ClaimShareRequest("agent"), True),
        ("pool", ClaimEntityRequest("pool", ("r2",)), False),
        ("pool", ClaimShareRequest("pool"), False),
        ("pool", ClaimShareRequest("agent"), True),
        ("operator", ClaimEntityRequest("operator", ("r1",)), True),
    ],
)
def test_claim_is_for_the_user_and_its_robots(
    user: str, request_: msgspec.Struct, *, refused: bool
) -> None:
    world = World()
    world.add("r1", namespace="r1")
    world.add("r2", namespace="r2")
    service = "claim_entity" if isinstance(request_, ClaimEntityRequest) else "claim_share"

    assert is_refused(an_authorization(world), user, service, request_) is refused


def test_robot_in_a_foreign_namespace_cannot_be_claimed() -> None:
    world = World()
    world.add("r1", namespace="r2")

    claim = ClaimEntityRequest("agent", ("r1",))
    assert is_refused(an_authorization(world), "agent", "claim_entity", claim)


def test_spawner_changes_only_what_it_spawned() -> None:
    world = World()
    authorization = an_authorization(world)
    for user, name in (("spawner", "mine"), ("operator", "theirs")):
        world.add(name, born_ns=1)
        report = SpawnEntityReport(Result(), name)
        authorization.note_response(a_call(user, "spawn_entity"), report)
    world.add("loaded")

    def refused(user: str, name: str) -> tuple[bool, bool]:
        return (
            is_refused(authorization, user, "delete_entity", DeleteEntityRequest(name)),
            is_refused(authorization, user, "set_entity_info", SetEntityInfoRequest(name)),
        )

    assert refused("spawner", "mine") == (False, False)
    assert refused("spawner", "theirs") == refused("spawner", "loaded") == (True, True)
    assert refused("operator", "mine") == (False, False)
    assert refused("spawner", "gone") == (False, False)
    world.add("mine", born_ns=2)
    assert refused("spawner", "mine") == (True, True)


def test_refused_spawn_gives_no_ownership() -> None:
    world = World()
    world.add("theirs")
    authorization = an_authorization(world)
    report = SpawnEntityReport(Result(ResultCode.OPERATION_FAILED), "theirs")

    authorization.note_response(a_call("spawner", "spawn_entity"), report)

    assert is_refused(authorization, "spawner", "delete_entity", DeleteEntityRequest("theirs"))


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("service", sorted(set(SERVICES) - {"info"}))
def test_audit_has_each_refusal_and_each_change(role: str, service: str) -> None:
    authorization = an_authorization()
    request = SERVICES[service].request()
    is_allowed = not is_refused(authorization, role, service, request)

    records = authorization.audit.take()

    action = ("accepted",) if service not in READING else ()
    assert [one.action for one in records] == [*(action if is_allowed else ("refused",))]
    assert all((one.user, one.role, one.service) == (role, role, service) for one in records)
