"""Audit of a secured server: who joined, left, changed the simulation, or was refused.

Each action is a record, up to a burst of the same kind by the same user; beyond it one record at a
time counts several, so that the counts of all records add up to all actions.
"""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple, Protocol

import msgspec

from zensim.proto.messages.telemetry_messages import AuditRecord
from zensim.proto.network_protocols import ServiceCall
from zensim.proto.rosout import FOR_OPERATORS
from zensim.proto.security.roles import User
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.security.user_sessions import SessionChange

LOG = logging.getLogger(__name__)
BURST: Final = 20
"""Records of one kind that a user may cause at once."""
REFILL_NS: Final = 5_000_000_000
"""Wall time from one record of this kind to the next, after a burst."""
POLL_NS: Final = 20_000_000
LOCATE_NS: Final = 500_000_000
"""A router may report a session after the session's first request."""
MAX_KINDS: Final = 4096
MAX_SUBJECT: Final = 200
MAX_WORD: Final = 64
MAX_NAMES: Final = 4
JOINED, ACCEPTED, REFUSED = "joined", "accepted", "refused"


class AuditedUsers(Protocol):
    """The users of a secured server and their sessions."""

    def find_user(self, name: str) -> User | None:
        """Find a user that is admitted now."""

    def find_address(self, session: str, user: str) -> str | None:
        """Find the address of a session of a user; None if it is not known, or not yet."""

    def take_changes(self) -> list[SessionChange]:
        """Take the sessions that joined, left or were refused."""

    def keep(self, record: AuditRecord) -> None:
        """Keep a record; returns at once."""


class _Kind(NamedTuple):
    action: str
    user: str
    service: str


@dataclass
class _Allowance:
    """How many records of a kind may be made now, and what was withheld meanwhile."""

    refilled_ns: int
    left: float = BURST
    withheld: int = 0
    last: AuditRecord = field(default_factory=AuditRecord)
    session: str = ""

    def refill(self, now_ns: int) -> None:
        self.left = min(BURST, self.left + (now_ns - self.refilled_ns) / REFILL_NS)
        self.refilled_ns = now_ns


class _Unlocated(NamedTuple):
    record: AuditRecord
    session: str
    until_ns: int


