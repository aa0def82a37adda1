"""The effect of each tag of a description, collected during parsing."""

from collections.abc import Iterable
from difflib import get_close_matches

from zensim.proto.messages.model_messages import ReportEntry, ReportStatus

MAX_ENTRIES = 200
"""Without suspicious ones."""
MAX_SUSPICIOUS_ENTRIES = 600
"""More than one per link of the largest robot, so that no missing mesh is left out."""


class ParseReport:
    """Different entries in order; entries beyond the maximum are only counted."""

    def __init__(self) -> None:
        self._entries: dict[ReportEntry, None] = {}
        self._suspicious = 0
        self._left_out = 0

    def applied(self, subject: str, reason: str = "") -> None:
        """Report a tag that has an effect."""
        self._add("applied", subject, reason)

    def ignored(self, subject: str, reason: str) -> None:
        """Report a known tag that has no effect."""
        self._add("ignored", subject, reason)

    def unknown(self, subject: str, reason: str) -> None:
        """Report an unknown tag."""
        self._add("unknown", subject, reason)

    def suspicious(self, subject: str, reason: str) -> None:
        """Report a probable mistake."""
        self._add("suspicious", subject, reason)

    def repeat(self, entry: ReportEntry, *, of: str) -> None:
        """Copy an entry from the report of a model, named `of`, of this world."""
        self._add(entry.status, f"{of}: {entry.subject}", entry.reason)

    def unread_tag(self, subject: str, tag: str, known: Iterable[str]) -> None:
        """Report an unknown tag; as suspicious if its name resembles a known one."""
        shown = f"{subject}: <{tag[:80]}>"
        if not self._has_room("unknown"):
            # The comparison is slow: a hostile file could have many unknown tags.
            self._left_out += 1
            return
        similar = get_close_matches(tag, known, n=1, cutoff=0.75)
        if similar:
            self.suspicious(shown, f"not read; did you mean <{similar[0]}>?")
        else:
            self.unknown(shown, "not read")

    def entries(self) -> tuple[ReportEntry, ...]:
        """List the entries, and the number of those left out."""
        if not self._left_out:
            return tuple(self._entries)
        more = ReportEntry("ignored", "report", f"{self._left_out} more entries are left out")
        return (*self._entries, more)

    def _add(self, status: ReportStatus, subject: str, reason: str) -> None:
        entry = ReportEntry(status, subject, reason)
        if entry in self._entries:
            return
        if self._has_room(status):
            self._entries[entry] = None
            self._suspicious += status == "suspicious"
        else:
            self._left_out += 1

    def _has_room(self, status: ReportStatus) -> bool:
        if status == "suspicious":
            return self._suspicious < MAX_SUSPICIOUS_ENTRIES
        return len(self._entries) - self._suspicious < MAX_ENTRIES
