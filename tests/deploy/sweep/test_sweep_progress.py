"""Progress of a sweep."""

import pytest

from zensim.deploy.sweep.sweep_progress import SweepProgress, write_duration


def test_time_left_counts_the_runs_of_now_only() -> None:
    progress = SweepProgress(total=100, before=40)
    for number in range(1, 11):
        progress = progress.add(is_passed=number != 3, elapsed_s=3.0 * number)

    assert (progress.done, progress.failed) == (50, 1)
    assert progress.per_minute == pytest.approx(20.0)
    assert progress.left_s == pytest.approx(150.0)


def test_time_left_is_not_known_before_the_first_run() -> None:
    assert SweepProgress(total=3, before=1).left_s is None


@pytest.mark.parametrize(
    ("seconds", "text"), [(4.4, "4 s"), (75.0, "1 min 15 s"), (3725.0, "1 h 02 min")]
)
def test_durations_are_written_in_two_units(seconds: float, text: str) -> None:
    assert write_duration(seconds) == text
