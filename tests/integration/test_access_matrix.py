"""What each role can do with each key, over TLS sessions with a secured router: every cell."""

import random
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial

import pytest
import zenoh

from tests.integration.processes import eventually, free_endpoint
from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.network_protocols import Closable
from zensim.proto.security.roles import ROLES, Operation, User, list_keys
from zensim.sim_server.security.router_process import secured_router
from zensim.sim_server.security.secure_folder import SecureSettings, prepare_secure_folder

WORLD, DOMAIN = "w", 0
OTHER = "other"
WITHIN_S = 20.0
LEAST_CELLS = 300
KEYS = (
    *(f"sim/{WORLD}/{name}" for name in ("stats", "clock", "events", "audit", "snapshot", "info")),
    *(f"sim/{WORLD}/{name}" for name in ("claim_entity", "set_simulation_state", "twists", "*")),
    *(f"sim/{WORLD}/u/{user}/delete_entity" for user in ("ME", OTHER, "*")),
    *(f"sim/{WORLD}/drive/{user}/command" for user in ("ME", OTHER, "*")),
    *(f"sim/{WORLD}/drive/{user}/state" for user in ("ME", OTHER, "*")),
    *(f"sim/{WORLD}/u/{user}/session/s" for user in ("ME", OTHER)),
    f"sim/{WORLD}/router/links/s/tls/a:1",
    f"sim/{WORLD}/router/refusals",
    f"sim/{WORLD}/alive/server",
    *(f"sim/{WORLD}/alive/agent/{user}" for user in ("ME", OTHER)),
    *(f"sim/{WORLD}/alive/sensors/{user}" for user in ("ME", OTHER)),
    *(f"sim/{WORLD}/sensors/{user}/reply" for user in ("ME", OTHER)),
    *(f"sim/{WORLD}/clients/c/{topic}" for topic in ("steps", "made")),
    f"sim/{WORLD}/bond/b",
    f"sim/{WORLD}/alive/clients/c",
    "sim/elsewhere/stats",
    *(f"{robot}/{topic}" for robot in ("r1", "r2", "*", "**") for topic in ("odom", "cmd_vel")),
    *("r1/scan", "r2/scan", "r1/*", "r1/**", "x/r1/odom", "tf", "tf_static", "**", "a/b"),
    *(f"{domain}/{robot}/odom/t/h" for domain in (DOMAIN, 1) for robot in ("r1", "r2", "*")),
    *(f"{DOMAIN}/{robot}/cmd_vel/t/h" for robot in ("r1", "r2")),
    f"{DOMAIN}/tf/t/h",
    f"{DOMAIN}/r1/odom/t/h/@adv/pub/z",
    f"{DOMAIN}/r1/tf_static/t/h/@adv/pub/z",
    *("rosout", f"{DOMAIN}/rosout/t/h", f"{DOMAIN}/rosout/t/h/@adv/pub/z"),
    *(f"@ros2_lv/{DOMAIN}/z/1/2/MP/%/%{robot}/agent/n" for robot in ("r1", "r2", "r1%arm")),
    "@ros2_lv/1/z/1/2/MP/%/%r1/agent/n",
    "@/z/router",
)
ROUTER_SPACE = "@/z/router"


@dataclass(frozen=True)
class Cell:
    user: str
    operation: Operation
    key: str


@dataclass(frozen=True)
class Sessions:
    witness: Bus
    """User `server`, which may do everything."""
    users: dict[str, Bus]


def a_user(role: str) -> User:
    return User("r1", role, ("r1",)) if ROLES[role].has_robots else User(role, role)


USERS = {user.name: user for user in map(a_user, ROLES)}


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sessions]:
    with pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        endpoint = free_endpoint("tls")
        folder = prepare_secure_folder(SecureSettings(WORLD, DOMAIN, endpoint))
        folder.ensure(USERS.values())
        router = stack.enter_context(secured_router(folder, "test"))
        witness = stack.enter_context(open_bus(router.wait()))
        users = {
            account.user.name: stack.enter_context(
                open_bus(BusConfig(connect=(folder.make_token(account).write(),)))
            )
            for account in folder.list_active()
        }
        yield Sessions(witness, users)


