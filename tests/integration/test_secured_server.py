"""A secured server: joining it, what each role is refused, errors told apart, revocation."""

import json
import os
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import urlopen

import msgspec
import numpy as np
import psutil
import pytest
import zenoh

import zensim as api
from tests.integration.page_user import PageUser
from tests.integration.processes import (
    eventually,
    free_endpoint,
    read_json_line,
    run_in_process,
    running,
)
from tests.integration.processes import zensim as run_zensim
from tests.integration.terminals import on_terminal
from tests.node_peers.foxglove_peer import connect_peer
from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError, EndpointUnreachable, JoinRefused, NoServer
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.exit_codes import ExitCode
from zensim.proto.join_tokens import parse_join_token
from zensim.proto.messages.agent_messages import ClaimEntityRequest, DriveCommand, DriveState
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.simulation_messages import (
    SetSimulationStateRequest,
    SimulationState,
    State,
)
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped, Twist, Vector3
from zensim.proto.messages.telemetry_messages import AuditRecord
from zensim.proto.security.roles import ROLES, User
from zensim.proto.service_catalog import (
    CLAIM_ENTITY,
    DELETE_ENTITY,
    SERVICES,
    SET_SIMULATION_STATE,
    SPAWN_ENTITY,
)
from zensim.proto.topic_catalog import AUDIT, CMD_VEL, DRIVE_COMMAND, DRIVE_STATE, ODOM, TF
from zensim.proto.web_access import name_cookie, split_token
from zensim.sim_server.security import certificates
from zensim.sim_server.security.secure_folder import (
    Account,
    SecureFolder,
    SecureSettings,
    prepare_secure_folder,
)
from zensim.spawner.client.sim_client import SimClient

WORLD = "default"
WITHIN_S = 20.0
ROBOTS = ("r1", "r2")
DENIED = "access.denied"
MAY_QUIT = {"operator"}


def make_order(name: str) -> SpawnEntityOrder:
    y = float(ROBOTS.index(name)) if name in ROBOTS else 3.0
    pose = PoseStamped(pose=Pose(position=Point(y=y)))
    return SpawnEntityOrder(
        name=name, entity_resource=Resource(uri="box_bot"), entity_namespace=name, initial_pose=pose
    )


@dataclass(frozen=True)
class Secured:
    folder: SecureFolder
    process_id: int
    operator: SimClient
    users: dict[str, Bus]
    journal: Path

    def token(self, user: str) -> str:
        return self.folder.make_token(self.folder.accounts()[user]).write()


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Secured]:
    with pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        settings = SecureSettings(WORLD, 0, free_endpoint("tls"))
        folder = prepare_secure_folder(settings)
        folder.ensure(User(name, "agent", (name,)) for name in ROBOTS)
        journal = tmp_path_factory.mktemp("journal")
        serve = ("serve", "--secure", "--listen", settings.endpoint, "--announce")
        process = stack.enter_context(running(*serve, "--journal", str(journal)))
        assert process.stdout is not None
        assert process.stdout.readline()
        users = {
            name: stack.enter_context(
                open_bus(BusConfig(connect=(folder.make_token(account).write(),)))
            )
            for name, account in folder.accounts().items()
        }
        operator = SimClient(users["operator"])
        for name in ROBOTS:
            operator.spawn(make_order(name))
        yield Secured(folder, process.pid, operator, users, journal)


@pytest.fixture(scope="module")
def agent(secured: Secured) -> Iterator[None]:
    """Drive r1 by an agent with a token of its own."""
    address = secured.folder.write_token(
        secured.folder.accounts()["r1"], secured.folder.settings.endpoint
    )
    with running("agent", "r1", "--join", address):
        eventually(lambda: secured.operator.entity_model("r1").agent == "r1", WITHIN_S)
        yield


def x_of(secured: Secured, robot: str) -> float:
    return secured.operator.entity_state(robot).pose.position.x


def assert_drivable(secured: Secured) -> None:
    before = x_of(secured, "r1")
    publisher = secured.users["operator"].advertise(CMD_VEL.key("r1"), CMD_VEL.encoding)

    def moves() -> bool:
        publisher.send(encode(Twist(linear=Vector3(x=0.3)), Format.CDR))
        return abs(x_of(secured, "r1") - before) > 0.02

    eventually(moves, WITHIN_S, "driving r1")
    publisher.close()


