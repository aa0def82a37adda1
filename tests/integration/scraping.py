"""Reads health and metrics of processes, as probes and Prometheus do."""

import urllib.error
import urllib.request
from collections.abc import Mapping

from prometheus_client.parser import text_string_to_metric_families

from tests.integration.processes import free_endpoint

TIMEOUT_S = 10.0
SUFFIXES = {"histogram": ("_bucket", "_count", "_sum"), "summary": ("_count", "_sum")}


def find_free_port() -> str:
    """Find an unused TCP port of loopback."""
    return free_endpoint().rpartition(":")[2]


def probe(port: str, path: str) -> int:
    """Get a path; return the status, or 0 where nothing listens."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=TIMEOUT_S) as found:
            return int(found.status)
    except urllib.error.HTTPError as error:
        return error.code
    except OSError:
        return 0


def list_metric_names(port: str) -> set[str]:
    """List the names of metrics, also of those without a value yet, and of their series."""
    names = set()
    for line in _read_metrics(port).splitlines():
        if line.startswith("# TYPE "):
            name, kind = line.split()[2:4]
            names.add(name)
            if kind in ("histogram", "summary"):
                names |= {name + suffix for suffix in SUFFIXES[kind]}
    return names


def scrape(port: str) -> Mapping[tuple[str, ...], float]:
    """Read all values by name and labels, but that of the world."""
    return {
        (one.name, *(value for name, value in sorted(one.labels.items()) if name != "world")): (
            one.value
        )
        for family in text_string_to_metric_families(_read_metrics(port))
        for one in family.samples
    }


def _read_metrics(port: str) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=TIMEOUT_S) as found:
        text: str = found.read().decode()
    return text
