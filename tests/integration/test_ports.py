"""Ports of servers that tests start."""

import multiprocessing
import os

from tests.integration.processes import free_endpoint


def find_endpoint(worker: str) -> str:
    os.environ["PYTEST_XDIST_WORKER"] = worker
    return free_endpoint()


def test_workers_that_are_forked_choose_ports_of_their_own() -> None:
    free_endpoint()  # a fork would go on from here
    context = multiprocessing.get_context("fork")
    found = []
    for worker in ("gw5", "gw6"):
        with context.Pool(1) as pool:
            found.append(pool.apply(find_endpoint, (worker,)))

    assert len(set(found)) == 2
