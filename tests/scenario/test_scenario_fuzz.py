"""Mutated scenario files are refused or read; nothing else happens."""

import os
import random
from pathlib import Path

from tests.scenario.test_scenario_reader import FULL
from zensim.scenario.scenario_nodes import ScenarioInvalid
from zensim.scenario.scenario_reader import read_scenario

ROUNDS = int(os.environ.get("ZENSIM_FUZZ_ROUNDS", "300"))
"""Files; the long form of the test has 100,000."""
PIECES = [
    *("{", "}", "[", "]", ":", ", ", "- ", "\n", "  ", "\t", "*a", "&a ", "!!x ", "'", '"', "#"),
    *(".nan", ".inf", "1e999", "-1", "0", "true", "null", "~", "robots", "name", "do", "that"),
    *("{uniform: [1, 2]}", "9" * 400, "cart[2-1]", "\x00", "\ud7ff", "3 m", "<<", "? ", "| ", "> "),
]


def mutate(text: str, random_source: random.Random) -> str:
    for _ in range(random_source.randint(1, 6)):
        at = random_source.randrange(len(text))
        end = at + random_source.choice((0, 0, 1, 2, 5, 20))
        choice = random_source.random()
        piece = random_source.choice(PIECES)
        if choice < 0.2:
            other = random_source.randrange(len(text))
            piece = text[other : other + random_source.randint(1, 40)]
        elif choice < 0.3:
            piece = ""
        text = text[:at] + piece + text[end:]
    return text


def count_mistakes(file: str) -> int:
    try:
        read_scenario(file)
    except ScenarioInvalid as error:
        return len(error.issues)
    return 0


def test_mutated_file_is_read_or_refused_with_places(tmp_path: Path) -> None:
    file = tmp_path / "run.scenario.yaml"
    source = random.Random(16)
    refused = 0

    for _ in range(ROUNDS):
        file.write_text(mutate(FULL, source), encoding="utf-8", newline="")
        refused += count_mistakes(str(file)) > 0

    assert refused > ROUNDS // 4
