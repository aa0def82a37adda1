"""A recording as the network of a page: snapshots, models, files and topics of its robots."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Any, Final, cast

import msgspec

from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode
from zensim.proto.messages.asset_messages import (
    MAX_CHUNK_BYTES,
    GetAssetRequest,
    GetAssetResponse,
)
from zensim.proto.messages.replay_messages import (
    ReplayReport,
    ReplayRequest,
    ReplaySeekRequest,
    ReplaySetRateRequest,
)
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.standard_messages import NANOSECONDS, String
from zensim.proto.messages.telemetry_messages import (
    GetModelsRequest,
    GetModelsResponse,
    Snapshot,
)
from zensim.proto.network_protocols import Sample
from zensim.proto.replay_catalog import GET_STATE, PAUSE, RESUME, SEEK, SET_RATE
from zensim.proto.service_catalog import (
    GET_ASSET,
    GET_MODELS,
    Request,
    Response,
    Service,
)
from zensim.proto.topic_catalog import SNAPSHOT
from zensim.recording.entity_files import MESHES_FOLDER, MODELS_FOLDER
from zensim.recording.mcap_records import MalformedRecord
from zensim.recording.recording_reader import RecordingReader, RecordingRun, StoredMessage

MAX_DIGITS: Final = 20
"""Of the number in the name of a file with models."""
LOOK_BACK_NS: Final = 2 * NANOSECONDS
"""How old a message may be that is shown after a jump; a paused server publishes at 2 Hz."""
REPEAT_S: Final = 0.4
"""Period at which a paused recording repeats its snapshot, as a server does."""
WORLD_CHUNK: Final = 2
"""Of `/sim/WORLD/snapshot`."""
RATES: Final = (0.01, 100.0)
"""Least and greatest rate; rate 0, as fast as possible, is the greatest."""
MonotonicClock = Callable[[], float]


class NotForThePage(ValueError):
    """A recording lacks what the page draws."""


class RecordingClock:
    """Position in a recording, whose runs follow each other; for one thread.

    Attributes:
        rate: Recorded time per wall time.
        loops: Whether it starts again at its end, rather than pause there.
        jumps: Number of jumps so far, also at the end of a loop.
    """

    def __init__(self, length_ns: int, clock: MonotonicClock = time.monotonic) -> None:
        self.length_ns = length_ns
        self.rate = 1.0
        self.loops = False
        self.jumps = 0
        self._clock = clock
        self._is_playing = False
        self._from_ns, self._from_s = 0, clock()

    @property
    def is_playing(self) -> bool:
        """Whether the position moves."""
        return self._is_playing

    @property
    def position_ns(self) -> int:
        """Time since the start of the recording, 0 to `length_ns`."""
        if not self._is_playing:
            return self._from_ns
        passed_s = self._clock() - self._from_s
        position = self._from_ns + round(passed_s * self.rate * NANOSECONDS)
        if position < self.length_ns:
            return position
        if self.loops:
            self.seek(position % max(self.length_ns, 1))
        else:
            self._is_playing, self._from_ns = False, self.length_ns
        return self._from_ns

    def play(self) -> None:
        """Play, from the start if the end was reached."""
        if self._from_ns >= self.length_ns:
            self.seek(0)
        self._from_ns, self._from_s = self.position_ns, self._clock()
        self._is_playing = True

    def pause(self) -> None:
        """Pause at this position."""
        self._from_ns = self.position_ns
        self._is_playing = False

    def seek(self, position_ns: int) -> None:
        """Jump to a position."""
        self._from_ns = min(max(position_ns, 0), self.length_ns)
        self._from_s = self._clock()
        self.jumps += 1

    def set_rate(self, rate: float) -> None:
        """Set recorded time per wall time."""
        self._from_ns, self._from_s = self.position_ns, self._clock()
        self.rate = min(max(RATES[0], rate), RATES[1])


class RecordedSubscription:
    """The messages of a key expression up to the position of a clock."""

    def __init__(self, network: "RecordedNetwork", key: str) -> None:
        self._network, self._key = network, key
        self._jumps = -1
        self._messages: Iterator[tuple[int, StoredMessage]] = iter(())
        self._next: tuple[int, StoredMessage] | None = None

    def take(self) -> list[Sample]:
        """Take the messages since the last call; after a jump the last one before its target."""
        clock = self._network.clock
        position = clock.position_ns
        has_jumped = clock.jumps != self._jumps
        if has_jumped:
            self._jumps = clock.jumps
            self._messages = self._network.messages(self._key, position - LOOK_BACK_NS)
            self._next = next(self._messages, None)
        taken = []
        while self._next is not None and self._next[0] <= position:
            topic, _, _, payload = self._next[1]
            taken.append(Sample(topic.name.strip("/"), payload, Format.CDR.value))
            self._next = next(self._messages, None)
        return taken[-1:] if has_jumped else taken

    def newest(self) -> Sample | None:
        """Take all messages and return the last."""
        taken = self.take()
        return taken[-1] if taken else None

    def close(self) -> None:
        """End the subscription."""
        self._messages, self._next = iter(()), None


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
            self._last = snapshot
            self._network.roster = snapshot.roster
            self._network.names = snapshot.names
        elif now < self._next_at:
            return None
        if self._last is None:
            return None
        self._next_at = now + REPEAT_S
        clock = self._network.clock
        shown = msgspec.structs.replace(
            self._last,
            state="playing" if clock.is_playing else "paused",
            real_time_factor=clock.rate if clock.is_playing else 0.0,
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


class AliveToken:
    """Liveliness token of a server that is alive from the start."""

    def __init__(self, key: str) -> None:
        self._changes = [(key, True)]

    def take(self) -> list[tuple[str, bool]]:
        """Take the only change."""
        taken, self._changes = self._changes, []
        return taken

    def close(self) -> None:
        """Do nothing."""


class RecordedNetwork:
    """A recording as the network of a page: topics, files, and services that control the replay.

    Attributes:
        clock: Of the replay.
        world: Name of the recorded world.
        roster: Of the last snapshot.
        names: Its entities.
    """

    def __init__(self, reader: RecordingReader, clock: MonotonicClock = time.monotonic) -> None:
        """Open a recording.

        Raises:
            NotForThePage: It has no snapshots, or no models.
        """
        worlds = _list_worlds(reader)
        self._models = _find_models(reader)
        if not worlds or not self._models:
            missing = "snapshots" if not worlds else "models"
            raise NotForThePage(
                f"{reader.path} has no {missing}, which the page draws; "
                "record with 'zensim record --all'"
            )
        self._reader, self.world, self.now = reader, worlds[0], clock
        self._starts = _find_starts(reader.runs)
        self.clock = RecordingClock(self._starts[-1], clock)
        self._has_begun = False
        self.roster = 0
        self.names: tuple[str, ...] = ()
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
        del depth, max_bytes  # nothing waits
        if not self._has_begun:
            self._has_begun = True
            self.clock.play()
        samples = RecordedSubscription(self, key)
        return RecordedSnapshots(self, samples) if key == SNAPSHOT.key(self.world) else samples

    def watch_tokens(self, key: str, depth: int = 0) -> AliveToken:
        """Watch the token of the server, which is alive."""
        del depth
        return AliveToken(key)

    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 0.0,
        request_id: str = "",
    ) -> Response:
        """Call a service of the replay, of files or of models.

        Raises:
            ServiceError: A recording has no such service, or no such file.
        """
        del world, timeout_s, request_id
        answer = self._answers.get(service.name)
        if answer is None:
            raise _refuse(service, "this is a recording, which cannot be changed")
        try:
            return cast("Response", answer(request) or service.response())
        except KeyError as error:
            raise _refuse(service, f"the recording has no {error}") from error
        except MalformedRecord as error:
            raise _refuse(service, str(error)) from error

    def messages(self, key: str, start_ns: int) -> Iterator[tuple[int, StoredMessage]]:
        """Read the messages of a key expression from a position [ns] on, with their positions."""
        for run, offset in zip(self._reader.runs, self._starts, strict=False):
            begin = start_ns - offset + run.start_ns
            if run.end_ns < begin:
                continue
            for message in run.messages(
                lambda topic: keys.intersect(key, topic.name.strip("/")), start_ns=max(begin, 0)
            ):
                yield message[1] - run.start_ns + offset, message

    def _get_models(self, _: GetModelsRequest) -> GetModelsResponse:
        """Find the first models that have all entities of the last snapshot, or else the last."""
        found: GetModelsResponse | None = None
        for roster in sorted(self._models):
            try:
                content = self._reader.read_attachment(self._models[roster])
                found = msgspec.json.decode(content, type=GetModelsResponse)
            except (MalformedRecord, msgspec.DecodeError, UnicodeDecodeError):
                continue
            if {member.entity for member in found.entities} >= set(self.names):
                break
        if found is None:
            raise _refuse(GET_MODELS, "all models of the recording are malformed")
        return msgspec.structs.replace(found, roster=self.roster)

    def _get_asset(self, request: GetAssetRequest) -> GetAssetResponse:
        content = self._reader.read_attachment(f"{MESHES_FOLDER}{request.sha256}")
        part = content[request.offset : request.offset + MAX_CHUNK_BYTES]
        return GetAssetResponse(data=part, total=len(content))

    def _pause(self, _: ReplayRequest) -> ReplayReport:
        self.clock.pause()
        return self._report()

    def _resume(self, _: ReplayRequest) -> ReplayReport:
        self.clock.play()
        return self._report()

    def _seek(self, request: ReplaySeekRequest) -> ReplayReport:
        # Before rounding: not a number, and what is too large for an integer.
        position_s = min(max(0.0, request.position_s), self.clock.length_ns / NANOSECONDS)
        self.clock.seek(round(position_s * NANOSECONDS))
        return self._report()

    def _set_rate(self, request: ReplaySetRateRequest) -> ReplayReport:
        self.clock.set_rate(request.rate or RATES[1])
        return self._report()

    def _report(self, _: ReplayRequest | None = None) -> ReplayReport:
        return ReplayReport(
            is_paused=not self.clock.is_playing,
            rate=self.clock.rate,
            position_s=self.clock.position_ns / NANOSECONDS,
            duration_s=self.clock.length_ns / NANOSECONDS,
        )


def read_snapshot(payload: bytes) -> Snapshot:
    """Read a snapshot as the recorder writes it: a text with JSON.

    Raises:
        MalformedPayload: It is something else.
    """
    text = decode(String, payload, Format.CDR.value).data
    try:
        return msgspec.json.decode(text, type=Snapshot)
    except msgspec.DecodeError as error:
        raise MalformedPayload(f"the recorded snapshot is malformed: {error}") from error


def _find_models(reader: RecordingReader) -> dict[int, str]:
    """Find the names of the files with models, by number of the roster."""
    numbers = {
        one.name.removeprefix(MODELS_FOLDER).removesuffix(".json"): one.name
        for one in reader.attachments
        if one.name.startswith(MODELS_FOLDER)
    }
    # Python converts no number of thousands of digits.
    return {
        int(number): name
        for number, name in numbers.items()
        if number.isdecimal() and len(number) <= MAX_DIGITS
    }


def _list_worlds(reader: RecordingReader) -> list[str]:
    """List the worlds that have snapshots."""
    return [
        topic.name.split("/")[WORLD_CHUNK]
        for topic, count in reader.counts.items()
        if count and keys.intersect(SNAPSHOT.key("*"), topic.name.strip("/"))
    ]


def _find_starts(runs: tuple[RecordingRun, ...]) -> list[int]:
    """Find the position at which each run starts, and the end of the last."""
    starts = [0]
    for run in runs:
        starts.append(starts[-1] + run.end_ns - run.start_ns)
    return starts


def _refuse(service: Service[Any, Any], message: str) -> ServiceError:
    code = ResultCode.FEATURE_UNSUPPORTED
    return ServiceError(service.name, code, code.name, message)