def reason_of(call: "object") -> str:
    """Call a function; return the message of its refusal."""
    assert callable(call)
    with pytest.raises(ServiceError) as caught:
        call()
    return str(caught.value)


@pytest.mark.usefixtures("agent")
def test_newcomer_needs_the_token_only(secured: Secured) -> None:
    token = secured.token("operator")

    listed = run_in_process("list", "--join", token, "--json")
    with api.connect(token=token, timeout_s=120.0) as sim:
        world = sim.info.world

    assert [one["name"] for one in json.loads(listed.stdout)] == list(ROBOTS)
    assert world == WORLD
    assert_drivable(secured)


@pytest.mark.usefixtures("agent")
@pytest.mark.parametrize(
    ("role", "may_control"),
    [pytest.param("operator", True, marks=pytest.mark.long_form), ("observer", False)],
)
def test_foxglove_has_the_rights_of_its_role(
    secured: Secured, role: str, *, may_control: bool
) -> None:
    options = ("--port", "0", "--json", "--allow-control", "--join", secured.token(role))
    with (
        running("foxglove", *options) as process,
        connect_peer(str(read_json_line(process)["foxglove"])) as peer,
    ):
        peer.wait_for_topics("/r1/odom")
        odometry = peer.subscribe("/r1/odom")
        peer.do("call", name="/pause_physics", callId=1, encoding="cdr", value={})
        called = peer.wait("serviceCallResponse" if may_control else "serviceCallFailure")
        kind = "geometry_msgs/msg/Twist"
        peer.do("advertise", topic="/r1/cmd_vel", encoding="json", schemaName=kind)
        peer.do("publish", topic="/r1/cmd_vel", value={})
        refused = [] if may_control else [peer.wait("status"), peer.wait("status")]
        peer.do("call", name="/unpause_physics", callId=2, encoding="cdr", value={})
        peer.wait("serviceCallResponse" if may_control else "serviceCallFailure")
        rest = [one for one in peer.drain() if one["event"] == "status"]

    assert odometry["topic"] == "/r1/odom"
    assert called["callId"] == 1
    assert rest == []
    assert all("observer" in one["message"] or "advertised" in one["message"] for one in refused)


@pytest.mark.parametrize("role", ["operator", "observer", "spawner"])
def test_python_client_reads_its_role(secured: Secured, role: str) -> None:
    with api.connect(token=secured.token(role), timeout_s=120.0) as sim:
        found = sim.role

    assert found == role


def test_python_client_is_denied_what_the_router_drops_without_a_reply(secured: Secured) -> None:
    refusals = []
    with api.connect(token=secured.token("observer"), timeout_s=120.0) as sim:
        robot = sim.robots["r1"]
        for call in (
            lambda: robot.drive(0.1),
            lambda: robot.topic("cmd_vel").put(Twist()),
            lambda: sim.run_for(0.1) if sim.is_paused else sim.step(),
            sim.pause,
            lambda: sim.spawn("box_bot", x=9.0),
            lambda: sim.spawn("box_bot", x=9.0, bond=True),
        ):
            with pytest.raises(api.Denied) as denied:
                call()
            refusals.append(denied.value.slug)

    assert set(refusals) == {DENIED}


@pytest.mark.parametrize(
    ("role", "command", "denied"),
    [
        ("observer", "drive r1 0.3 0 --duration 1", "publish on r1/cmd_vel"),
        ("observer", "topic pub --once r1/cmd_vel {}", "publish on r1/cmd_vel"),
        ("observer", "sensors run", "declare the token sim/default/alive/sensors/observer"),
        ("observer", "vda5050 --broker mqtt://127.0.0.1:1", "publish on sim/default/twists"),
        ("spawner", "echo r1/odom --timeout 1", "subscribe to r1/odom"),
        ("spawner", "topic hz */odom --duration 1", "subscribe to */odom"),
        ("spawner", "record --all --duration 1", "subscribe to **"),
        ("pool", "echo r1/odom --timeout 1", "subscribe to r1/odom"),
        ("pool", "record --all --duration 1", "query sim/default/clock"),
    ],
)
def test_command_says_what_the_router_drops_without_a_reply(
    secured: Secured,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    role: str,
    command: str,
    denied: str,
) -> None:
    monkeypatch.setenv("ZENSIM_TOKEN", secured.token(role))
    output = ("--output", str(tmp_path / "bag")) if command.startswith("record") else ()

    result = run_zensim(*command.split(), *output)

    assert result.returncode == ExitCode.FAILED, result.stderr
    assert f"{DENIED}: role '{role}' of user '{role}' may not {denied}" in result.stderr
    assert "use a token of role " in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_agent_is_told_that_its_role_cannot_use_the_api(secured: Secured) -> None:
    with pytest.raises(api.Denied):
        api.connect(token=secured.token("r1"))