class AuditTrail:
    """Records of a server, from action to publication."""

    def __init__(
        self,
        users: AuditedUsers,
        loop_stats: LoopStats,
        now_ns: Callable[[], int],
        wall_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """Begin with the sessions that are linked now.

        Args:
            users: Of the server.
            loop_stats: Counts the actions.
            now_ns: Monotonic wall time.
            wall_ns: Wall time since the epoch, for the records.
        """
        self._users = users
        self._loop_stats = loop_stats
        self._now_ns = now_ns
        self._wall_ns = wall_ns
        self._polled_ns = -POLL_NS
        self._allowances: dict[_Kind, _Allowance] = {}
        self._withheld: dict[_Kind, _Allowance] = {}
        """Allowances that withhold some records."""
        self._unlocated: deque[_Unlocated] = deque()
        self._ready: list[AuditRecord] = []

    def note_request(
        self, call: ServiceCall, role: str, request: msgspec.Struct, reason: str
    ) -> None:
        """Note that a request was accepted, or refused for a reason."""
        if reason:
            self._loop_stats.refused += 1
        else:
            self._loop_stats.accepted += 1
        kind = _Kind(REFUSED if reason else ACCEPTED, call.user, call.name[:MAX_WORD])
        record = AuditRecord(action=kind.action, user=kind.user, role=role, service=kind.service)
        if not self._may_record(kind, record, call.session):
            return
        subject = describe_request(request)
        self._locate(msgspec.structs.replace(record, subject=subject, reason=reason), call.session)

    def take(self) -> list[AuditRecord]:
        """Take the records to publish; they are logged and kept."""
        now_ns = self._now_ns()
        if now_ns - self._polled_ns < POLL_NS:
            return []
        self._polled_ns = now_ns
        for change in self._users.take_changes():
            self._note_session(change)
        self._record_withheld(now_ns)
        self._find_addresses(now_ns)
        return self._take_ready()

    def close(self) -> None:
        """Log and keep what waits, for its address or for others of its kind."""
        for allowance in self._withheld.values():
            self._record_count(allowance)
        self._ready += [waiting.record for waiting in self._unlocated]
        self._unlocated.clear()
        self._take_ready()

    def _note_session(self, change: SessionChange) -> None:
        self._loop_stats.joined += change.action == JOINED
        self._loop_stats.refused += change.action == REFUSED
        user = self._users.find_user(change.user)
        kind = _Kind(change.action, change.user, "")
        record = AuditRecord(
            action=kind.action,
            user=change.user,
            role=user.role if user is not None else "",
            address=change.address,
            reason=change.reason,
        )
        if self._may_record(kind, record, ""):
            self._locate(record, "")

    def _may_record(self, kind: _Kind, record: AuditRecord, session: str) -> bool:
        """Whether a record may be made; else it is counted by a later one."""
        now_ns = self._now_ns()
        if (allowance := self._allowances.get(kind)) is None:
            self._forget_idle(now_ns)
            allowance = self._allowances[kind] = _Allowance(now_ns)
        allowance.refill(now_ns)
        if allowance.left >= 1.0 and not allowance.withheld:
            allowance.left -= 1.0
            return True
        allowance.withheld += 1
        allowance.last, allowance.session = record, session
        self._withheld[kind] = allowance
        return False

    def _forget_idle(self, now_ns: int) -> None:
        if len(self._allowances) < MAX_KINDS:
            return
        for allowance in self._allowances.values():
            allowance.refill(now_ns)
        self._allowances = {
            kind: one for kind, one in self._allowances.items() if one.withheld or one.left < BURST
        }

    def _record_withheld(self, now_ns: int) -> None:
        for kind, allowance in tuple(self._withheld.items()):
            allowance.refill(now_ns)
            if allowance.left >= 1.0:
                allowance.left -= 1.0
                self._record_count(allowance)
                del self._withheld[kind]

    def _record_count(self, allowance: _Allowance) -> None:
        counted = msgspec.structs.replace(allowance.last, count=allowance.withheld)
        allowance.withheld = 0
        self._locate(counted, allowance.session)

    def _locate(self, record: AuditRecord, session: str) -> None:
        record = msgspec.structs.replace(record, time_ns=self._wall_ns())
        self._unlocated.append(_Unlocated(record, session, self._now_ns() + LOCATE_NS))

    def _find_addresses(self, now_ns: int) -> None:
        """Complete the records in their order; one whose session is not known waits a moment."""
        while self._unlocated:
            record, session, until_ns = self._unlocated[0]
            address: str | None = record.address
            if session:
                address = self._users.find_address(session, record.user)
            if address is None and now_ns < until_ns:
                return
            self._unlocated.popleft()
            self._ready.append(msgspec.structs.replace(record, address=address or ""))

    def _take_ready(self) -> list[AuditRecord]:
        ready, self._ready = self._ready, []
        for record in ready:
            level = logging.WARNING if record.action == REFUSED else logging.INFO
            LOG.log(
                level,
                "%s user=%s role=%s service=%s address=%s count=%d subject=%r",
                record.action,
                record.user,
                record.role,
                record.service,
                record.address,
                record.count,
                record.subject,
                extra=FOR_OPERATORS,
            )
            self._users.keep(record)
        return ready


def describe_request(request: msgspec.Struct) -> str:
    """Describe in short what a request is about: names, texts and numbers that are not empty."""
    return " ".join(_list_words(request, is_nested=False))[:MAX_SUBJECT]


def _list_words(message: msgspec.Struct, *, is_nested: bool) -> Iterator[str]:
    for name in message.__struct_fields__:
        match getattr(message, name):
            case str() as text if text:
                yield f"{name}={text[:MAX_WORD]}"
            case int() | float() as number if number:
                yield f"{name}={number}"
            case tuple() as several if several:
                yield f"{name}={_write_several(several)}"
            case msgspec.Struct() as part if not is_nested:
                yield from _list_words(part, is_nested=True)


def _write_several(several: tuple[object, ...]) -> str:
    first = several[:MAX_NAMES]
    if not all(isinstance(one, str) for one in first):
        return str(len(several))
    more = f" and {len(several) - MAX_NAMES} more" if len(several) > MAX_NAMES else ""
    return ",".join(str(one)[:MAX_WORD] for one in first) + more
