"""Reads health and metrics of processes, as probes and Prometheus do."""

import urllib.error
import urllib.request
from collections.abc import Mapping

from prometheus_client.parser import text_string_to_metric_families

from tests.integration.processes import free_endpoint

TIMEOUT_S = 10.0


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


def scrape(port: str) -> Mapping[tuple[str, ...], float]:
    """Read all values by name and labels, but that of the world."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=TIMEOUT_S) as found:
        text = found.read().decode()
    return {
        (one.name, *(value for name, value in sorted(one.labels.items()) if name != "world")): (
            one.value
        )
        for family in text_string_to_metric_families(text)
        for one in family.samples
    }
