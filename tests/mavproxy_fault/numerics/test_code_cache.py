"""The folder of machine code follows the sources that went into it."""

from pathlib import Path

import pytest

from mavproxy_fault.numerics import code_cache as kernels


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(kernels, "ROOT", tmp_path)
    for name in kernels.PACKAGES:
        (tmp_path / name).mkdir()
    package = tmp_path / "analysis"
    (package / "fast.py").write_text("from numba import njit\nfrom analysis.sizes import N\n")
    (package / "sizes.py").write_text("N = 1\n")
    (package / "plain.py").write_text("N = 1\n")
    return package


@pytest.mark.parametrize(
    ("name", "renewed"), [("fast.py", True), ("sizes.py", True), ("plain.py", False)]
)
def test_what_was_compiled_or_imported_by_it_renews_the_code(
    package: Path, name: str, renewed: bool
) -> None:
    before = kernels.mark.__wrapped__()
    with (package / name).open("a") as file:
        file.write("M = 2\n")
    assert (kernels.mark.__wrapped__() != before) is renewed


@pytest.mark.parametrize(
    ("edited", "renewed"),
    [
        ('"""Words."""\n\n# a comment\ndef half(x):\n    """Half."""\n    return x / 2\n', False),
        ("def half(x):\n    return x / 3\n", True),
    ],
)
def test_only_an_edit_of_the_code_renews_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, edited: str, renewed: bool
) -> None:
    monkeypatch.setenv("MAVPROXY_FAULT_CACHE", str(tmp_path))
    before = kernels.code_digest([b"def half(x):\n    return x / 2\n"])
    for _ in range(2):  # parsed, and remembered
        assert (kernels.code_digest([edited.encode()]) != before) is renewed
    assert len(list(tmp_path.glob("*.digest"))) == 2


def test_the_folder_bears_the_mark() -> None:
    assert kernels.folder().name == f"kernels-{kernels.mark()}"


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
