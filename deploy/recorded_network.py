"""A recording as the network of a page: snapshots, models, files and topics of its robots."""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Any, Final, cast

import msgspec

from zensim.deploy.recorded_models import RecordedModels
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode
from zensim.proto.memory_bus import MemoryBus
from zensim.proto.messages.asset_messages import MAX_CHUNK_BYTES, GetAssetRequest, GetAssetResponse
from zensim.proto.messages.replay_messages import (
    ReplayReport,
    ReplayRequest,
    ReplaySeekRequest,
    ReplaySetRateRequest,
)
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.standard_messages import NANOSECONDS, String
from zensim.proto.messages.telemetry_messages import GetModelsRequest, GetModelsResponse, Snapshot
from zensim.proto.network_protocols import Sample, Subscription
from zensim.proto.replay_catalog import GET_STATE, PAUSE, RESUME, SEEK, SET_RATE
from zensim.proto.service_catalog import GET_ASSET, GET_MODELS, Service
from zensim.proto.topic_catalog import SNAPSHOT
from zensim.recording.entity_files import MESHES_FOLDER
from zensim.recording.mcap_records import MalformedRecord
from zensim.recording.recording_reader import RecordingReader, accept_all
from zensim.recording.replay.replay_clock import ReplayClock
from zensim.recording.replay.replay_timeline import ReplayTimeline, TimedMessage

LOG = logging.getLogger(__name__)
LOOK_BACK_NS: Final = 2 * NANOSECONDS
"""How old a message may be that is shown after a jump; a paused server publishes at 2 Hz."""
REPEAT_S: Final = 0.4
"""Period at which a paused recording repeats its snapshot, as a server does."""
WORLD_CHUNK: Final = 2
"""Place of the world's name in `/sim/WORLD/snapshot`, split at slashes."""
RATES: Final = (0.01, 100.0)
"""Least and greatest rate; rate 0, as fast as possible, is the greatest."""
MonotonicClock = Callable[[], float]


class NotForThePage(ValueError):
    """A recording lacks what the page draws."""


class RecordedPlayback:
    """The `ReplayClock` of a page: it pauses at the end of the recording, or begins again.

    Attributes:
        duration_ns: Position of the end.
        loops: Whether it begins again at the end.
        jumps: Number of jumps so far, also at the end of a loop.
    """

    def __init__(self, duration_ns: int, wall: MonotonicClock = time.monotonic) -> None:
        """Pause at the start.

        Args:
            duration_ns: Of the recording.
            wall: Reads the wall time [s].
        """
        self.duration_ns = duration_ns
        self.loops = False
        self.jumps = 0
        self._wall = wall
        self._clock = ReplayClock(1.0, wall(), is_paused=True)

    @property
    def is_paused(self) -> bool:
        """Whether the position stays."""
        return self._clock.is_paused

    @property
    def rate(self) -> float:
        """Recorded time per wall time."""
        return self._clock.rate

    @property
    def position_ns(self) -> int:
        """Time since the start of the recording, 0 to `duration_ns`."""
        position = self._clock.read(self._wall())
        if position < self.duration_ns or self.is_paused:
            return min(position, self.duration_ns)
        if self.loops:
            self.seek(position % max(self.duration_ns, 1))
        else:
            self._clock.pause(self.duration_ns, self._wall())
        return min(self._clock.read(self._wall()), self.duration_ns)

    def play(self) -> None:
        """Play, from the start if the end was reached."""
        if self.position_ns >= self.duration_ns:
            self.seek(0)
        self._clock.resume(self._wall())

    def pause(self) -> None:
        """Pause at this position."""
        self._clock.pause(self.position_ns, self._wall())

    def seek(self, position_ns: int) -> None:
        """Jump to a position."""
        self._clock.move(min(max(position_ns, 0), self.duration_ns), self._wall())
        self.jumps += 1

    def set_rate(self, rate: float) -> None:
        """Set recorded time per wall time, within `RATES`; 0 = the greatest.

        Raises:
            ValueError: It is negative, or not a number.
        """
        within = min(max(RATES[0], rate), RATES[1]) if rate > 0.0 else rate or RATES[1]
        self._clock.set_rate(within, self.position_ns, self._wall())


