"""Users of a secured server as its loop asks for them, and their sessions."""

import time
from typing import Final

import msgspec

from zensim.proto import keys
from zensim.proto.bus.bus_session import Bus
from zensim.proto.messages.telemetry_messages import AuditRecord
from zensim.proto.security.roles import ROLES_OF_CALLERS, User
from zensim.sim_server.security.audit_file import AuditFile
from zensim.sim_server.security.secure_folder import SecureFolder
from zensim.sim_server.security.user_sessions import SessionChange, UserSessions

REFUSALS_DEPTH: Final = 1024


class AdmittedUsers:
    """The users of a folder, whose sessions are linked to the router of the server."""

    def __init__(self, folder: SecureFolder, bus: Bus, world: str) -> None:
        self._folder = folder
        self._audit = AuditFile(folder.path)
        self._sessions = UserSessions(bus.zid)
        self._links = bus.watch_tokens(keys.router_links(world))
        self._tokens = bus.watch_tokens(keys.user_sessions(world))
        self._refusals = bus.subscribe(keys.router_refusals(world), REFUSALS_DEPTH)

    def find_user(self, name: str) -> User | None:
        """Find a user that is admitted now."""
        return self._folder.find_user(name)

    def find_address(self, session: str, user: str) -> str | None:
        """See `UserSessions.find_address`."""
        # Calls of ROS 2 have a name that stands for all users of a role.
        return self._sessions.find_address(session, "" if user in ROLES_OF_CALLERS else user)

    def take_changes(self) -> list[SessionChange]:
        """Take the sessions that joined, left or were refused since the last call."""
        now_s = time.monotonic()
        for key, is_alive in self._tokens.take():
            user, session = keys.parse_user_session(key)
            self._sessions.note_user(session, user, is_alive=is_alive)
        for key, is_alive in self._links.take():
            session, address = keys.parse_router_link(key)
            self._sessions.note_link(session, address, is_open=is_alive, now_s=now_s)
        refused = [
            msgspec.json.decode(one.payload, type=SessionChange) for one in self._refusals.take()
        ]
        return [*self._sessions.take(now_s), *refused]

    def keep(self, record: AuditRecord) -> None:
        """Append a record to the file of the audit, in the folder of the server."""
        self._audit.keep(record)

    def close(self) -> None:
        """Write the records that wait."""
        self._audit.close()
