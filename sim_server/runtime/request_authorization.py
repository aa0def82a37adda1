"""Authorization of requests to a secured server: who may call what, on which entities.

Zenoh's access control ties the user in a key to a password; the rest only the server can know.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
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
from zensim.proto.messages.telemetry_messages import Info
from zensim.proto.network_protocols import ServiceCall
from zensim.proto.security.roles import CONTROLLING, READING, ROLES, ROLES_OF_CALLERS, User
from zensim.proto.service_catalog import INFO
from zensim.sim_server.errors import SimError
from zensim.sim_server.runtime.audit_trail import AuditTrail
from zensim.sim_server.world.entity import Entity

FREE_SERVICES: Final = frozenset({INFO.name})
"""Services that need no user: what a client calls to find out that the server is secured."""


class AccessDenied(SimError):
    """The caller may not do this."""

    slug = "access.denied"


class UserDirectory(Protocol):
    """The users of a secured server."""

    def find_user(self, name: str) -> User | None:
        """Find a user that is admitted now."""


class EntityFinder(Protocol):
    """The entities of a world."""

    @property
    def by_name(self) -> Mapping[str, Entity]:
        """The entities by name."""


@dataclass
class RequestAuthorization:
    """Checks of the requests of users; an audit has what was refused, and what was accepted."""

    users: UserDirectory
    entities: EntityFinder
    audit: AuditTrail
    _owners: dict[str, tuple[str, int]] = field(default_factory=dict)
    """User that spawned an entity, by name, and `Entity.born_ns`."""

    def check(self, call: ServiceCall, request: msgspec.Struct) -> None:
        """Refuse a request that its caller may not make.

        Raises:
            AccessDenied: Its role has no such service, or the request is about what is not its own.
        """
        if call.name in FREE_SERVICES:
            return
        user = self._find_user(call.user)
        reason = self._find_fault(user, call, request)
        if reason or call.name not in READING:
            self.audit.note_request(call, user.role if user else "", request, reason)
        if reason:
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

    def add_role(self, call: ServiceCall, response: msgspec.Struct) -> msgspec.Struct:
        """Add the role of its caller to a response that reports it."""
        if not isinstance(response, Info):
            return response
        user = self._find_user(call.user)
        return msgspec.structs.replace(response, role=user.role if user else "")

    def _find_fault(self, user: User | None, call: ServiceCall, request: msgspec.Struct) -> str:
        """Say why the caller may not make the request; empty if it may."""
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


def _describe(user: User) -> str:
    return f"user '{user.name}' with role '{user.role}'"


def _find_claim_fault(
    user: User, request: ClaimEntityRequest | ClaimShareRequest, entities: Mapping[str, Entity]
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
