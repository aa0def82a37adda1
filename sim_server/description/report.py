"""What became of each tag of a description, collected while it is parsed."""

from collections.abc import Iterable
from difflib import get_close_matches

from zensim.proto.messages.model_messages import ReportEntry, ReportStatus

MAX_ENTRIES = 200
"""Of what is not suspicious."""
MAX_SUSPICIOUS_ENTRIES = 600
"""Room for one entry a link of the largest robot, so that no missing mesh goes unsaid."""


class ParseReport:
    """Entries in the order of reading; beyond their number only counted, once each."""

    def __init__(self) -> None:
        self._entries: dict[ReportEntry, None] = {}
        self._suspicious = 0
        self._left_out = 0

    def applied(self, subject: str, reason: str = "") -> None:
        """Note what takes effect."""
        self._add("applied", subject, reason)

    def ignored(self, subject: str, reason: str) -> None:
        """Note what is understood and has no effect here."""
        self._add("ignored", subject, reason)

    def unknown(self, subject: str, reason: str) -> None:
        """Note what nothing here understands."""
        self._add("unknown", subject, reason)

    def suspicious(self, subject: str, reason: str) -> None:
        """Note what is probably not meant as written."""
        self._add("suspicious", subject, reason)

    def repeat(self, entry: ReportEntry, *, of: str) -> None:
        """Note what the report of a part of this description notes."""
        self._add(entry.status, f"{of}: {entry.subject}", entry.reason)

    def unread_tag(self, subject: str, tag: str, known: Iterable[str]) -> None:
        """Note a tag that nothing reads; one that looks misspelt is suspicious."""
        shown = f"{subject}: <{tag[:80]}>"
        if not self._has_room("unknown"):
            # Guessing at what a hostile file meant would cost more than reading it.
            self._left_out += 1
            return
        meant = get_close_matches(tag, known, n=1, cutoff=0.75)
        if meant:
            self.suspicious(shown, f"not read; did you mean <{meant[0]}>?")
        else:
            self.unknown(shown, "not read")

    def entries(self) -> tuple[ReportEntry, ...]:
        """List what was noted."""
        if not self._left_out:
            return tuple(self._entries)
        more = ReportEntry("ignored", "report", f"{self._left_out} further entries are left out")
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
