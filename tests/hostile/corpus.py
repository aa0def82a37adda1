"""All hostile descriptions, by name."""

from tests.hostile.case import Case
from tests.hostile.contents import contents
from tests.hostile.documents import documents
from tests.hostile.numbers import numbers
from tests.hostile.trees import trees


def corpus() -> tuple[Case, ...]:
    """Make all cases; some have several megabytes."""
    return (*documents(), *trees(), *numbers(), *contents())
