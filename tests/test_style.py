"""Docstrings and comments are written in plain words; ruff's D4 rules hold the rest."""

import ast
import io
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BEGINNINGS = re.compile(r"(What|Whether|Where|How|Which)\b")
PHRASES = re.compile(
    r"\b(so many|so far|so much|is one|is none|such a one|what is|likewise|beside|the very|of it|thereof)\b"
)


def faults(source: str) -> list[str]:
    """Return the docstrings and comments with a banned beginning or phrase; names in backticks do not count."""
    texts = [t.string for t in tokenize.generate_tokens(io.StringIO(source).readline) if t.type == tokenize.COMMENT]
    texts += [n.value.value for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Expr) and _is_text(n.value)]
    plain = {text: re.sub(r"`[^`]*`", "", " ".join(text.split())) for text in texts}
    return [t for t, p in plain.items() if BEGINNINGS.match(p) or PHRASES.search(p[:1].lower() + p[1:])]


def _is_text(node):
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


@pytest.mark.parametrize("folder", ["jexplore", "tests", "benchmarks", "docs", "examples"])
def test_docstrings_and_comments_are_plain(folder):
    paths = [path for path in (ROOT / folder).rglob("*.py") if path != Path(__file__)]
    found = {str(path.relative_to(ROOT)): faults(path.read_text(encoding="utf-8")) for path in paths}
    assert {path: texts for path, texts in found.items() if texts} == {}


def test_banned_words_are_found():
    source = 'def f():\n    """What is left."""\n    x = 1  # so many steps\n\n\ndef g():\n    """Return `beside`."""\n'
    assert faults(source) == ["# so many steps", "What is left."]