def close_all(declared: Sequence[Closable]) -> None:
    for one in declared:
        one.close()


def list_cells(operation: Operation) -> list[Cell]:
    return [
        Cell(user, operation, key.replace("ME", user))
        for user in USERS
        for key in KEYS
        if not (operation is Operation.DECLARE_TOKEN and "*" in key)
    ]


def is_granted(cell: Cell) -> bool:
    allowed = list_keys(USERS[cell.user], cell.operation, world=WORLD, domain=DOMAIN)
    return any(zenoh.KeyExpr(one).includes(cell.key) for one in allowed)


def granted(operation: Operation) -> set[Cell]:
    return {cell for cell in list_cells(operation) if is_granted(cell)}


def example_of(key: str) -> str:
    """Make a key that an expression includes; other expressions of the test may include it, too."""
    return key.replace("**", "any/thing").replace("*", "some")


def declare_watched(key: str) -> str:
    """Make the expression on which the witness watches a key: `**` does not include `@`."""
    return key if "@" in key else "**"


def test_matrix_has_many_cells() -> None:
    cells = [cell for operation in Operation for cell in list_cells(operation)]

    assert len(set(cells)) >= LEAST_CELLS
    assert 0 < sum(map(is_granted, cells)) < len(cells)


def test_publishes_on_the_keys_of_its_role_only(sessions: Sessions) -> None:
    cells = list_cells(Operation.PUBLISH)
    expressions = {declare_watched(cell.key) for cell in cells}
    watches = [sessions.witness.subscribe(one, depth=100_000) for one in expressions]
    publishers = [(cell, sessions.users[cell.user].advertise(cell.key, "")) for cell in cells]
    seen: set[Cell] = set()
    order = random.Random(len(cells))

    def publish_again() -> bool:
        # A router passes few puts on wildcards a second: each has to be the first once.
        order.shuffle(publishers)
        for cell, publisher in publishers:
            publisher.send(cell.user.encode())
        for user in sessions.users.values():
            user.list_tokens(f"sim/{WORLD}/alive/server")
        for watch in watches:
            for sample in watch.take():
                seen.add(Cell(sample.payload.decode(), Operation.PUBLISH, sample.key))
        return seen >= granted(Operation.PUBLISH)

    eventually(publish_again, WITHIN_S, "every granted put")
    publish_again()
    close_all([*watches, *(one for _, one in publishers)])
    assert seen == granted(Operation.PUBLISH)


def test_subscribes_to_the_keys_of_its_role_only(sessions: Sessions) -> None:
    cells = list_cells(Operation.SUBSCRIBE)
    subscriptions = [
        (cell, sessions.users[cell.user].subscribe(cell.key, depth=10_000)) for cell in cells
    ]
    publishers = [
        sessions.witness.advertise(key, "") for key in {example_of(cell.key) for cell in cells}
    ]
    seen: set[Cell] = set()

    def publish_again() -> bool:
        for publisher in publishers:
            publisher.send(b"witness")
        for user in sessions.users.values():
            user.list_tokens(f"sim/{WORLD}/alive/server")
        seen.update(cell for cell, subscription in subscriptions if subscription.take())
        return seen >= granted(Operation.SUBSCRIBE)

    eventually(publish_again, WITHIN_S, "every granted subscription")
    publish_again()
    close_all([*publishers, *(one for _, one in subscriptions)])
    # A narrower subscription of the same session makes samples of a wider one arrive: both match.
    assert {cell for cell in seen - granted(Operation.SUBSCRIBE) if not may_overlap(cell)} == set()
    assert granted(Operation.SUBSCRIBE) - seen == set()


