"""A short fuzz run of a server's network; `make fuzz` sends a million messages."""

import pytest

from tests.hostile.message_fuzz import BATCH, fuzz_messages

MESSAGES = 1000


@pytest.mark.short_form
def test_server_and_a_robot_survive_damaged_messages() -> None:
    times_s = fuzz_messages(MESSAGES, seed=5)

    assert len(times_s) == MESSAGES // BATCH
