"""The folder of a module's machine code follows the sources that went into it."""

import ast
from pathlib import Path

import pytest

from mavproxy_fault.numerics import code_cache as kernels

SOURCES = {
    "analysis/fast.py": "import numba\nfrom analysis.sizes import (  # it\n    N,\n)\n",
    "analysis/sizes.py": "from simvehicle import units\nN = units.K\n",
    "simvehicle/units.py": "import mavproxy_fault.metre\nK = 1\n",
    "mavproxy_fault/metre.py": "L = 1\n",
    "simvehicle/__init__.py": "",
    "analysis/plain.py": "import analysis.fast\n",
}


@pytest.mark.parametrize("name", SOURCES)
def test_an_edit_renews_the_code_of_what_imports_it_and_of_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(kernels, "ROOT", tmp_path)
    for file, text in SOURCES.items():
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_text(text)
    digests = []
    for _ in range(2):
        kernels.source_digest.cache_clear()
        kernels._imports.cache_clear()
        digests.append(kernels.source_digest(tmp_path / "analysis/fast.py"))
        with (tmp_path / name).open("a") as edited:
            edited.write("M = 2\n")
    assert (digests[0] != digests[1]) is (name != "analysis/plain.py")


@pytest.mark.parametrize(
    ("edited", "renewed"),
    [
        ('"""Words."""\n\n# a comment\ndef half(x):\n    """Half."""\n    return x / 2\n', False),
        ("def half(x):\n    return x / 3\n", True),
    ],
)
def test_only_an_edit_of_the_code_renews_it(edited: str, renewed: bool) -> None:
    before = kernels.code_digest([b"def half(x):\n    return x / 2\n"])
    assert (kernels.code_digest([edited.encode()]) != before) is renewed


def test_code_between_two_strings_is_not_silent():
    source = 'TEXT = f"""x\n"""\nK = %d\nMORE = """\n"""\n'
    one, two = (kernels.code_digest([(source % k).encode()]) for k in (1, 2))
    assert one != two


def test_the_strings_that_are_silent_in_our_sources_are_docstrings():
    for package in kernels.PACKAGES:
        for path in (kernels.ROOT / package).rglob("*.py"):
            source = path.read_bytes()
            found = [one for one in kernels.SILENT.finditer(source) if b'"""' in one.group()]
            alone = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Expr)]
            lines = {source[: one.start()].count(b"\n") + 1 for one in found}
            assert lines <= {node.lineno for node in alone}, path


@pytest.mark.parametrize("home", [None, "/", "{file}"])
def test_without_a_folder_to_write_to_there_is_a_place_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, home: str | None
) -> None:
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setattr(kernels, "ROOT", file)
    for name in ("MAVPROXY_FAULT_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    if home is not None:
        monkeypatch.setenv("HOME", home.format(file=file))
    monkeypatch.setenv("TMPDIR", str(file))
    monkeypatch.setattr(kernels, "is_usable", lambda path: False)
    assert kernels.place().name.startswith("mavproxy-fault-")


def test_the_folder_that_the_user_names_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAVPROXY_FAULT_CACHE", str(tmp_path / "code"))
    assert kernels.place() == tmp_path / "code"
    assert (tmp_path / "code").is_dir()


def test_without_file_owners_a_place_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(kernels.os, "getuid")
    monkeypatch.delenv("MAVPROXY_FAULT_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert kernels.place() == tmp_path / "mavproxy-fault"


def test_two_installations_share_one_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("MAVPROXY_FAULT_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(kernels, "ROOT", tmp_path / "one")
    one = kernels.place()
    monkeypatch.setattr(kernels, "ROOT", tmp_path / "other")
    assert kernels.place() == one
