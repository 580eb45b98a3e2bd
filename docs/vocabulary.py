"""Count what keeps a newcomer out of the code: vague names and words in private senses.

    python docs/vocabulary.py [--most N]

prints the share of public module functions with a one-word name, class names used twice, and words
that docs/style.md asks to avoid. `tests/test_vocabulary.py` limits all three.
"""

import argparse
import ast
import re
import subprocess
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("mavproxy_fault", "simvehicle", "analysis")
TEXTS = (".py", ".md", ".js", ".html", ".yaml")
AVOIDED = re.compile(
    r"\b(told|tells?|telling|nobody|whoever|seldom|oneself|hold(?:s)? .{1,40} against|is asked"
    r"|are asked|was asked|lets? pass|of late|for good)\b",
    re.IGNORECASE,
)
# One word is enough where every programmer expects the name.
PLAIN = {"main", "run", "parse", "read", "write", "close", "open", "start", "stop", "step", "send"}
PLAIN |= {"load", "save", "apply", "predict", "update", "sample", "decode", "encode"}
UNCOUNTED = ("CHANGELOG.md", "docs/style.md", "docs/vocabulary.py", "tests/data")


def list_files() -> list[Path]:
    """The files that git tracks and that are on disk."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    return [path for name in listed.stdout.split() if (path := ROOT / name).is_file()]


def public_functions(tree: ast.Module) -> Iterator[str]:
    """Names of the public functions of a module."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name[0] != "_":
            yield node.name


def public_classes(tree: ast.Module) -> Iterator[str]:
    """Names of the public classes of a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and node.name[0] != "_":
            yield node.name


def count_names() -> tuple[int, list[str], dict[str, list[str]]]:
    """Number of public module functions, those of one word, and files by class name."""
    total, one_word, classes = 0, [], defaultdict(list)
    for path in list_files():
        name = path.relative_to(ROOT).as_posix()
        if path.suffix != ".py" or name.split("/")[0] not in PACKAGES:
            continue
        tree = ast.parse(path.read_text())
        functions = list(public_functions(tree))
        total += len(functions)
        one_word += [f"{name} {f}" for f in functions if "_" not in f and f not in PLAIN]
        for found in public_classes(tree):
            classes[found].append(name)
    return total, one_word, classes


def count_words() -> Counter[str]:
    """Uses of avoided words by file; without the change log, data and lists of words."""
    found: Counter[str] = Counter()
    for path in list_files():
        name = path.relative_to(ROOT).as_posix()
        if path.suffix in TEXTS and not name.startswith(UNCOUNTED):
            found[name] += len(AVOIDED.findall(path.read_text(errors="replace")))
    return +found


def main() -> None:
    """Print the counts and the first places."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--most", type=int, default=10, help="how many places to list (10)")
    most = parser.parse_args().most
    total, one_word, classes = count_names()
    twice = sorted(name for name, files in classes.items() if len(files) > 1)
    words = count_words()
    print(f"{len(one_word)} of {total} public module functions have a one-word name")
    print("\n".join(f"  {name}" for name in one_word[:most]))
    print(f"{len(twice)} public class names are used twice: {', '.join(twice) or 'none'}")
    print(f"{words.total()} avoided words")
    print("\n".join(f"  {name}: {n}" for name, n in words.most_common(most)))


if __name__ == "__main__":
    main()
