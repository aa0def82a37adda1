"""Authorization of requests to a secured server: who may call what, on which entities.

Zenoh's access control ties the user in a key to a password; the rest only the server can know.
"""

import logging
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import BoundedSemaphore
from typing import Final, Protocol

import msgspec

from zensim.proto.messages.agent_messages import ClaimEntityRequest, ClaimShareRequest
from zensim.proto.messages.entity_messages import SetEntityInfoRequest
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.spawn_messages import (
    DeleteEntityRequest,
    SpawnEntitiesResponse,
    SpawnEntityReport,
)
from zensim.proto.messages.telemetry_messages import Refusal
from zensim.proto.network_protocols import ServiceCall
from zensim.proto.rosout import FOR_OPERATORS
from zensim.proto.security.roles import CONTROLLING, ROLES, ROLES_OF_CALLERS, User
from zensim.proto.service_catalog import INFO
from zensim.sim_server.errors import SimError
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.world.entity import Entity

LOG = logging.getLogger(__name__)
MAX_REPORTS_PER_WINDOW: Final = 20
"""Refusals that are logged and published in a second; the others are only counted."""
WINDOW_NS: Final = 1_000_000_000
FREE_SERVICES: Final = frozenset({INFO.name})
"""Services that need no user: what a client calls to find out that the server is secured."""


class AccessDenied(SimError):
    """The caller may not do this."""

    slug = "access.denied"


class UserDirectory(Protocol):
    """The users of a secured server."""

    def find_user(self, name: str) -> User | None:
        """Find a user that is admitted now."""

    def find_address(self, session: str) -> str:
        """Find the address of a session; may take a moment, and is called by another thread."""


class EntityFinder(Protocol):
    """The entities of a world."""

    @property
    def by_name(self) -> Mapping[str, Entity]:
        """The entities by name."""


@dataclass
class RequestAuthorization:
    """Checks of the requests of users; counts and reports what it refuses."""

    users: UserDirectory
    entities: EntityFinder
    now_ns: Callable[[], int]
    """Wall time."""
    loop_stats: LoopStats
    reports: deque[Refusal] = field(default_factory=deque)
    """To publish."""
    _owners: dict[str, tuple[str, int]] = field(default_factory=dict)
    """User that spawned an entity, by name, and `Entity.born_ns`."""
    _window_ns: int = 0
    _reported: int = 0
    _thread: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "audit"))
    """Finds addresses: a refusal takes no time of the loop."""
    _unlocated: BoundedSemaphore = field(
        default_factory=lambda: BoundedSemaphore(MAX_REPORTS_PER_WINDOW)
    )
    """Refusals that may wait for their address."""

    def check(self, call: ServiceCall, request: msgspec.Struct) -> None:
        """Refuse a request that its caller may not make.

        Raises:
            AccessDenied: Its role has no such service, or the request is about what is not its own.
        """
        if call.name in FREE_SERVICES:
            return
        reason = self._find_fault(call, request)
        if reason:
            self._note_refusal(call, reason)
            raise AccessDenied(reason)

    def note_response(self, call: ServiceCall, response: msgspec.Struct) -> None:
        """Note the owner of what a request has spawned."""
        names: tuple[str, ...] = ()
        if isinstance(response, SpawnEntityReport) and response.result.result == ResultCode.OK:
            names = (response.entity_name,)
        elif isinstance(response, SpawnEntitiesResponse):
            results = (one for one in response.results if one.result.result == ResultCode.OK)
            names = tuple(one.entity_name for one in results)
        for name in names:
            if (entity := self.entities.by_name.get(name)) is not None:
                self._owners[name] = call.user, entity.born_ns
        if len(self._owners) > 2 * len(self.entities.by_name) + 1:
            self._owners = {
                name: owner for name, owner in self._owners.items() if name in self.entities.by_name
            }

    def take_reports(self) -> list[Refusal]:
        """Take the refusals to publish."""
        return [self.reports.popleft() for _ in range(len(self.reports))]

    def close(self) -> None:
        """End the thread that finds addresses; refusals that wait for theirs are not reported."""
        self._thread.shutdown(cancel_futures=True)

    def _find_fault(self, call: ServiceCall, request: msgspec.Struct) -> str:
        """Say why the caller may not make the request; empty if it may."""
        user = self._find_user(call.user)
        if user is None:
            return f"user '{call.user[:64]}' is not admitted; get a new token from the operator"
        if call.name not in ROLES[user.role].services:
            return f"{_describe(user)} may not call {call.name[:64]}"
        match request:
            case ClaimEntityRequest() | ClaimShareRequest():
                return _find_claim_fault(user, request, self.entities.by_name)
            case DeleteEntityRequest() | SetEntityInfoRequest():
                return self._find_ownership_fault(user, request.entity)
        return ""

    def _find_user(self, name: str) -> User | None:
        if (role := ROLES_OF_CALLERS.get(name)) is not None:
            # These keys have no user; the router admits only users of this role to them.
            return User(name, role)
        return self.users.find_user(name)

    def _find_ownership_fault(self, user: User, name: str) -> str:
        entity = self.entities.by_name.get(name)
        if entity is None or ROLES[user.role].services >= CONTROLLING:
            return ""
        if self._owners.get(name) == (user.name, entity.born_ns):
            return ""
        return f"{_describe(user)} may change only entities that it spawned, not '{name[:64]}'"

    def _note_refusal(self, call: ServiceCall, reason: str) -> None:
        self.loop_stats.refused += 1
        now_ns = self.now_ns()
        if now_ns - self._window_ns >= WINDOW_NS:
            self._window_ns, self._reported = now_ns, 0
        self._reported += 1
        if self._reported > MAX_REPORTS_PER_WINDOW:
            return
        user = self._find_user(call.user)
        role = user.role if user else ""
        refusal = Refusal(call.user, role, call.name[:64], reason, self.loop_stats.refused)
        if call.session and self._unlocated.acquire(blocking=False):
            self._thread.submit(self._locate, refusal, call.session)
        else:
            self._report(refusal)

    def _locate(self, refusal: Refusal, session: str) -> None:
        try:
            address = self.users.find_address(session)
        finally:
            self._unlocated.release()
        self._report(msgspec.structs.replace(refusal, address=address))

    def _report(self, refusal: Refusal) -> None:
        LOG.warning(
            "refused user=%s role=%s service=%s address=%s",
            refusal.user,
            refusal.role,
            refusal.service,
            refusal.address,
            extra=FOR_OPERATORS,
        )
        self.reports.append(refusal)


def _describe(user: User) -> str:
    return f"user '{user.name}' with role '{user.role}'"


def _find_claim_fault(
    user: User,
    request: ClaimEntityRequest | ClaimShareRequest,
    entities: Mapping[str, Entity],
) -> str:
    if request.agent != user.name:
        return f"{_describe(user)} may not claim as agent '{request.agent[:64]}'"
    if not ROLES[user.role].has_robots:
        return ""
    if isinstance(request, ClaimShareRequest):
        return f"{_describe(user)} may claim only its own robots, by name"
    for name in request.entities:
        entity = entities.get(name)
        if name not in user.robots:
            return f"{_describe(user)} may not claim '{name[:64]}', which is not its robot"
        if entity is not None and entity.namespace not in user.robots:
            return (
                f"{_describe(user)} may not publish in namespace '{entity.namespace[:64]}' of "
                f"'{name}'; create its token with --robot {entity.namespace[:64]}, too"
            )
    return ""