def test_operator_steps_from_python(secured: Secured) -> None:
    with api.connect(token=secured.token("operator"), timeout_s=120.0) as sim:
        before_s = sim.time
        sim.run_for(0.1)

        assert sim.time - before_s >= 0.1 - 1e-9


@pytest.mark.parametrize("role", ROLES)
def test_role_is_refused_the_services_of_others(secured: Secured, role: str) -> None:
    user = "r1" if ROLES[role].has_robots else role
    denied = set(SERVICES) - ROLES[role].services

    for name in denied:
        service = SERVICES[name]
        call = lambda service=service: secured.users[user].call(  # noqa: E731
            service, service.request(), world=WORLD
        )
        assert DENIED in reason_of(call), name


@pytest.mark.parametrize("user", [*sorted(set(ROLES) - MAY_QUIT - {"agent"}), "r1"])
def test_only_an_operator_ends_the_server(secured: Secured, user: str) -> None:
    request = SetSimulationStateRequest(SimulationState(State.QUITTING))

    for key_user in ("", "operator", "server", "*"):
        key = keys.service(WORLD, SET_SIMULATION_STATE.name, key_user)
        payload = encode(request, Format.MSGPACK)
        assert secured.users[user].get(key, timeout_s=0.5, payload=payload) == []
    call = lambda: secured.users[user].call(  # noqa: E731
        SET_SIMULATION_STATE, request, world=WORLD
    )
    assert DENIED in reason_of(call)
    assert secured.operator.info().world == WORLD


@pytest.mark.usefixtures("agent")
def test_agent_cannot_act_for_another(secured: Secured) -> None:
    mine, x = secured.users["r2"], x_of(secured, "r2")
    forged = mine.advertise(DRIVE_COMMAND.key(WORLD, "r1"), DRIVE_COMMAND.encoding)
    odometry = mine.advertise(ODOM.key("r1"), ODOM.encoding)
    tf = mine.advertise(TF.key("r1"), TF.encoding)
    wild = mine.advertise("*/cmd_vel", CMD_VEL.encoding)
    alive = [mine.token(keys.alive_agent(WORLD, "r1")), mine.token(keys.alive_server(WORLD))]
    # A session asks its own queryables, too: this one is of another user.
    rogue = secured.users["pool"].serve(f"sim/{WORLD}/u/*/*", is_complete=False)
    watched = [
        secured.users["observer"].subscribe(topic.key("r1"), depth=1000) for topic in (ODOM, TF)
    ]
    commanded = secured.operator.info().world

    for claim in (("r1", ("r2",)), ("r2", ("r1",)), ("r2", ROBOTS)):
        request = ClaimEntityRequest(*claim)
        call = lambda request=request: mine.call(CLAIM_ENTITY, request, world=WORLD)  # noqa: E731
        assert DENIED in reason_of(call)
    delete = DeleteEntityRequest("r1")
    assert DENIED in reason_of(lambda: mine.call(DELETE_ENTITY, delete, world=WORLD))
    stop = DriveCommand(1, 10**9, np.arange(1, 9, dtype="<u4").tobytes(), bytes(8 * 16))
    for _ in range(50):
        forged.send(encode(stop, Format.MSGPACK))
        odometry.send(b"forged")
        tf.send(b"forged")
        wild.send(encode(Twist(linear=Vector3(x=1.0)), Format.CDR))
    assert commanded == WORLD

    assert_drivable(secured)
    assert x_of(secured, "r2") == pytest.approx(x, abs=1e-3)
    assert rogue.take() == []
    received = [sample.payload for one in watched for sample in one.take()]
    assert received
    assert b"forged" not in received
    for publisher in (forged, odometry, tf, wild):
        publisher.close()
    for token in alive:
        token.close()
    rogue.close()
    for subscription in watched:
        subscription.close()


