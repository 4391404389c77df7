"""Fail on a crowded folder, an import cycle, or a public function with the name of a module or folder beside it."""

import ast
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

PACKAGES = ("process", "stability", "smfe")
MOST_MODULES = 15

Graph = Mapping[str, set[str]]


def modules() -> dict[str, Path]:
    """Return each module by its dotted name; a package has that of its folder."""
    files = [path for package in PACKAGES for path in sorted(Path(package).rglob("*.py"))]
    return {".".join(path.with_suffix("").parts).removesuffix(".__init__"): path for path in files}


def imports(found: Mapping[str, Path]) -> Graph:
    """Return the modules that each module imports anywhere, inside functions too."""
    graph: dict[str, set[str]] = {name: set() for name in found}
    for name, path in found.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                wanted = [f"{node.module}.{alias.name}" for alias in node.names]
                graph[name] |= {full if full in found else node.module for full in wanted} & found.keys()
            elif isinstance(node, ast.Import):
                graph[name] |= {alias.name for alias in node.names} & found.keys()
    return graph


def folders(graph: Graph, packages: set[str]) -> Graph:
    """Return the folders that each folder imports from; the facades at the top, which import from everywhere, aside."""
    out: dict[str, set[str]] = defaultdict(set)
    room = {name: name if name in packages else name.rpartition(".")[0] for name in graph}
    for name, wanted in graph.items():
        out[room[name]] |= {room[other] for other in wanted} - {room[name], *PACKAGES}
    return {name: wanted for name, wanted in out.items() if name not in PACKAGES}


def cycles(graph: Graph) -> Iterator[list[str]]:
    """Yield the strongly connected components of more than one node (Tarjan)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []

    def visit(node: str) -> Iterator[list[str]]:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(graph.get(node, ())):
            if other not in index:
                yield from visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            component = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(component) > 1:
                yield component

    for node in sorted(graph):
        if node not in index:
            yield from visit(node)


def clashes(found: Mapping[str, Path], packages: set[str]) -> Iterator[str]:
    """Yield each name that a package imports from below and that a module or folder beside has, too."""
    for package in sorted(packages):
        beside = {name.rpartition(".")[2] for name in found if name.rpartition(".")[0] == package}
        tree = ast.parse(found[package].read_text(encoding="utf-8"))
        # The imports of a facade that is lazy stand below `if TYPE_CHECKING`.
        inner = [node for part in tree.body if isinstance(part, ast.If) for node in part.body]
        imported = [node for node in (*tree.body, *inner) if isinstance(node, ast.ImportFrom)]
        names = {a.asname or a.name for node in imported for a in node.names}
        names |= {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        for name in sorted(names & beside):
            yield f"{package}: '{name}' is a public name and a module or folder beside it; rename one"


if __name__ == "__main__":
    found = modules()
    packages = {name for name, path in found.items() if path.name == "__init__.py"}
    graph = imports(found)
    sizes = Counter(name.rpartition(".")[0] for name in found if name not in packages)
    complaints = [
        f"{folder.replace('.', '/')}/ holds {count} modules; at most {MOST_MODULES} are found in at a glance: split it"
        for folder, count in sorted(sizes.items())
        if count > MOST_MODULES
    ]
    complaints += [f"import cycle of modules: {', '.join(sorted(c))}" for c in cycles(graph)]
    complaints += [f"import cycle of folders: {', '.join(sorted(c))}" for c in cycles(folders(graph, packages))]
    complaints += clashes(found, packages)
    print("\n".join(complaints) or f"{len(found)} modules in {len(sizes)} folders: none crowded, no import cycle")
    sys.exit(bool(complaints))
