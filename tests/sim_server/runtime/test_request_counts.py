"""Counts of requests by service and result."""

from zensim.proto.messages.result_messages import Result, ResultCode, SpawnCode
from zensim.proto.messages.spawn_messages import SpawnEntityReport
from zensim.proto.messages.telemetry_messages import Info
from zensim.proto.service_catalog import SERVICES
from zensim.sim_server.runtime.request_counts import MAX_PAIRS, RequestCounts


def read(counts: RequestCounts, name: str) -> dict[tuple[str, ...], float]:
    return {
        (*one.labels.values(), one.suffix): one.value
        for family in counts.list_metrics()
        if family.name == name
        for one in family.samples
    }


def test_requests_are_counted_by_service_and_result() -> None:
    counts = RequestCounts()

    counts.add("info", Info(), 2_000_000)
    counts.add("info", Info(), 4_000_000)
    refusal = SpawnEntityReport(result=Result(SpawnCode.NAME_NOT_UNIQUE))
    counts.add("spawn_entity", refusal, 1_000_000)

    assert read(counts, "zensim_requests_total") == {
        ("info", "OK", ""): 2,
        ("spawn_entity", "NAME_NOT_UNIQUE", ""): 1,
    }
    assert read(counts, "zensim_request_duration_seconds") == {
        ("info", "_count"): 2,
        ("info", "_sum"): 0.006,
        ("spawn_entity", "_count"): 1,
        ("spawn_entity", "_sum"): 0.001,
    }


def test_unknown_services_share_a_label() -> None:
    counts = RequestCounts()

    for number in range(1000):
        counts.add(f"guess_{number}", Info(result=Result(ResultCode.NOT_FOUND)), 1)

    assert read(counts, "zensim_requests_total") == {("unknown", "NOT_FOUND", ""): 1000}


def test_series_stay_few_whatever_the_results() -> None:
    counts = RequestCounts()

    for name in SERVICES:
        for code in (*ResultCode, *SpawnCode):
            counts.add(name, Info(result=Result(code)), 1)

    found = read(counts, "zensim_requests_total")
    assert len(found) == MAX_PAIRS + 1
    assert sum(found.values()) == len(SERVICES) * (len(ResultCode) + len(SpawnCode))