@pytest.mark.usefixtures("agent")
@pytest.mark.parametrize("user", [*sorted(set(ROLES) - {"agent", "operator"}), "r2"])
def test_no_role_stands_for_the_server_or_an_agent(secured: Secured, user: str) -> None:
    mine, server = secured.users[user], keys.alive_server(WORLD)
    forged = [
        mine.advertise(topic.key(WORLD, "r1"), topic.encoding)
        for topic in (DRIVE_STATE, DRIVE_COMMAND)
    ]
    tokens = [mine.token(keys.alive_agent(WORLD, "r1")), mine.token(server)]
    rogues = [mine.serve(key, is_complete=False) for key in (f"sim/{WORLD}/u/**", f"sim/{WORLD}/*")]
    # Another state: with a later epoch, an agent would take its server for restarted.
    state = DriveState(9, 10**9, 10**18, b"", b"", b"", b"")
    for _ in range(50):
        for publisher, payload in zip(
            forged, (state, DriveCommand(9, 10**9, b"", b"")), strict=True
        ):
            publisher.send(encode(payload, Format.MSGPACK))
    assert secured.operator.info().world == WORLD

    assert_drivable(secured)
    assert [query for rogue in rogues for query in rogue.take()] == []
    assert secured.operator.bus.list_tokens(server) == [server]
    for publisher in forged:
        publisher.close()
    for token in tokens:
        token.close()
    for rogue in rogues:
        rogue.close()


def test_request_id_of_another_user_gets_no_reply_of_it(secured: Secured) -> None:
    spawner, operator = secured.users["spawner"], secured.users["operator"]
    order = msgspec.structs.replace(make_order("twin"), allow_renaming=True, entity_namespace="")

    names = [
        bus.call(SPAWN_ENTITY, order, world=WORLD, request_id="same").entity_name
        for bus in (spawner, operator, spawner)
    ]

    assert names[0] == names[2] != names[1]
    delete = DeleteEntityRequest(names[1])
    assert DENIED in reason_of(lambda: spawner.call(DELETE_ENTITY, delete, world=WORLD))
    spawner.call(DELETE_ENTITY, DeleteEntityRequest(names[0]), world=WORLD)
    operator.call(DELETE_ENTITY, delete, world=WORLD)


