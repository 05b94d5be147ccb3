"""Reads the source as a house: rooms on floors, who imports whom, how long and how typed it is.

Nothing is imported here; the source is parsed, so lazy and `TYPE_CHECKING` imports count too.
"""

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from graphlib import CycleError, TopologicalSorter

# From the top down. Rooms of one entry share a floor.
FLOORS: tuple[tuple[str, ...], ...] = (
    ("__main__",),
    ("cli",),
    ("report",),
    ("benchmarks",),
    ("cluster",),
    ("evaluate",),
    ("emulators",),
    ("pool",),
    ("train",),
    ("env",),
    ("operator",),
    ("robot",),
    ("vision",),
    ("link",),
    ("control",),
    ("identify",),
    ("fish",),
    ("importers", "recording"),
    ("processes",),
    ("files",),
    ("__init__",),  # the public face: names rooms that it imports when asked; see FACE
)
# `import tailbeat` may name any room. The package itself may read nothing of it but the version.
FACE, VERSION = "tailbeat", "tailbeat.__version__"
LEVEL = {room: level for level, rooms in enumerate(FLOORS) for room in rooms}
ROBOT_NEEDS = {"numpy", "onnxruntime"}
MAX_FUNCTION_LINES, MAX_PARAMETERS = 60, 7
LOOSE = re.compile(r"\b(dict|(Mutable)?Mapping)\[str, Any\]")  # a dictionary of anything


@dataclass(frozen=True)
class Module:
    """One file: its dotted name, its text, and whether it is an `__init__.py`."""

    name: str
    text: str
    is_package: bool = False

    @cached_property
    def tree(self) -> ast.Module:
        return ast.parse(self.text)

    @property
    def room(self) -> str:
        return [*self.name.split("."), "__init__"][1]

    def absolute(self, node: ast.ImportFrom) -> str:
        """The dotted name after `from`, with leading dots resolved."""
        if not node.level:
            return node.module or ""
        parts = self.name.split(".")
        kept = parts[: len(parts) - node.level + self.is_package]
        return ".".join([*kept, *filter(None, [node.module])])

    def imports(self) -> Iterator[str]:
        """Every dotted name imported anywhere; `from a import b` gives `a.b`."""
        for node in ast.walk(self.tree):
            match node:
                case ast.Import(names=names):
                    yield from (alias.name for alias in names)
                case ast.ImportFrom(names=names):
                    yield from (f"{self.absolute(node)}.{alias.name}" for alias in names)
                case ast.Call(
                    func=ast.Name(id="import_module" | "__import__")
                    | ast.Attribute(attr="import_module"),
                    args=[ast.Constant(value=str(name)), *_],
                ):
                    yield name


class House:
    """All modules of tailbeat, and who imports whom."""

    def __init__(self, *modules: Module) -> None:
        self.modules = {module.name: module for module in modules}

    def inside(self, module: Module) -> set[str]:
        """The modules of tailbeat that `module` imports; the face imports them when asked."""
        if module.name == FACE:
            return set()
        found = (self.nearest(name) for name in module.imports() if is_ours(name))
        return set(found) - {module.name}

    def nearest(self, name: str) -> str:
        """The module that holds `name`: itself, or the longest known beginning of it."""
        while name not in self.modules and name.count(".") > 1:
            name = name.rpartition(".")[0]
        if name not in self.modules and name.count(".") == 1 and name.split(".")[1] not in LEVEL:
            return "tailbeat"  # `from tailbeat import __version__`
        return name

    def upward_imports(self) -> list[str]:
        """One line for each import that climbs."""
        return [
            f"{module.name} imports {target}, which is {room_of(target)!r}, a floor above "
            f"{module.room!r}; pass it in as an argument, or move it down"
            for module in self.modules.values()
            for target in sorted(self.inside(module))
            if LEVEL.get(room_of(target), len(FLOORS)) < LEVEL.get(module.room, 0)
        ]

    def through_the_face(self) -> list[str]:
        """One line for each import of a public name where the room's own is meant."""
        return [
            f"{module.name} imports {name} through the public face; import it from its room"
            for module in self.modules.values()
            for name in module.imports()
            if is_ours(name) and self.nearest(name) == FACE != module.name and name != VERSION
        ]

    def cycle(self) -> list[str]:
        """The modules of one circle of imports, or none."""
        graph = {name: self.inside(module) for name, module in self.modules.items()}
        try:
            TopologicalSorter(graph).prepare()
        except CycleError as error:
            return list(reversed(error.args[1]))
        return []

    def packages_reached(self, start: str) -> dict[str, str]:
        """Third-party packages that importing `start` may load, and the module that does."""
        reached: dict[str, str] = {}
        seen: set[str] = set()
        ahead = {start}
        while ahead:
            name = ahead.pop()
            seen.add(name)
            if name not in self.modules:
                continue
            module = self.modules[name]
            parents = {name.rsplit(".", i)[0] for i in range(1, name.count(".") + 1)}
            ahead |= (self.inside(module) | parents) - seen
            for imported in module.imports():
                top = imported.split(".")[0]
                if not is_ours(imported) and top not in sys.stdlib_module_names:
                    reached.setdefault(top, name)
        return reached

    def robot_extras(self) -> list[str]:
        """One line for each package that `control` reaches and the robot does not install."""
        return [
            f"{name} reaches {package} through {through}; control/ may use only "
            f"{sorted(ROBOT_NEEDS)} and the standard library"
            for name, module in self.modules.items()
            if module.room == "control"
            for package, through in sorted(self.packages_reached(name).items())
            if package not in ROBOT_NEEDS
        ]