class RecordedSubscription(Subscription):
    """The messages of a key expression up to the position of a playback.

    Attributes:
        run: Number of the run of the last message that was taken.
    """

    def __init__(
        self, timeline: ReplayTimeline, playback: RecordedPlayback, depth: int = 1
    ) -> None:
        """Read nothing yet.

        Args:
            timeline: Of the topics.
            playback: Its position is that of the newest message.
            depth: Number of messages that wait; older ones are dropped.
        """
        self._timeline, self._playback, self._depth = timeline, playback, depth
        self._jumps, self._reached_ns = -1, 0
        self._messages: Iterator[TimedMessage] = iter(())
        self._next: TimedMessage | None = None
        self.run = 0

    def take(self) -> list[Sample]:
        """Take the messages since the last call; after a jump the last one before its target."""
        position = self._playback.position_ns
        has_jumped = self._playback.jumps != self._jumps
        # Messages that were not taken in time are skipped: reading them would stall the caller.
        if has_jumped or position - self._reached_ns > LOOK_BACK_NS:
            self._jumps = self._playback.jumps
            self._messages = self._timeline.messages(
                position - LOOK_BACK_NS, self._timeline.duration_ns
            )
            self._pull()
        self._reached_ns = position
        taken: deque[Sample] = deque(maxlen=1 if has_jumped else self._depth)
        while self._next is not None and self._next[0] <= position:
            _, self.run, topic, payload = self._next
            taken.append(Sample(topic.name.strip("/"), payload, Format.CDR.value))
            self._pull()
        return list(taken)

    def close(self) -> None:
        """End the subscription."""
        self._messages, self._next = iter(()), None

    def _pull(self) -> None:
        """Read the next message; a file that cannot be read has no further ones."""
        try:
            self._next = next(self._messages, None)
        except (OSError, ValueError) as error:
            LOG.warning("the recording cannot be read on: %s", error)
            self.close()


class RecordedSnapshots:
    """Snapshots with the state and rate of the replay; repeated while it is paused."""

    def __init__(self, network: "RecordedNetwork", samples: RecordedSubscription) -> None:
        self._network, self._samples = network, samples
        self._last: Snapshot | None = None
        self._next_at = 0.0

    def newest(self) -> Sample | None:
        """Return the newest snapshot, if it is new or due to be repeated."""
        snapshot, now = self._read(), self._network.now()
        if snapshot is not None:
            self._last = self._network.enter(self._samples.run, snapshot)
        elif now < self._next_at:
            return None
        if self._last is None:
            return None
        self._next_at = now + REPEAT_S
        playback = self._network.playback
        shown = msgspec.structs.replace(
            self._last,
            state="paused" if playback.is_paused else "playing",
            real_time_factor=0.0 if playback.is_paused else playback.rate,
        )
        return Sample("", encode(shown, Format.MSGPACK), Format.MSGPACK.value)

    def _read(self) -> Snapshot | None:
        """Read the newest snapshot, if it is new; a malformed one is skipped."""
        sample = self._samples.newest()
        with suppress(MalformedPayload):
            return None if sample is None else read_snapshot(sample.payload)
        return None

    def take(self) -> list[Sample]:
        """Take the newest snapshot."""
        sample = self.newest()
        return [] if sample is None else [sample]

    def close(self) -> None:
        """End the subscription."""
        self._samples.close()