def may_overlap(cell: Cell) -> bool:
    """Whether a denied expression includes a key that the same user may subscribe to."""
    allowed = list_keys(USERS[cell.user], Operation.SUBSCRIBE, world=WORLD, domain=DOMAIN)
    return "*" in cell.key and any(zenoh.KeyExpr(one).intersects(cell.key) for one in allowed)


def test_queries_the_keys_of_its_role_only(sessions: Sessions) -> None:
    cells = [cell for cell in list_cells(Operation.QUERY) if cell.key != ROUTER_SPACE]
    expressions = {declare_watched(cell.key) for cell in cells}
    queues = [sessions.witness.serve(one, depth=100_000) for one in expressions]
    seen: set[Cell] = set()

    def query_again() -> bool:
        for cell in cells:
            sessions.users[cell.user].get(cell.key, timeout_s=0.01, payload=cell.user.encode())
        for queue in queues:
            while queries := queue.take():
                for query in queries:
                    seen.add(Cell(query.payload.decode(), Operation.QUERY, query.key))
                    query.drop()
        return seen >= granted(Operation.QUERY)

    eventually(query_again, WITHIN_S, "every granted query")
    query_again()
    for queue in queues:
        queue.close()
    assert seen == granted(Operation.QUERY)


def test_answers_on_the_keys_of_its_role_only(sessions: Sessions) -> None:
    cells = list_cells(Operation.REPLY)
    queues = [
        (cell, sessions.users[cell.user].serve(cell.key, is_complete=False)) for cell in cells
    ]
    examples = {example_of(cell.key) for cell in cells if cell.key != ROUTER_SPACE}
    seen: set[Cell] = set()

    def query_again() -> bool:
        for key in examples:
            sessions.witness.get(key, timeout_s=0.01)
        for cell, queue in queues:
            for query in queue.take():
                seen.add(cell)
                query.drop()
        return seen >= granted(Operation.REPLY)

    eventually(query_again, WITHIN_S, "every granted answer")
    query_again()
    for _, queue in queues:
        queue.close()
    denied = {cell for cell in seen - granted(Operation.REPLY) if not overlaps_reply(cell)}
    assert denied == set()
    assert granted(Operation.REPLY) - seen == set()


def overlaps_reply(cell: Cell) -> bool:
    """Whether a denied expression includes a key on which the same user may answer."""
    allowed = list_keys(USERS[cell.user], Operation.REPLY, world=WORLD, domain=DOMAIN)
    return "*" in cell.key and any(zenoh.KeyExpr(one).intersects(cell.key) for one in allowed)


def test_declares_the_tokens_of_its_role_only(sessions: Sessions) -> None:
    for cell in list_cells(Operation.DECLARE_TOKEN):
        user = sessions.users[cell.user]
        token = user.token(cell.key)
        if is_granted(cell):
            eventually(partial(sessions.witness.list_tokens, cell.key), WITHIN_S, cell.key)
        else:
            user.list_tokens(f"sim/{WORLD}/alive/server")
            assert sessions.witness.list_tokens(cell.key) == [], cell
        token.close()
        eventually(partial(has_no_token, sessions.witness, cell.key), WITHIN_S, "its end")


def has_no_token(witness: Bus, key: str) -> bool:
    return not witness.list_tokens(key)


def test_lists_the_tokens_of_its_role_only(sessions: Sessions) -> None:
    cells = list_cells(Operation.WATCH_TOKENS)
    examples = {example_of(cell.key) for cell in cells}
    tokens = [sessions.witness.token(key) for key in examples]
    seen: set[Cell] = set()

    def list_again() -> bool:
        for cell in cells:
            user = sessions.users[cell.user]
            own = keys.user_session(WORLD, cell.user, user.zid)
            if {*user.list_tokens(cell.key, timeout_s=1.0)} - {own}:
                seen.add(cell)
        return seen >= granted(Operation.WATCH_TOKENS)

    eventually(list_again, WITHIN_S, "every granted list")
    list_again()
    for token in tokens:
        token.close()
    assert seen == granted(Operation.WATCH_TOKENS)
