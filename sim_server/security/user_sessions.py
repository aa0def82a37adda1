"""Sessions with a secured server: whose they are, where they are linked from, when they end."""

from dataclasses import dataclass
from typing import Final, Literal

import msgspec

UNNAMED_AFTER_S: Final = 2.0
"""A session that has not said by then whose it is joins without a user."""
MAX_WAITING: Final = 1024
"""Sessions with a user whose links are not known yet; clients may declare any number of tokens."""


class SessionChange(msgspec.Struct, frozen=True, kw_only=True):
    """A session that joined, left or was refused."""

    action: Literal["joined", "left", "refused"]
    user: str = ""
    """Empty for a client that declares no token of its session, and for a refused one."""
    address: str
    reason: str = ""
    """Reason of a refusal."""


@dataclass
class _Link:
    address: str
    opened_s: float
    user: str
    is_reported: bool = False


class UserSessions:
    """Brings together what is known of a session: its link, and the user of its token.

    The router declares the links. A user declares a session as its own; the rules of the router
    let it do so in its own name only, and the first who declares a session has it.
    """

    def __init__(self, own: str) -> None:
        self._own = own
        """Session of the server, which is not reported."""
        self._links: dict[str, _Link] = {}
        self._waiting: dict[str, str] = {}
        """User by session, oldest first."""
        self._unreported: dict[str, None] = {}
        self._changes: list[SessionChange] = []

    def note_link(self, session: str, address: str, *, is_open: bool, now_s: float) -> None:
        """Note that the link of a session opened or closed."""
        if session == self._own:
            return
        former = self._links.get(session)
        if former is not None and (is_open or former.address == address):
            self._close(session, former)
        if is_open:
            user = self._waiting.pop(session, "")
            self._links[session] = _Link(address, now_s, user)
            self._unreported[session] = None

    def note_user(self, session: str, user: str, *, is_alive: bool) -> None:
        """Note that a user declared a session as its own, or that this ended.

        The link of a short session may be known only when its token has ended.
        """
        if (link := self._links.get(session)) is not None:
            link.user = link.user or (user if is_alive else "")
        elif is_alive:
            self._waiting.setdefault(session, user)
            if len(self._waiting) > MAX_WAITING:
                del self._waiting[next(iter(self._waiting))]

    def take(self, now_s: float) -> list[SessionChange]:
        """Take the sessions that joined or left, in this order for each."""
        for session in tuple(self._unreported):
            link = self._links[session]
            if link.user or now_s - link.opened_s >= UNNAMED_AFTER_S:
                self._report(session, link)
        changes, self._changes = self._changes, []
        return changes

    def find_address(self, session: str, user: str) -> str | None:
        """Find where a session is linked from.

        Args:
            session: Zenoh id, as a request names it.
            user: Who made the request; empty if that is not known.

        Returns:
            Empty if it is of another user; None if it is not known, or not yet.
        """
        if (link := self._links.get(session)) is None:
            return None
        return link.address if not user or link.user in ("", user) else ""

    def _close(self, session: str, link: _Link) -> None:
        if not link.is_reported:
            self._report(session, link)
        self._changes.append(SessionChange(action="left", user=link.user, address=link.address))
        del self._links[session]

    def _report(self, session: str, link: _Link) -> None:
        link.is_reported = True
        self._unreported.pop(session, None)
        self._changes.append(SessionChange(action="joined", user=link.user, address=link.address))
