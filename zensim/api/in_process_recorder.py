"""InProcessRecorder: records a world of this process, at each control step, in its thread."""

import logging
import math
import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from zensim.api.api_errors import Error
from zensim.api.world_host import WorldHost
from zensim.api.world_recorder import WorldRecorder
from zensim.proto.memory_bus import MemoryBus, MemorySubscription, MemoryTokenWatch
from zensim.proto.messages.input_messages import ServiceRequest
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.network_protocols import Sample, Subscription
from zensim.proto.newest_messages import NewestMessages
from zensim.proto.topic_catalog import CLOCK, LINK_STATES, MAP, MODEL_STATES
from zensim.recording.entity_files import EntityFiles
from zensim.recording.recorder import Recorder, RecorderSettings
from zensim.recording.recording_parts import PartSettings
from zensim.recording.recording_session import RecordingSession, SessionSettings, make_start
from zensim.recording.topic_selection import TopicFilter, TopicSelection
from zensim.spawner.client.topic_reader import TopicReader

LOG = logging.getLogger(__name__)
ROOT_TOPICS: Final = {one.suffix: one for one in (MAP, MODEL_STATES, LINK_STATES)}
"""Topics of the world that a server publishes on their suffix alone, too."""
MIN_FREE_BYTES: Final = 256 << 20


class InProcessRecorder(WorldRecorder):
    """Records by the calls of its world; the caller waits for the disk."""

    def __init__(self, server: WorldHost, path: Path, topics: Sequence[str], rate: float) -> None:
        """Begin to record; see `Simulation.record`.

        Raises:
            Error: The file exists, or cannot be created.
            Unsupported: A topic is of a sensor that this host cannot measure.
        """
        super().__init__(path)
        self._server, self._process_id, self._is_over = server, os.getpid(), False
        chosen = TopicFilter(TopicSelection(topics=tuple(topics), wants_all=not topics))
        settings = RecorderSettings(
            world=server.world.name,
            domain=None,
            period_ns=round(NANOSECONDS / rate) if rate else 0,
            step_ns=server.world.clock.step_ns,
            is_reproducible=True,
            is_in_process=True,
        )
        self._network = RecordedWorld(server)
        self._start = make_start(self._network, settings)
        self._session = self._create_files()
        try:
            self._recorder = Recorder(self._network, chosen, settings, self._session)
            self._files = EntityFiles(
                self._network, settings.world, self._session.attach, LOG.warning
            )
            self._epoch, self._time_ns, self._roster = -1, 0, -1
            self.note_call()
        except BaseException:
            self._network.close()
            self._session.discard()
            raise
        server.recorders.append(self)

    @property
    def _is_recording(self) -> bool:
        """Whether it goes on, in the process that began it: a fork writes to the same file."""
        return self._session.failure is None and os.getpid() == self._process_id

    def note_call(self) -> None:
        """See `StepRecorder`: time that goes back begins a file; files of new entities come in."""
        if not self._is_recording:
            return
        clock, roster = self._server.world.clock, self._server.world.entities.roster_number
        before, self._epoch = self._epoch, clock.epoch
        is_back, self._time_ns = clock.time_ns < self._time_ns, clock.time_ns
        if is_back or before not in (-1, clock.epoch):
            # Before anything that is published after it.
            self._network.send_clock()
            self._recorder.take()
        if roster != self._roster:
            self._roster = roster
            self._files.attach_new(has_arrivals=True, most_s=math.inf)

    def note_request(self, request: ServiceRequest) -> None:
        """See `StepRecorder`."""
        if self._is_recording:
            self._recorder.note_requests((request,))

    def take(self) -> None:
        """See `StepRecorder`."""
        if self._is_recording:
            self._time_ns = self._server.world.clock.time_ns
            self._recorder.take()

    def close(self) -> None:
        """See `WorldRecorder`."""
        if self._is_over or os.getpid() != self._process_id:
            return
        self._is_over = True
        self._server.recorders.remove(self)
        try:
            if self._session.failure is None:
                self._recorder.take(is_last=True)
        finally:
            self._session.close(self._recorder)
            self._network.close()
        if self._session.failure is not None:
            raise self._make_error("is not recorded to the end", self._session.failure)

    def _create_files(self) -> RecordingSession:
        parts = PartSettings(path=self.path, min_free_bytes=MIN_FREE_BYTES, is_reproducible=True)
        try:
            settings = SessionSettings(parts=parts, max_cache_bytes=0, is_direct=True)
            return RecordingSession(settings, self._start)
        except OSError as error:
            raise self._make_error("cannot be recorded", error) from error

    def _make_error(self, what: str, error: OSError) -> Error:
        reason = error.strerror or str(error)
        return Error(f"'{self.path}' {what}: {reason}", slug="no_recorder")


class RecordedWorld:
    """A world of this process as the network of a recorder."""

    def __init__(self, server: WorldHost) -> None:
        self._server = server
        self._subscriptions: list[MemorySubscription] = []
        self._clock_key = CLOCK.key(server.world.name)
        self.call = MemoryBus(server.ask).call

    def subscribe(self, key: str, depth: int = 1) -> Subscription:
        """Subscribe to what is published from now on; messages of a root topic have its key."""
        subscription = self._server.subscribe(self._find_key(key), depth)
        subscription.samples.clear()
        self._subscriptions.append(subscription)
        if key not in ROOT_TOPICS:
            return subscription
        return TopicReader(subscription, partial(_rename, key=key))

    def expect_key(self, key: str) -> None:
        """Do nothing: keys of a process are compared once."""

    def subscribe_newest(
        self, key: str, depth: int, keeps_all: Callable[[str], bool]
    ) -> NewestMessages[Sample]:
        """See `Bus`."""
        return newest_of(self.subscribe(key, depth), keeps_all)

    def get(self, key: str, timeout_s: float = 1.0) -> list[Sample]:
        """Get the last messages of a key expression."""
        del timeout_s
        found = self._server.get(self._find_key(key))
        return [_rename(one, key) for one in found] if key in ROOT_TOPICS else found

    def watch_tokens(self, key: str) -> MemoryTokenWatch:
        """Watch tokens; there are no ROS 2 nodes."""
        return self._server.network.watch_tokens(key)

    def send_clock(self) -> None:
        """Give the clock to the recorder only."""
        for one in self._subscriptions:
            if one.key == self._clock_key:
                one.samples.extend(self._server.get_of_world(self._clock_key))

    def close(self) -> None:
        """End all subscriptions."""
        while self._subscriptions:
            self._subscriptions.pop().close()

    def _find_key(self, key: str) -> str:
        root = ROOT_TOPICS.get(key)
        return key if root is None else root.key(self._server.world.name)


def newest_of(
    subscription: Subscription, keeps_all: Callable[[str], bool]
) -> NewestMessages[Sample]:
    """Keep the newest message of each key of a subscription, and all of some keys."""

    def receive() -> list[tuple[str, Sample]]:
        return [(one.key, one) for one in subscription.take()]

    return NewestMessages(receive, list, subscription.close, keeps_all)


def _rename(sample: Sample, key: str) -> Sample:
    return Sample(key, sample.payload, sample.encoding, sample.attachment)
