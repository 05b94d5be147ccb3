"""The house stands: imports go down the floors, the robot installs little, rooms stay small.

Nothing is imported here; the source is parsed, so lazy and `TYPE_CHECKING` imports count too.
"""

import ast
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "tailbeat"

# From the top down. Rooms of one entry share a floor.
FLOORS: tuple[tuple[str, ...], ...] = (
    ("__main__",),
    ("cli",),
    ("report",),
    ("benchmarks",),
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
MAX_FILE_LINES, MAX_FUNCTION_LINES, MAX_FOLDERS = 400, 60, 2
LONG_FILE_LINES, MAX_LONG_FILES = 300, 6
MAX_PARAMETERS, MAX_WIDE_FUNCTIONS = 7, 5  # of a function, and how many may have more
# Where a result becomes JSON, TOML or rows of a table, and where other people's interfaces and
# files give dictionaries. Anywhere else a public signature names a type.
EDGES = {"as_json", "as_report", "as_row", "as_rows", "row", "rows", "errors_row", "tables",
         "toml_values", "drive_json", "schema", "read_rows", "leaves", "page", "snapshot", "show",
         "commands", "reset", "training", "description", "provenance"}  # fmt: skip


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


def untyped_signatures(module: Module) -> list[str]:
    """Public functions, methods and fields that pass a `dict[str, Any]`."""
    found = []
    for node in ast.walk(module.tree):
        match node:
            case ast.FunctionDef(name=name):
                hints = [*(one.annotation for one in parameters(node)), node.returns]
            case ast.ClassDef(body=body):
                found += [
                    f"{module.name}.{node.name}.{field.target.id}"
                    for field in body
                    if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
                    if is_loose([field.annotation]) and field.target.id not in EDGES
                ]
                continue
            case _:
                continue
        if is_loose(hints) and not name.startswith("_") and name not in EDGES:
            found.append(f"{module.name}.{name}")
    return found


def is_loose(hints: Sequence[ast.expr | None]) -> bool:
    return any(hint is not None and "dict[str, Any]" in ast.unparse(hint) for hint in hints)


def report(faults: list[str]) -> str:
    return "\n  ".join(["", *faults])


@pytest.fixture(scope="module")
def house() -> House:
    modules = []
    for path in sorted(SOURCE.rglob("*.py")):
        parts = list(path.relative_to(SOURCE.parent).with_suffix("").parts)
        is_package = parts[-1] == "__init__"
        name = ".".join(parts[:-1] if is_package else parts)
        modules.append(Module(name, path.read_text(encoding="utf-8"), is_package))
    assert modules, f"no source found in {SOURCE}"
    return House(*modules)


# The house as it is.


def test_every_room_stands_on_a_floor(house: House) -> None:
    lost = [name for name, module in house.modules.items() if module.room not in LEVEL]
    assert not lost, f"{lost} stand on no floor; move them into a room, or add the room to FLOORS"


def test_imports_go_down(house: House) -> None:
    faults = house.upward_imports()
    assert not faults, report(faults)


def test_no_room_uses_the_public_face(house: House) -> None:
    faults = house.through_the_face()
    assert not faults, report(faults)


def test_no_import_goes_in_a_circle(house: House) -> None:
    circle = house.cycle()
    assert not circle, "circle of imports: " + " -> ".join(circle)


def test_control_needs_only_what_the_robot_installs(house: House) -> None:
    faults = house.robot_extras()
    assert not faults, report(faults)


def test_files_and_functions_are_short(house: House) -> None:
    faults = [fault for module in house.modules.values() for fault in long_functions(module)]
    for module in house.modules.values():
        if (lines := len(module.text.splitlines())) > MAX_FILE_LINES:
            faults.append(f"{module.name} has {lines} lines; {MAX_FILE_LINES} are allowed")
    assert not faults, report(faults)


def test_few_files_are_longer_than_three_hundred_lines(house: House) -> None:
    long = [m.name for m in house.modules.values() if len(m.text.splitlines()) > LONG_FILE_LINES]
    assert len(long) <= MAX_LONG_FILES, report(long)


def test_few_functions_take_more_than_seven_parameters(house: House) -> None:
    wide = [w for m in house.modules.values() if m.room != "cli" for w in wide_functions(m)]
    assert len(wide) <= MAX_WIDE_FUNCTIONS, report([*wide, "give them one frozen config"])


def test_results_that_leave_a_room_have_a_type(house: House) -> None:
    loose = [w for m in house.modules.values() if m.room != "cli" for w in untyped_signatures(m)]
    assert not loose, report([*loose, "return a frozen dataclass, or list an edge in EDGES"])


def test_folders_are_at_most_two_deep() -> None:
    folders = (path.relative_to(SOURCE) for path in SOURCE.rglob("*") if path.is_dir())
    deep = [str(f) for f in folders if len(f.parts) > MAX_FOLDERS and f.name != "__pycache__"]
    assert not deep, f"more than {MAX_FOLDERS} folders deep: {deep}"


# The checker itself can fail.

TWIN = Module("tailbeat.fish.twin", "")
LOOP = Module("tailbeat.robot.loop", "")


@pytest.mark.parametrize(
    "text",
    [
        "import tailbeat.robot.loop",
        "from tailbeat.robot.loop import run",
        "from tailbeat.robot import loop",
        "from ..robot import loop",
        "def late():\n    from tailbeat.robot.loop import run",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from tailbeat.robot import loop",
        "import importlib\nimportlib.import_module('tailbeat.robot.loop')",
    ],
)
def test_an_upward_import_is_found(text: str) -> None:
    (fault,) = House(Module("tailbeat.fish.twin", text), LOOP).upward_imports()
    assert "tailbeat.fish.twin imports tailbeat.robot.loop" in fault


def test_an_import_of_a_whole_room_above_is_found() -> None:
    room = Module("tailbeat.fish", "from . import twin\nfrom tailbeat import pool", is_package=True)
    (fault,) = House(room, TWIN).upward_imports()
    assert "tailbeat.fish imports tailbeat.pool" in fault


def test_imports_downward_aside_and_of_the_version_pass() -> None:
    text = (
        "from tailbeat import __version__\nfrom tailbeat.fish import twin\nfrom .safety import stop"
    )
    loop, safety = Module("tailbeat.robot.loop", text), Module("tailbeat.robot.safety", "")
    house = House(Module("tailbeat", "", is_package=True), loop, safety, TWIN)
    assert house.inside(loop) == {"tailbeat", "tailbeat.fish.twin", "tailbeat.robot.safety"}
    assert not house.upward_imports() and not house.cycle()


def test_a_use_of_the_public_face_is_found() -> None:
    face = Module("tailbeat", "from tailbeat.fish import twin", is_package=True)
    loop = Module("tailbeat.robot.loop", "from tailbeat import load_fish, __version__")
    house = House(face, loop, TWIN)
    assert not house.inside(face) and not house.upward_imports()
    (fault,) = house.through_the_face()
    assert "tailbeat.robot.loop imports tailbeat.load_fish" in fault


def test_a_circle_is_found() -> None:
    twin = Module("tailbeat.fish.twin", "from tailbeat.fish.forces import lift")
    forces = Module("tailbeat.fish.forces", "from . import twin")
    assert set(House(twin, forces).cycle()) == {twin.name, forces.name}


def test_what_control_reaches_through_another_room_is_found() -> None:
    policy = Module("tailbeat.control.policy", "import json, numpy\nfrom tailbeat.fish import twin")
    twin = Module("tailbeat.fish.twin", "import mujoco")
    (fault,) = House(policy, twin).robot_extras()
    assert "tailbeat.control.policy reaches mujoco through tailbeat.fish.twin" in fault


def test_a_long_function_is_found() -> None:
    text = "def long():\n" + "    pass\n" * MAX_FUNCTION_LINES
    assert long_functions(Module("tailbeat.files", text))
    assert not long_functions(Module("tailbeat.files", text.replace("    pass\n", "", 1)))


def test_wide_and_loose_signatures_are_found() -> None:
    text = "def f(a, b, c, d, e, f, g, h): ...\nclass A:\n    x: dict[str, Any]\n"
    module = Module("tailbeat.fish.show", text + "def g(self, x: int) -> dict[str, Any]: ...\n")
    assert wide_functions(module) == ["tailbeat.fish.show.f has 8 parameters"]
    assert untyped_signatures(module) == ["tailbeat.fish.show.A.x", "tailbeat.fish.show.g"]
