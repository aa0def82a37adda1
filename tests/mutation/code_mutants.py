"""Small changes of one place of a module: what a tired programmer might have written."""

import ast
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import accumulate, islice, pairwise
from pathlib import Path

SWAPS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.And: ("and", "or"),
    ast.Or: ("or", "and"),
}
"""How an operator is written, and what replaces it."""


@dataclass(frozen=True)
class CodeMutant:
    """One changed place.

    Attributes:
        path: Module, by its path in the repository.
        line: From 1.
        before: Source text of the place.
        after: What replaces it.
        start: Character offset in the file.
        name: What stays the same when other lines of the module change.
    """

    path: Path
    line: int
    before: str
    after: str
    start: int
    name: str = ""

    def apply(self, source: str) -> str:
        """Return the changed source of the module."""
        end = self.start + len(self.before)
        if source[self.start : end] != self.before:
            raise ValueError(f"{self.path}:{self.line} is not {self.before!r}; read the file again")
        return source[: self.start] + self.after + source[end:]

    def __str__(self) -> str:
        """Describe the change in one line."""
        before, after = (" ".join(text.split()) for text in (self.before, self.after))
        return f"{self.path}:{self.line}: {before}  ->  {after}"


def list_mutants(path: Path, source: str) -> list[CodeMutant]:
    """List all mutants of a module, in order of their place."""
    found = _Finder(path, source).find()
    lines, seen = source.splitlines(), Counter[str]()
    named = []
    for one in sorted(found, key=lambda mutant: (mutant.start, mutant.after)):
        change = " -> ".join(" ".join(text.split()) for text in (one.before, one.after))
        name = f"{path}: {lines[one.line - 1].strip()}: {change}"
        seen[name] += 1
        named.append(replace(one, name=f"{name} #{seen[name]}" if seen[name] > 1 else name))
    return named


def sample_mutants(root: Path, paths: Sequence[Path], count: int, seed: int) -> list[CodeMutant]:
    """Sample mutants that compile, each module in proportion to its mutants.

    A change of one module leaves the sample of the others as it is.

    Args:
        root: The repository.
        paths: Modules, by their path in it.
        count: How many at most.
        seed: Of the choice.
    """
    sources = {path: (root / path).read_text("utf-8") for path in paths}
    everything = [one for path, source in sources.items() for one in list_mutants(path, source)]
    everything.sort(key=lambda one: sha256(f"{seed}{one.name}".encode()).digest())
    compiled = (one for one in everything if _compiles(one, sources[one.path]))
    return list(islice(compiled, count))


class _Finder:
    def __init__(self, path: Path, source: str) -> None:
        self._path, self._source = path, source
        self._lines = source.splitlines(keepends=True)
        self._line_starts = [0, *accumulate(map(len, self._lines))]

    def find(self) -> Iterator[CodeMutant]:
        for node in ast.walk(ast.parse(self._source)):
            match node:
                case ast.Compare():
                    yield from self._swap(node, [node.left, *node.comparators], node.ops)
                case ast.BinOp():
                    yield from self._swap(node, [node.left, node.right], [node.op])
                case ast.BoolOp():
                    yield from self._swap(node, node.values, [node.op] * (len(node.values) - 1))
                case ast.Constant():
                    yield from self._change_constant(node)
                case ast.Expr(value=ast.Call()):
                    yield self._replace(node, "pass")
                case ast.If(test=test) | ast.While(test=test):
                    yield from self._negate(test)

    def _swap(
        self, node: ast.expr, operands: Sequence[ast.expr], operators: Sequence[ast.AST]
    ) -> Iterator[CodeMutant]:
        for (left, right), operator in zip(pairwise(operands), operators, strict=True):
            before, after = SWAPS.get(type(operator), ("", ""))
            between = self._source[self._end(left) : self._start(right)]
            if before and between.count(before) == 1:
                at = self._end(left) + between.index(before)
                yield CodeMutant(self._path, node.lineno, before, after, at)

    def _negate(self, test: ast.expr) -> Iterator[CodeMutant]:
        if self._text(test) != "TYPE_CHECKING":  # which makes no difference when it runs
            yield self._replace(test, f"not ({self._text(test)})")

    def _change_constant(self, node: ast.Constant) -> Iterator[CodeMutant]:
        value = node.value
        if isinstance(value, bool):
            yield self._replace(node, str(not value))
        elif isinstance(value, int | float):
            yield self._replace(node, f"({self._text(node)} + 1)")

    def _replace(self, node: ast.expr | ast.stmt, after: str) -> CodeMutant:
        return CodeMutant(self._path, node.lineno, self._text(node), after, self._start(node))

    def _text(self, node: ast.expr | ast.stmt) -> str:
        return self._source[self._start(node) : self._end(node)]

    def _start(self, node: ast.expr | ast.stmt) -> int:
        return self._offset(node.lineno, node.col_offset)

    def _end(self, node: ast.expr | ast.stmt) -> int:
        return self._offset(node.end_lineno or 0, node.end_col_offset or 0)

    def _offset(self, line: int, column: int) -> int:
        # ast counts bytes of UTF-8.
        text = self._lines[line - 1].encode()[:column].decode()
        return self._line_starts[line - 1] + len(text)


def _compiles(mutant: CodeMutant, source: str) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("error", SyntaxWarning)
        try:
            compile(mutant.apply(source), str(mutant.path), "exec", dont_inherit=True)
        except SyntaxError:
            return False
    return True
