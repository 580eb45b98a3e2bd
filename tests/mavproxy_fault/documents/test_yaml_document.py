import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavproxy_fault.documents import yaml_document
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import read_document, read_yaml, write_yaml


def error(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        read_yaml(text, "a.yaml")
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        # YAML 1.2.2, section 10.3.2, and its example 10.9
        ("null", None), ("~", None), ("", None), ("true", True), ("False", False),
        ("0", 0), ("-19", -19), ("+12", 12), ("0o7", 7), ("0x3A", 58),
        ("0.", 0.0), ("-0.0", 0.0), (".5", 0.5), ("+12e03", 12000.0), ("-2E+05", -200000.0),
        ("1e-4", 1e-4), (".inf", math.inf), ("-.Inf", -math.inf),
        # numbers, booleans or dates in YAML 1.1
        ("1:30", "1:30"), ("1_000", "1_000"), ("yes", "yes"), ("off", "off"),
        ("2024-03-07", "2024-03-07"), ("'12'", "12"), ('"true"', "true"), ("0b1", "0b1"),
    ],
)  # fmt: skip
def test_a_scalar_means_what_yaml_1_2_says(text: str, value: Any) -> None:
    found = read_yaml(f"a: {text}", "a.yaml").data["a"]
    assert found == value
    assert type(found) is type(value)


def test_not_a_number_is_read() -> None:
    assert math.isnan(read_yaml("a: .NaN", "a.yaml").data["a"])


def test_every_key_and_item_has_its_line() -> None:
    document = read_yaml("a: 1\nb:\n  - c: 2\n    d: [3,\n      4]\n  - e\n", "a.yaml")
    assert document.data == {"a": 1, "b": [{"c": 2, "d": [3, 4]}, "e"]}
    lines = document.lines
    assert lines == {
        (): 1, ("a",): 1, ("b",): 2, ("b", 0): 3, ("b", 0, "c"): 3, ("b", 0, "d"): 4,
        ("b", 0, "d", 0): 4, ("b", 0, "d", 1): 5, ("b", 1): 6,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: 1\nb: 2\na: 3\n", "a.yaml:3: a is given twice"),
        ("a:\n  b: 010\n", "a.yaml:2: a.b = 010 may be octal; write 10"),
        ("a: 99999999999999999999\n", "integers have at most 64 bits"),
        (f"a: {'9' * 5000}\n", "has 5000 digits"),
        ("a: 1e999\n", "is out of range; numbers reach 1.8e308"),
        ("a: !!python/object:os.system x\n", "a.yaml:1: has the tag"),
        ("[a]: 1\n", "a.yaml:1: has a list or mapping as a key"),
        ("a: 1\n---\nb: 2\n", "a.yaml:2: begins a second document"),
        ("a: &a [*a]\n", "a.yaml:1: *a contains itself"),
        ("a: *b\n", "a.yaml:1: *b contains itself or is not defined above"),
        ("[" * 100_000, "a.yaml:1: is nested deeper than 40"),
        ("{a: " * 100_000, "a.yaml:1: is nested deeper than 40"),
        ("- " * 100_000, "a.yaml:1: is nested deeper than 40"),
        ("a: \x00", "not YAML"),
        ("a: [\n", "a.yaml:2: not YAML"),
        ("- {a: b[0], c: 1}\n", "a.yaml:1: not YAML: did not find expected ',' or '}'; between"),
        ("a: '\ud800'", "is not UTF-8 text"),
        ("#" * (yaml_document.MOST_BYTES + 1), "is too large; at most 8 MB"),
        ("- 0\n" * (yaml_document.MOST_NODES + 1), f"has more than {yaml_document.MOST_NODES}"),
    ],
)
def test_mistakes_and_hostile_text_are_refused(text: str, words: str) -> None:
    assert words in error(text)


def test_all_flaws_are_reported_at_once() -> None:
    text = "a: 010\nb: 1\nb: 2\nc: 1e999\n"
    assert [line.split(" ")[0] for line in error(text).splitlines()] == [
        "a.yaml:1:", "a.yaml:3:", "a.yaml:4:",
    ]  # fmt: skip


def test_an_alias_bomb_counts_as_its_expansion() -> None:
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9)]
    assert "has more than" in error("\n".join(rows))


def test_an_alias_repeats_its_anchor() -> None:
    assert read_yaml("a: &x {b: 1}\nc: *x\n", "a").data == {"a": {"b": 1}, "c": {"b": 1}}


def test_a_file_is_utf_8_with_or_without_a_mark(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: \xc2\xb5\n")
    assert read_document(path).data == {"a": "µ"}
    path.write_bytes(b"a: \xff\n")
    with pytest.raises(ConfigError, match="is not UTF-8 text"):
        read_document(path)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_document(tmp_path)
    with pytest.raises(ConfigError, match="is not a file name"):
        read_document("a\0b")


VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(1 << 63), (1 << 63) - 1)
    | st.floats(allow_nan=False)
    | st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), max_size=12)
    | st.from_regex(r"[-+]?[0-9.:_]{1,6}([eE][-+]?[0-9]+)?", fullmatch=True)
    | st.sampled_from(["yes", "null", "1e5", "010", "0o7", "0x1F", "~", ".inf", "1:30"]),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text("abcdef_10.", min_size=1, max_size=6), inner, max_size=4)
    ),
    max_leaves=12,
)


@given(VALUES, st.sampled_from([True, False, None]))
def test_written_yaml_reads_back(value: Any, flow: bool | None) -> None:
    assert read_yaml(write_yaml(value, flow=flow), "a.yaml").data == value
