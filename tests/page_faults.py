"""Page faults of a call."""

import resource
from collections.abc import Callable

PAGE_BYTES = resource.getpagesize()


def count_page_faults(act: Callable[[], object]) -> int:
    """Count the page faults of this thread in a call."""
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt
    act()
    return resource.getrusage(resource.RUSAGE_THREAD).ru_minflt - before
