"""Refuses on the side of a client what a secured server would drop without a reply."""

from contextlib import suppress
from typing import Final

from zensim.proto import keys
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.bus.bus_session import Bus
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.telemetry_messages import InfoRequest
from zensim.proto.security.roles import ROLES, Operation, User, list_keys
from zensim.proto.service_catalog import INFO

DOES: Final = {
    Operation.PUBLISH: "publish on",
    Operation.SUBSCRIBE: "subscribe to",
    Operation.QUERY: "query",
    Operation.DECLARE_TOKEN: "declare the token",
}


def require_access(bus: Bus, world: str, operation: Operation, *wanted: str) -> None:
    """Ask the server for the role of this session, and refuse what it does not permit.

    Without a secured server that replies, nothing is refused.

    Raises:
        ServiceError: See `require_role`.
    """
    if bus.user:
        with suppress(NoServer, TimeoutError):
            role = bus.call(INFO, InfoRequest(), world=world).role
            require_role(User(bus.user, role), world, operation, *wanted)


def require_role(user: User, world: str, operation: Operation, *wanted: str) -> None:
    """Refuse an operation on key expressions that the role of a user does not permit.

    Raises:
        ServiceError: As the server refuses a request, with the roles that may.
    """
    for key in wanted if user.role in ROLES else ():
        # Which robots are a user's own the server knows.
        has_more = ROLES[user.role].has_robots and not key.startswith("sim/")
        if not (has_more or _may(user, world, operation, key)):
            able = [role for role in ROLES if _may(User(user.name, role), world, operation, key)]
            raise ServiceError(
                "",
                ResultCode.OPERATION_FAILED,
                ResultCode.OPERATION_FAILED.name,
                f"access.denied: role '{user.role}' of user '{user.name}' may not "
                f"{DOES[operation]} {key}; use a token of role {' or '.join(able) or 'operator'}: "
                "'zensim token create --role ROLE'",
            )


def _may(user: User, world: str, operation: Operation, key: str) -> bool:
    first = key.partition("/")[0]
    domain = int(first) if first.isdecimal() else None
    granted = list_keys(user, operation, world=world, domain=domain)
    return any(keys.intersect(one, key) for one in granted)