class RecordedNetwork:
    """A recording as the network of a page: topics, files, and services that control the replay.

    Attributes:
        playback: Position, rate and state of the replay.
        world: Name of the recorded world.
    """

    def __init__(self, reader: RecordingReader, clock: MonotonicClock = time.monotonic) -> None:
        """Open a recording.

        Raises:
            NotForThePage: It has no snapshots, or no models.
        """
        worlds = _list_worlds(reader)
        self._models = RecordedModels(reader)
        if not worlds or not self._models.has_any:
            missing = "snapshots" if not worlds else "models"
            raise NotForThePage(
                f"{reader.path} has no {missing}, which the page draws; "
                "record with 'zensim record --all'"
            )
        self._reader, self.world, self.now = reader, worlds[0], clock
        self._timeline = ReplayTimeline(reader.runs, accept_all)
        self.playback = RecordedPlayback(self._timeline.duration_ns, clock)
        bus = MemoryBus(self._answer)
        bus.token(keys.alive_server(self.world))
        self.call, self.watch_tokens = bus.call, bus.watch_tokens
        self._has_begun = False
        self._rosters: dict[tuple[int, int], int] = {}
        self._entered: tuple[int, int, tuple[str, ...]] = (0, 0, ())
        self._asset = ("", b"")
        self._answers: Mapping[str, Callable[[Any], msgspec.Struct | None]] = {
            GET_MODELS.name: self._get_models,
            GET_ASSET.name: self._get_asset,
            GET_STATE.name: self._report,
            PAUSE.name: self._pause,
            RESUME.name: self._resume,
            SEEK.name: self._seek,
            SET_RATE.name: self._set_rate,
        }

    def subscribe(
        self, key: str, depth: int = 1, max_bytes: int = 0
    ) -> "RecordedSubscription | RecordedSnapshots":
        """Subscribe to a key expression; the first subscription starts the replay."""
        del max_bytes  # nothing waits
        if not self._has_begun:
            self._has_begun = True
            self.playback.play()
        timeline = ReplayTimeline(
            self._reader.runs, lambda topic: keys.intersect(key, topic.name.strip("/"))
        )
        samples = RecordedSubscription(timeline, self.playback, depth)
        return RecordedSnapshots(self, samples) if key == SNAPSHOT.key(self.world) else samples

    def enter(self, run: int, snapshot: Snapshot) -> Snapshot:
        """Go on to a snapshot of a run; `get_models` describes its entities from here on.

        Returns:
            It with a roster that no other run has: each server counts from 0.
        """
        self._entered = run, snapshot.roster, snapshot.names
        return msgspec.structs.replace(snapshot, roster=self._find_roster(run, snapshot.roster))

    def _answer(self, service: Service[Any, Any], request: msgspec.Struct) -> msgspec.Struct:
        """Call a service of the replay, of files or of models.

        Raises:
            ServiceError: A recording has no such service or file, or the request is not valid.
        """
        answer = self._answers.get(service.name)
        if answer is None:
            raise _refuse(service, "this is a recording, which cannot be changed")
        try:
            return answer(request) or cast("msgspec.Struct", service.response())
        except KeyError as error:
            raise _refuse(service, f"the recording has no {error}") from error
        except (MalformedRecord, OSError, ValueError) as error:
            raise _refuse(service, str(error)) from error

    def _find_roster(self, run: int, roster: int) -> int:
        return self._rosters.setdefault((run, roster), len(self._rosters) + 1)

    def _get_models(self, _: GetModelsRequest) -> GetModelsResponse:
        run, roster, names = self._entered
        found = self._models.find(run, roster, names)
        return msgspec.structs.replace(found, roster=self._find_roster(run, roster))

    def _get_asset(self, request: GetAssetRequest) -> GetAssetResponse:
        name = f"{MESHES_FOLDER}{request.sha256}"
        if name != self._asset[0]:
            self._asset = name, self._reader.read_attachment(name)
        content = self._asset[1]
        part = content[request.offset : request.offset + MAX_CHUNK_BYTES]
        return GetAssetResponse(data=part, total=len(content))

    def _pause(self, _: ReplayRequest) -> ReplayReport:
        self.playback.pause()
        return self._report()

    def _resume(self, _: ReplayRequest) -> ReplayReport:
        self.playback.play()
        return self._report()

    def _seek(self, request: ReplaySeekRequest) -> ReplayReport:
        # Before rounding: not a number, and what is too large for an integer.
        position_s = min(max(0.0, request.position_s), self.playback.duration_ns / NANOSECONDS)
        self.playback.seek(round(position_s * NANOSECONDS))
        return self._report()

    def _set_rate(self, request: ReplaySetRateRequest) -> ReplayReport:
        self.playback.set_rate(request.rate)
        return self._report()

    def _report(self, _: ReplayRequest | None = None) -> ReplayReport:
        position = self.playback.position_ns
        return ReplayReport(
            is_paused=self.playback.is_paused,
            rate=self.playback.rate,
            position_s=position / NANOSECONDS,
            duration_s=self.playback.duration_ns / NANOSECONDS,
            time_ns=self._timeline.find_log_ns(position, self._timeline.find_run(position)),
        )


def read_snapshot(payload: bytes) -> Snapshot:
    """Read a snapshot as the recorder writes it: a text with JSON.

    Raises:
        MalformedPayload: It is something else.
    """
    text = decode(String, payload, Format.CDR.value).data
    try:
        return msgspec.json.decode(text, type=Snapshot)
    except (msgspec.DecodeError, RecursionError) as error:
        raise MalformedPayload(f"the recorded snapshot is malformed: {error}") from error


def _list_worlds(reader: RecordingReader) -> list[str]:
    """List the worlds that have snapshots."""
    return [
        topic.name.split("/")[WORLD_CHUNK]
        for topic, count in reader.counts.items()
        if count and keys.intersect(SNAPSHOT.key("*"), topic.name.strip("/"))
    ]


def _refuse(service: Service[Any, Any], message: str) -> ServiceError:
    code = ResultCode.FEATURE_UNSUPPORTED
    return ServiceError(service.name, code, code.name, message)
