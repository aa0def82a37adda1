"""Requests to a replay: pause, resume, toggle, seek, set_rate, play_next, get_state."""

from typing import TYPE_CHECKING, Final

import msgspec

from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, MalformedPayload, encode, make_encoding
from zensim.proto.messages.replay_messages import (
    ReplayPlayNextRequest,
    ReplayReport,
    ReplaySeekRequest,
    ReplaySetRateRequest,
)
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.network_protocols import Query, TopicNetwork
from zensim.proto.replay_catalog import REPLAY_PREFIX, REPLAY_SERVICES
from zensim.proto.service_catalog import Service
from zensim.recording.replay.replayer import Replayer

if TYPE_CHECKING:
    from collections.abc import Callable

AnyService = Service[msgspec.Struct, msgspec.Struct]
REFUSED: Final = ResultCode.OPERATION_FAILED


class ReplayRequests:
    """Serves the requests to one replay."""

    def __init__(self, network: TopicNetwork, world: str, replayer: Replayer) -> None:
        self._replayer = replayer
        self._queue = network.serve(keys.service(world, f"{REPLAY_PREFIX}/*"))
        self._actions: dict[str, Callable[[msgspec.Struct], None]] = {
            "get_state": lambda _: None,
            "pause": lambda _: replayer.pause(),
            "resume": lambda _: replayer.resume(),
            "toggle": lambda _: replayer.toggle(),
            "seek": self._seek,
            "set_rate": self._set_rate,
            "play_next": self._play_next,
        }

    def serve(self) -> int:
        """Reply to all requests that wait; return how many there were."""
        calls = self._queue.take()
        for call in calls:
            service = REPLAY_SERVICES.get(f"{REPLAY_PREFIX}/{call.name}")
            if service is None:
                call.drop()
            else:
                self._reply(call, service)
        return len(calls)

    def close(self) -> None:
        """End the service."""
        self._queue.close()

    def _reply(self, call: Query, service: AnyService) -> None:
        result = Result()
        try:
            self._actions[call.name](call.read(service.request))
        except (ValueError, OSError, MalformedPayload) as error:
            result = Result(REFUSED, f"{service.name}: {error}")
        report = make_report(self._replayer, result)
        used = Format.JSON if call.payload[:1] == b"{" else Format.MSGPACK
        call.reply(encode(report, used), make_encoding(report, used))

    def _seek(self, request: msgspec.Struct) -> None:
        if isinstance(request, ReplaySeekRequest):
            position_s, end_s = request.position_s, self._replayer.duration_ns / NANOSECONDS
            # Before rounding: not a number, and what is too large for an integer.
            if not -1.0 < position_s < end_s + 1.0:
                raise ValueError(f"position {position_s:g} s is outside of the replay")
            self._replayer.seek(round(position_s * NANOSECONDS))

    def _set_rate(self, request: msgspec.Struct) -> None:
        if isinstance(request, ReplaySetRateRequest):
            self._replayer.set_rate(request.rate)

    def _play_next(self, request: msgspec.Struct) -> None:
        if not self._replayer.is_paused:
            raise ValueError("the replay is not paused; call pause first")
        if isinstance(request, ReplayPlayNextRequest):
            self._replayer.play_next(request.count)


def make_report(replayer: Replayer, result: Result = Result()) -> ReplayReport:  # noqa: B008
    """Describe a replay."""
    return ReplayReport(
        result=result,
        is_paused=replayer.is_paused,
        rate=replayer.rate,
        position_s=replayer.find_position() / NANOSECONDS,
        duration_s=replayer.duration_ns / NANOSECONDS,
        time_ns=replayer.find_log_ns(),
        epoch=replayer.epoch,
        published=replayer.published,
    )
