"""Each family of faults meets its limits in the short form."""

import pytest

from tests.chaos.__main__ import NAMES, run_faults


@pytest.mark.short_form
@pytest.mark.parametrize("name", NAMES)
def test_limits_hold_under_faults(name: str) -> None:
    section = run_faults(name, is_short=True)

    assert section.missed == ()
    assert "| " in section.text
