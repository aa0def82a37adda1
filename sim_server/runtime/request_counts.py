"""Counts of handled requests, by service and result."""

from collections.abc import Iterator
from typing import Final

import msgspec

from zensim.proto.messages.result_messages import Result
from zensim.proto.metric_families import MetricFamily, MetricSample, make_labelled
from zensim.proto.service_catalog import INFO, SERVICES
from zensim.proto.topic_catalog import WORLD_TOPICS

MAX_PAIRS: Final = 80
"""Pairs of service and result; further ones are counted together, so that the series stay few."""
OTHER: Final = ("other", "OTHER")
NAMES: Final = frozenset({*SERVICES, *(topic.suffix for topic in WORLD_TOPICS)})


class RequestCounts:
    """Written by the loop, and read by the thread that serves metrics."""

    def __init__(self) -> None:
        self.refused_unread = 0
        """Requests that were dropped or refused, since too many waited."""
        self._results: dict[tuple[str, ...], int] = {}
        self._durations_ns: dict[str, tuple[int, int]] = {}
        """Number, and time from receipt to response, by service."""

    def add(self, name: str, response: msgspec.Struct, duration_ns: int) -> None:
        """Count a request with its response.

        Args:
            name: As the caller wrote it.
            response: Made for it.
            duration_ns: From the begin of its handling to the response.
        """
        name = name if name in NAMES else "unknown"
        pair: tuple[str, ...] = (name, _name_result(name, response))
        if pair not in self._results and len(self._results) >= MAX_PAIRS:
            pair = OTHER
        self._results[pair] = self._results.get(pair, 0) + 1
        count, total_ns = self._durations_ns.get(name, (0, 0))
        self._durations_ns[name] = (count + 1, total_ns + duration_ns)

    def list_metrics(self) -> Iterator[MetricFamily]:
        """List the counts."""
        yield make_labelled(
            "zensim_requests_total",
            "counter",
            "Requests with a response, by service and result.",
            self._results,
            "service",
            "code",
        )
        samples = []
        for name, (count, total_ns) in tuple(self._durations_ns.items()):
            labels = {"service": name}
            samples.append(MetricSample(count, labels, "_count"))
            samples.append(MetricSample(total_ns * 1e-9, labels, "_sum"))
        yield MetricFamily(
            "zensim_request_duration_seconds",
            "summary",
            "Wall time from the begin of handling to the response.",
            tuple(samples),
        )
        yield make_labelled(
            "zensim_dropped_total",
            "counter",
            "What was received and not handled, as too much waited.",
            {("requests",): self.refused_unread},
            "where",
        )


def _name_result(name: str, response: msgspec.Struct) -> str:
    result: Result = getattr(response, "result", Result())
    return SERVICES.get(name, INFO).code_name(result.result)
