"""`python -m tests.benchmark [NAME ...] [--short]`: measure, print, and rewrite docs/benchmarks.md.

The page is written only when everything was measured at full length.
"""

from tests.benchmark.command import Document
from tests.benchmark.machine import ROOT
from tests.benchmark.report import HEAD, NAMES, measure

PAGE = ROOT / "docs" / "benchmarks.md"
DOCUMENT = Document(
    program="tests.benchmark",
    names=NAMES,
    make=measure,
    short="a few seconds each; says little",
    path=PAGE,
    head=HEAD,
)

if __name__ == "__main__":
    DOCUMENT.write()
