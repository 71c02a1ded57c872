"""The imports between the project's files, read from their sources: anywhere in a file, also lazy or for type checkers.

Tables of "module:object" are not imports; they name records that no file imports.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path

FLOORS = ("optics", "scenes", "captures", "generator", "estimators", "benchmarks", "api")


def files_of(project: Path) -> dict[str, Path]:
    """Dotted name -> file, for every source of the package; a package's name is that of its `__init__`."""
    found = {}
    for floor in FLOORS:
        for path in sorted((project / floor).rglob("*.py")):
            parts = path.relative_to(project).with_suffix("").parts
            parts = parts[1:] if floor == "api" else parts
            found[".".join(["beambench", *(part for part in parts if part != "__init__")])] = path
    return found


def imports_of(source: str, name: str, is_package: bool, known: Mapping[str, object]) -> Iterator[tuple[int, str]]:
    """(line, dotted name) of every file of ours that a source imports."""
    package = name if is_package else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name in known:
                    yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, base] if base else above)
            for alias in node.names:
                whole = f"{base}.{alias.name}"
                if whole in known:
                    yield node.lineno, whole
                elif base in known:
                    yield node.lineno, base


def graph_of(project: Path) -> dict[str, dict[str, int]]:
    """Dotted name -> {imported name: line}."""
    files = files_of(project)
    graph: dict[str, dict[str, int]] = {}
    for name, path in files.items():
        text = path.read_text(encoding="utf-8")
        found = imports_of(text, name, path.name == "__init__.py", files)
        graph[name] = {target: line for line, target in found if target != name}
    return graph


def circles(graph: Mapping[str, Mapping[str, object]]) -> list[list[str]]:
    """Groups of files each of which reaches every other by imports (Tarjan 1972), without recursion."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    waiting: set[str] = set()
    result = []
    for root in graph:
        if root in index:
            continue
        work: list[tuple[str, Iterator[str]]] = [(root, iter(graph[root]))]
        index[root] = low[root] = len(index)
        stack.append(root)
        waiting.add(root)
        while work:
            node, targets = work[-1]
            for target in targets:
                if target not in graph:
                    continue
                if target not in index:
                    index[target] = low[target] = len(index)
                    stack.append(target)
                    waiting.add(target)
                    work.append((target, iter(graph[target])))
                    break
                if target in waiting:
                    low[node] = min(low[node], index[target])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == index[node]:
                    group = []
                    while True:
                        member = stack.pop()
                        waiting.discard(member)
                        group.append(member)
                        if member == node:
                            break
                    if len(group) > 1:
                        result.append(sorted(group))
    return result