def read_audit(secured: Secured) -> list[dict[str, object]]:
    lines = (secured.folder.path / "audit.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines]


def test_refusal_is_published_kept_and_counted(secured: Secured) -> None:
    audit = secured.users["observer"].subscribe(AUDIT.key(WORLD), depth=100)
    before = secured.operator.stats()

    def refusals() -> list[AuditRecord]:
        reason_of(lambda: SimClient(secured.users["recorder"]).delete("r1"))
        taken = [decode(AuditRecord, one.payload, one.encoding) for one in audit.take()]
        # Those of other users may be from before.
        return [one for one in taken if one.user == "recorder" and one.subject]

    found = eventually(lambda: refusals() or None, WITHIN_S, "the audit")
    audit.close()

    assert {(one.action, one.role, one.service, one.subject) for one in found} == {
        ("refused", "recorder", "delete_entity", "entity=r1")
    }
    assert all(one.address.startswith("tls/127.0.0.1:") for one in found)
    assert secured.operator.stats().refused > before.refused
    eventually(lambda: "recorder" in list_refused(secured), WITHIN_S, "the file")


def list_refused(secured: Secured) -> set[object]:
    return {one["user"] for one in read_audit(secured) if one["action"] == "refused"}


def test_join_with_a_wrong_password_is_in_the_audit(secured: Secured) -> None:
    token = parse_join_token(secured.token("operator"))
    before = secured.operator.stats()

    assert find_reason(msgspec.structs.replace(token, password=bytes(16)).write()) == "user"

    def refusals() -> list[dict[str, object]]:
        return [one for one in read_audit(secured) if one["reason"] == "wrong password"]

    found = eventually(lambda: refusals() or None, WITHIN_S, "the refusal")
    assert str(found[0]["address"]).startswith("tls/127.0.0.1")
    assert secured.operator.stats().refused > before.refused


@pytest.mark.parametrize(
    ("role", "acts"), [pytest.param("page", False, marks=pytest.mark.long_form), ("operator", True)]
)
def test_page_has_the_controls_that_its_role_may_use(
    secured: Secured, role: str, *, acts: bool
) -> None:
    view = ("view", "--connect", secured.token(role), "--world-name", WORLD, "--port", "0")
    with running(*view, "--json") as process:
        url, token = split_token(str(read_json_line(process)["viewer"]))
        cookie = f"{name_cookie(urlsplit(url).port or 0)}={token}"
        with PageUser(url, cookie=cookie) as user:
            user.control("Run to this time" if acts else "Collision shapes")  # of the last tab

            assert ({"Spawn", "Stop all"} <= user.list_labels()) == acts


@pytest.mark.parametrize("program", ["view", "foxglove"])
def test_page_of_a_join_token_needs_a_token_of_its_own(secured: Secured, program: str) -> None:
    options = ("--join", secured.token("operator"), "--port", "0", "--json")
    with running(program, *options) as process:
        (url,) = read_json_line(process).values()
        bare, token = split_token(str(url))
        with pytest.raises(HTTPError) as refused:
            urlopen(bare.replace("ws://", "http://"), timeout=WITHIN_S)
        refused.value.close()

    assert token
    assert refused.value.code == 401


def test_audit_has_joins_and_changes_of_each_user(secured: Secured) -> None:
    spawner = SimClient(secured.users["spawner"])
    before = secured.operator.stats()

    spawner.spawn(msgspec.structs.replace(make_order("audited"), entity_namespace=""))
    spawner.delete("audited")
    former = eventually(lambda: list_addresses(secured, "joined", "page") or None, WITHIN_S)
    page = open_bus(BusConfig(connect=(secured.token("page"),)))
    page.close()
    page.close()

    def find_changes() -> set[tuple[object, ...]]:
        return {
            (one["action"], one["service"], str(one["subject"]).partition(" ")[0])
            for one in read_audit(secured)
            if (one["user"], one["role"]) == ("spawner", "spawner") and one["address"]
        }

    wanted = {
        ("accepted", "spawn_entity", "name=audited"),
        ("accepted", "delete_entity", "entity=audited"),
    }
    eventually(lambda: find_changes() >= wanted, WITHIN_S, "the changes")
    new = eventually(
        lambda: (list_addresses(secured, "joined", "page") - former) or None, WITHIN_S, "the join"
    )
    assert str(next(iter(new))).startswith("tls/127.0.0.1:")
    eventually(lambda: new <= list_addresses(secured, "left", "page"), WITHIN_S, "the end")
    after = secured.operator.stats()
    assert (after.accepted >= before.accepted + 2, after.joined > 0) == (True, True)


def list_addresses(secured: Secured, action: str, user: str) -> set[object]:
    found = [one for one in read_audit(secured) if (one["action"], one["user"]) == (action, user)]
    return {one["address"] for one in found}


def test_joins_of_all_users_are_in_the_audit(secured: Secured) -> None:
    def joined() -> set[object]:
        return {one["user"] for one in read_audit(secured) if one["action"] == "joined"}

    eventually(lambda: joined() >= set(secured.users), WITHIN_S, "the joins")


def test_new_token_admits_at_once(secured: Secured) -> None:
    made = run_in_process("token", "create", "--role", "observer", "--name", "newcomer")
    listed = run_in_process("list", "--join", made.stdout.strip(), "--json")

    assert (listed.returncode, listed.stderr) == (0, "")
    assert run_in_process("token", "revoke", "newcomer").returncode == 0
    assert find_reason(made.stdout.strip()) == "revoked"
    eventually(lambda: is_answered(secured), WITHIN_S, "the operator's session")


def test_joined_endpoint_needs_no_token(
    secured: Secured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    endpoint = secured.folder.settings.endpoint
    refused = run_in_process("join", secured.token("operator")[:-1])
    kept = run_in_process("join", secured.token("operator"), "--json")
    file = Path(json.loads(kept.stdout)["file"])

    assert refused.returncode != 0
    assert run_in_process("list", "--connect", endpoint).returncode == 0
    with api.connect(endpoint, timeout_s=120.0) as sim:
        assert sim.info.world == WORLD
    assert (file.stat().st_mode & 0o777, file.parent.stat().st_mode & 0o777) == (0o600, 0o700)
    assert secured.token("operator") not in kept.stdout
    assert run_in_process("join", "--forget", endpoint).returncode == 0
    assert run_in_process("list", "--connect", endpoint).returncode != 0
    assert run_in_process("join", "--forget", endpoint).returncode == 2


def test_refused_service_is_told_from_an_absent_server(secured: Secured) -> None:
    refused = run_in_process("pause", "--join", secured.token("observer"))
    absent = run_in_process(
        "pause", "--join", secured.token("operator"), "--world-name", "elsewhere"
    )

    assert DENIED in refused.stderr
    assert "zensim serve" not in refused.stderr + absent.stderr
    assert refused.exit_code if hasattr(refused, "exit_code") else refused.returncode
    assert absent.returncode not in (0, refused.returncode)


def test_no_secret_is_in_a_command_line_or_a_foreign_file(secured: Secured) -> None:
    secrets = [account.password for account in secured.folder.accounts().values()]
    family = [psutil.Process(secured.process_id)]
    family += family[0].children(recursive=True)
    lines = [" ".join(one.cmdline()) for one in family]

    assert len(family) > 1
    assert not [line for line in lines if any(secret in line for secret in secrets)]
    assert all(path.stat().st_mode & 0o077 == 0 for path in secured.folder.path.iterdir())


def test_no_secret_is_printed_or_recorded(secured: Secured) -> None:
    secrets = [account.password for account in secured.folder.accounts().values()]
    token = secured.token("operator")
    wrong = token.replace(secrets[0], "A" * len(secrets[0]))
    done = [
        run_in_process("doctor", "--join", token),
        run_in_process("list", "--join", token, "--verbose"),
        run_in_process("list", "--join", token[:-2]),
        run_in_process("list", "--join", wrong),
        run_in_process("pause", "--join", secured.token("observer")),
        run_in_process("token", "list", "--json"),
    ]
    printed = "".join(one.stdout + one.stderr for one in done).encode()
    recorded = [path.read_bytes() for path in secured.journal.rglob("*") if path.is_file()]

    assert recorded
    assert not [one for one in (printed, *recorded) for secret in secrets if secret.encode() in one]


def find_reason(address: str) -> str:
    try:
        open_bus(BusConfig(connect=(address,))).close()
    except JoinRefused as error:
        return error.reason
    except EndpointUnreachable:
        return "unreachable"
    return "admitted"


def test_failures_to_join_are_told_apart(
    secured: Secured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    token = parse_join_token(secured.token("operator"))
    other = type(token)(token.endpoint, token.user, bytes(16), token.fingerprint)
    wrong_authority = type(token)(token.endpoint, token.user, token.password, bytes(32))
    nothing = type(token)(free_endpoint("tls"), token.user, token.password, token.fingerprint)
    assert find_reason(token.write()) == "admitted"
    assert find_reason(other.write()) == "user"
    assert find_reason(wrong_authority.write()) == "other_authority"
    assert find_reason(nothing.write()) == "unreachable"

    with plain_listener() as port:
        plain = type(token)(f"tls/127.0.0.1:{port}", "u", token.password, token.fingerprint)
        assert find_reason(plain.write()) == "no_tls"

    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    folder = prepare_secure_folder(SecureSettings(WORLD, None, free_endpoint("tls")))
    config = folder.make_router_config(folder.settings.endpoint)
    expire_router_certificate(folder)
    with open_bus(config):
        late = folder.make_token(folder.accounts()["operator"])
        assert find_reason(late.write()) == "expired"


def expire_router_certificate(folder: SecureFolder) -> None:
    authority = certificates.CertifiedKey(
        (folder.path / "ca.pem").read_bytes(), (folder.path / "ca.key").read_bytes()
    )
    own = certificates.make_router_certificate(authority, days=-1)
    (folder.path / "router.pem").write_bytes(own.certificate)
    (folder.path / "router.key").write_bytes(own.private_key)


class plain_listener:  # noqa: N801  used as a function
    """A listener that speaks no TLS: it answers each connection with text, and closes it."""

    def __enter__(self) -> int:
        self._socket = socket.create_server(("127.0.0.1", 0))
        self._thread = threading.Thread(target=self._answer, daemon=True)
        self._thread.start()
        return int(self._socket.getsockname()[1])

    def __exit__(self, *_: object) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self._thread.join()

    def _answer(self) -> None:
        try:
            while True:
                connection, _ = self._socket.accept()
                connection.sendall(b"220 no TLS here\r\n")
                connection.close()
        except OSError:
            return


def test_session_without_a_token_is_refused(secured: Secured) -> None:
    endpoint = secured.folder.settings.endpoint
    for address in (endpoint, endpoint.replace("tls/", "tcp/")):
        listed = run_in_process("list", "--connect", address)

        assert listed.returncode != 0
        assert "--join" in listed.stderr


def test_other_zenoh_client_joins_with_the_printed_settings(secured: Secured) -> None:
    shown = run_in_process("token", "show", "observer", "--as", "zenoh-config")
    variable = run_in_process("token", "show", "ros", "--as", "rmw").stdout.strip()
    overrides = zenoh.Config()
    for setting in variable.partition("='")[2].rstrip("'").split(";"):
        overrides.insert_json5(*setting.split("=", 1))

    for config, user in ((zenoh.Config.from_json5(shown.stdout), "observer"), (overrides, "ros")):
        with zenoh.open(config) as session:
            replies = [*session.get(keys.service(WORLD, "get_entities", user), payload=b"{}")]
            assert [reply.ok is not None for reply in replies] == [True]
    assert secured.operator.info().world == WORLD


def test_token_is_created_listed_and_expires(secured: Secured) -> None:
    made = run_in_process("token", "create", "--role", "agent", "--robot", "r9", "--ttl", "3s")
    listed = run_in_process("token", "list", "--json")
    token = made.stdout.strip()

    users = {one["user"]: one for one in json.loads(listed.stdout)}
    assert (users["r9"]["role"], users["r9"]["robots"]) == ("agent", ["r9"])
    assert not [one for one in secured.folder.accounts().values() if one.password in listed.stdout]
    assert parse_join_token(token).user == "r9"
    eventually(lambda: find_reason(token) == "revoked", WITHIN_S, "the end of the token")
    eventually(lambda: is_answered(secured), WITHIN_S, "the operator's session")


@pytest.mark.parametrize("command", ["serve", "up", "router"])
def test_exposed_listener_is_refused(command: str) -> None:
    done = run_in_process(command, "--listen", "tcp/0.0.0.0:7447")

    assert done.returncode == 2
    assert "--secure --listen tls/0.0.0.0:7447" in done.stderr


@pytest.mark.usefixtures("agent")
def test_revoked_user_is_out_and_the_others_are_back(secured: Secured) -> None:
    account: Account = secured.folder.accounts()["recorder"]
    token = secured.folder.make_token(account).write()
    pose = x_of(secured, "r2")

    revoked = run_zensim("token", "revoke", "recorder")

    assert revoked.returncode == 0, revoked.stderr
    eventually(lambda: find_reason(token) == "revoked", WITHIN_S, "the refusal")
    with pytest.raises(NoServer, match="revoked"):
        SimClient(secured.users["recorder"]).info()
    eventually(lambda: is_answered(secured), WITHIN_S, "the operator's session")
    assert x_of(secured, "r2") == pytest.approx(pose, abs=1e-3)
    eventually(lambda: secured.operator.entity_model("r1").agent == "r1", WITHIN_S, "the agent")
    assert_drivable(secured)
    assert os.environ.get("ZENSIM_TOKEN") is None


def is_answered(secured: Secured) -> bool:
    try:
        return secured.operator.info().world == WORLD
    except (BusError, TimeoutError):
        return False


def test_tokens_are_shown_once_on_a_terminal_and_to_no_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    shown: list[int] = []
    for _ in range(2):
        secured = ("serve", "--secure", "--listen", free_endpoint("tls"))
        with on_terminal(None, *secured) as terminal:
            terminal.wait_for("zensim token")
            shown.append(terminal.output.count("zs1"))
    with running("serve", "--secure", "--listen", free_endpoint("tls"), "--json") as server:
        assert server.stdout is not None
        line = server.stdout.readline()
    file = Path(json.loads(line)["tokens_file"])

    assert shown[0] > 1
    assert shown[1] == 0
    assert "zs1" not in line
    assert file.stat().st_mode & 0o777 == 0o600
    assert set(msgspec.json.decode(file.read_bytes())) >= {"operator", "observer"}
