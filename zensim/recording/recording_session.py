"""A recording from its start to its end: recorder, ring, files and counts."""

import time
from typing import Final

import msgspec

from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.messages.telemetry_messages import Event, Info, InfoRequest
from zensim.proto.network_protocols import CallingNetwork
from zensim.proto.service_catalog import INFO
from zensim.recording.mcap_records import AttachedFile, Metadata
from zensim.recording.message_order import MessageOrder
from zensim.recording.recorded_topics import RecordedMessage, RecordedTopic
from zensim.recording.recorder import Recorder, RecorderSettings, TimeBase
from zensim.recording.recording_parts import PartSettings, RecordingParts
from zensim.recording.snapshot_ring import SnapshotRing
from zensim.recording.write_queue import DirectWriter, MessageWriter, NewPart, WriteQueue

REPORT_PERIOD_S: Final = 1.0
FACTS_FILE: Final = "zensim.json"


class SessionSettings(msgspec.Struct, frozen=True, kw_only=True):
    """How messages are kept."""

    parts: PartSettings
    max_cache_bytes: int
    """Most bytes of messages that wait for the disk, or that `--snapshot-mode` keeps."""
    is_snapshot: bool = False
    """Whether messages are kept in memory, and written on demand only."""
    snapshot_ns: int = 0
    """Log time that the ring keeps; 0 = as much as fits."""
    snapshot_on: frozenset[str] = frozenset()
    """Kinds of events at which it is written."""
    is_direct: bool = False
    """Whether the caller writes, and waits for the disk, so that nothing is lost."""


class RecordingStart(msgspec.Struct, frozen=True, kw_only=True):
    """The world when a recording began."""

    info: Info
    wall_ns: int
    """Time of day [ns]."""
    time_base: TimeBase


class RecordingFigures(msgspec.Struct, frozen=True, kw_only=True):
    """Counts of a recording so far."""

    duration_s: float
    """Wall time."""
    messages: int
    """Messages in the files."""
    bytes: int
    topics: int
    deleted: int
    """Messages in files that were deleted, as newer ones are kept."""
    lost: int
    """Received, and not written: the disk was too slow, or full."""
    overflows: int
    """How often messages came faster than they were taken; each time some were lost."""
    missing: int
    """Approximate number of messages lost by overflows, by the gaps between their stamps."""
    malformed: int
    held: int = 0
    """Messages in memory, for the next snapshot."""


class RecordingSession:
    """Takes what the recorder hands over to the ring or to the thread that writes."""

    def __init__(self, settings: SessionSettings, start: RecordingStart) -> None:
        """Create the first file.

        Raises:
            OSError: It exists, or cannot be created.
        """
        self._settings, self._start = settings, start
        self._order = MessageOrder() if settings.parts.is_reproducible else None
        self._parts: RecordingParts[RecordedTopic] = RecordingParts(
            settings.parts, make_metadata(start)
        )
        self._queue: MessageWriter = (
            DirectWriter(self._parts)
            if settings.is_direct
            else WriteQueue(self._parts, settings.max_cache_bytes)
        )
        self._ring = SnapshotRing(settings.snapshot_ns, settings.max_cache_bytes)
        self._wants_snapshot = False
        self._snapshots = 0
        self._close_failure: OSError | None = None
        self._began_s = time.monotonic()

    @property
    def failure(self) -> OSError | None:
        """What ended the recording, such as a full disk; what was written before is readable."""
        return self._queue.failure or self._close_failure

    def put(self, batch: list[RecordedMessage]) -> None:
        """Keep or write messages."""
        if not self._settings.is_snapshot:
            self._queue.put(batch if self._order is None else self._order.add(batch))
            return
        for message in batch:
            self._ring.add(message)
        if self._wants_snapshot:
            self.write_snapshot()

    def start_part(self, log_ns: int, publish_ns: int) -> None:
        """Begin a new file, as time was reset."""
        if self._settings.is_snapshot:
            self._ring.take()  # readers would mix two runs
        else:
            self._release()
            self._queue.order(NewPart(log_ns, publish_ns))

    def note_event(self, event: Event) -> None:
        """Write the ring after an event that asks for it."""
        self._wants_snapshot |= event.kind in self._settings.snapshot_on

    def write_snapshot(self) -> int:
        """Write the ring to a file of its own; return the number of messages."""
        self._wants_snapshot = False
        messages = self._ring.take()
        if messages:
            if self._snapshots:
                self._queue.order(NewPart(*messages[0][1:3]))
            self._snapshots += 1
            self._queue.put(messages)
        return len(messages)

    def attach(self, attachment: AttachedFile) -> None:
        """Write a file into the recording."""
        self._queue.order(attachment)

    def read_figures(self, recorder: Recorder) -> RecordingFigures:
        """Read the counts."""
        parts, deleted = self._parts, self._parts.deleted
        return RecordingFigures(
            duration_s=round(time.monotonic() - self._began_s, 3),
            messages=parts.written - deleted,
            deleted=deleted,
            bytes=parts.written_bytes,
            topics=parts.topics,
            lost=self._queue.lost,
            overflows=recorder.overflows,
            missing=recorder.missing,
            malformed=recorder.malformed,
            held=len(self._ring),
        )

    def close(self, recorder: Recorder) -> RecordingFigures:
        """Write what waits, and the counts of the recording; see `failure` afterwards."""
        self._release()
        self._queue.stop()
        content = self._write_facts(recorder)
        try:
            self._parts.close(attachments=[AttachedFile(FACTS_FILE, "application/json", content)])
        except OSError as error:
            self._close_failure = error
        return msgspec.structs.replace(
            self.read_figures(recorder),
            lost=self._queue.lost + self._parts.offered - self._parts.written,
        )

    def discard(self) -> None:
        """End a recording that has not begun, or is not wanted, and remove its files."""
        self._queue.stop()
        self._parts.discard()

    def _release(self) -> None:
        """Write the messages that wait for earlier ones."""
        if self._order is not None:
            self._queue.put(self._order.release())

    def _write_facts(self, recorder: Recorder) -> bytes:
        figures = self.read_figures(recorder)
        if self._order is not None:
            figures = msgspec.structs.replace(figures, duration_s=0.0)
        return msgspec.json.encode({"start": self._start, "recorded": figures})


def make_start(server: CallingNetwork, settings: RecorderSettings) -> RecordingStart:
    """Describe the world, without what depends on the host if files are to be equal.

    Raises:
        BusError: No server of the world replies.
    """
    info, wall_ns = server.call(INFO, InfoRequest(), world=settings.world), time.time_ns()
    if info.state == "restoring":
        raise NoServer(
            f"the server restores {info.restored} of {info.to_restore} entities; try again later"
        )
    if settings.is_reproducible:
        info, wall_ns = msgspec.structs.replace(info, real_time_factor=0.0), 0
    return RecordingStart(info=info, wall_ns=wall_ns, time_base=settings.time_base)


def make_metadata(start: RecordingStart) -> Metadata:
    """Describe world and time of a recording."""
    info = start.info
    texts = {
        "world": info.world,
        "world_model": info.world_model,
        "engine": info.engine,
        "seed": str(info.seed),
        "version": info.version,
        "step_ns": str(info.step_ns),
        "time_base": start.time_base,
        "start_wall_time_ns": str(start.wall_ns),
        "start_simulation_time_ns": str(round(info.sim_time_s * NANOSECONDS)),
    }
    return Metadata("zensim", texts)
