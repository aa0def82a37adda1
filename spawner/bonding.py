"""A bond: the entity goes when the process that spawned it does, however it ends."""

import time
import uuid
from collections.abc import Callable

from zensim.proto.bus import NoServer
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.spawn_messages import SpawnEntityOrder, SpawnEntityReport
from zensim.spawner.client import SimClient

SEEN_WITHIN_S = 2.0
"""How long a server may take to see the token of a bond."""
POLL_S = 0.05
ASK_EVERY_S = 1.0


def bond_name() -> str:
    """Make up a name that no other process has."""
    return f"bond_{uuid.uuid4().hex[:16]}"


def spawn_bonded(client: SimClient, order: SpawnEntityOrder) -> SpawnEntityReport:
    """Spawn; ask again while the server has not seen the bond's token yet.

    Raises:
        ServiceError: The server refuses.
    """
    deadline = time.monotonic() + SEEN_WITHIN_S
    while True:
        try:
            return client.spawn(order)
        except ServiceError as error:
            is_early = order.bond and error.code == ResultCode.INCORRECT_STATE
            if not is_early or time.monotonic() >= deadline:
                raise
        time.sleep(POLL_S)


def stay_with(client: SimClient, entity: str, is_over: Callable[[], bool]) -> bool:
    """Wait until it is over, then delete the entity; return whether it was still there."""
    ask_at = time.monotonic() + ASK_EVERY_S
    while not is_over():
        time.sleep(POLL_S)
        if time.monotonic() < ask_at:
            continue
        ask_at = time.monotonic() + ASK_EVERY_S
        if not _is_there(client, entity):
            return False
    try:
        client.delete(entity)
    except ServiceError as error:
        if error.code != ResultCode.NOT_FOUND:
            raise
        return False
    return True


def wait_for_entity(client: SimClient, entity: str, timeout_s: float) -> None:
    """Wait until an entity is in the world.

    Raises:
        TimeoutError: It did not come.
    """
    deadline = time.monotonic() + timeout_s
    while entity not in client.entities():
        if time.monotonic() >= deadline:
            raise TimeoutError(f"entity '{entity}' did not come within {timeout_s:g} s")
        time.sleep(POLL_S)


def _is_there(client: SimClient, entity: str) -> bool:
    try:
        client.entity_state(entity)
    except ServiceError as error:
        return error.code != ResultCode.NOT_FOUND
    except (NoServer, TimeoutError):
        # A server that is away for a moment has not lost the entity.
        return True
    return True
