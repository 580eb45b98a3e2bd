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


def test_the_folder_is_there_and_bears_the_mark() -> None:
    assert kernels.folder().is_dir()
    assert kernels.folder().name == f"kernels-{kernels.mark()}"
