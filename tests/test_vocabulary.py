"""Names and texts keep to the vocabulary of docs/style.md.

`python docs/vocabulary.py` lists what does not.
"""

import runpy
import shutil
from pathlib import Path
from typing import Any

import pytest

MOST_ONE_WORD = 0.1  # of the public module functions
MOST_AVOIDED = 20  # uses in all files: quotations, and ordinary senses of the same words


@pytest.fixture(scope="module")
def vocabulary() -> dict[str, Any]:
    root = Path(__file__).parents[1]
    if shutil.which("git") is None or not (root / ".git").exists():
        pytest.skip("not a git checkout; the counted files are those that git tracks")
    return runpy.run_path(str(root / "docs" / "vocabulary.py"))


def test_public_functions_are_verb_and_object(vocabulary: dict[str, Any]) -> None:
    total, one_word, _ = vocabulary["count_names"]()
    assert len(one_word) <= MOST_ONE_WORD * total, one_word


def test_no_two_public_classes_share_a_name(vocabulary: dict[str, Any]) -> None:
    classes = vocabulary["count_names"]()[2]
    assert {name: files for name, files in classes.items() if len(files) > 1} == {}


def test_texts_avoid_words_in_private_senses(vocabulary: dict[str, Any]) -> None:
    words = vocabulary["count_words"]()
    assert words.total() <= MOST_AVOIDED, words.most_common(20)