def is_ours(name: str) -> bool:
    return name.split(".")[0] == "tailbeat"


def room_of(name: str) -> str:
    return Module(name, "").room


def long_functions(module: Module) -> list[str]:
    return [
        f"{module.name}.{node.name} has {lines} lines; {MAX_FUNCTION_LINES} are allowed"
        for node in ast.walk(module.tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        if (lines := (node.end_lineno or node.lineno) - node.lineno + 1) > MAX_FUNCTION_LINES
    ]


def parameters(node: ast.FunctionDef | ast.AsyncFunctionDef) -> list[ast.arg]:
    """What a caller gives: `self` and `cls` are left out."""
    given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    return [one for one in given if one.arg not in ("self", "cls")]


def wide_functions(module: Module) -> list[str]:
    return [
        f"{module.name}.{node.name} has {count} parameters"
        for node in ast.walk(module.tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        if (count := len(parameters(node))) > MAX_PARAMETERS
    ]


def untyped_signatures(module: Module, aliases: frozenset[str] = frozenset()) -> list[str]:
    """Public functions, methods and fields that pass a dictionary of anything, by its own name or
    by one of the `aliases`, full names of what stands for it."""
    names = {name.rpartition(".")[2] for name in module.imports() if name in aliases}
    names |= {name for name in own_aliases(module) if f"{module.name}.{name}" in aliases}
    return [
        f"{module.name}.{name}"
        for name, hints in public_hints(module.tree)
        if any(is_loose(hint, names) for hint in hints)
    ]


def public_hints(tree: ast.Module) -> Iterator[tuple[str, list[ast.expr | None]]]:
    """Qualified name and annotations of every public function, method and field."""
    classes = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    owners = [("", tree.body), *((f"{one.name}.", one.body) for one in classes)]
    for stem, inside in owners:
        for node in inside:
            match node:
                case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                    if not name.startswith("_"):
                        hints = [one.annotation for one in parameters(node)]
                        yield stem + name, [*hints, node.returns]
                case ast.AnnAssign(target=ast.Name(id=name)) if stem:
                    yield stem + name, [node.annotation]


def own_aliases(module: Module) -> Iterator[str]:
    """What a module sets to a dictionary of anything: `Row = dict[str, Any]`."""
    for node in module.tree.body:
        if isinstance(node, ast.Assign) and LOOSE.search(ast.unparse(node.value)):
            yield from (target.id for target in node.targets if isinstance(target, ast.Name))


def loose_aliases(modules: Iterable[Module]) -> frozenset[str]:
    """The full names of all `own_aliases`."""
    return frozenset(f"{m.name}.{name}" for m in modules for name in own_aliases(m))


def is_loose(hint: ast.expr | None, names: set[str]) -> bool:
    """Whether an annotation is a dictionary of anything, or one of the `names` that stand for
    it."""
    if hint is None:
        return False
    used = {node.id for node in ast.walk(hint) if isinstance(node, ast.Name)}
    return bool(LOOSE.search(ast.unparse(hint)) or used & names)
