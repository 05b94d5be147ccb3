"""Mutation testing: change the code in one place at a time and see whether a test notices.

`python tests/mutation.py [room …] [--sample N] [--seed 0]` prints the mutants that no test noticed
and the fraction that was noticed. It needs no other copy of the code: each mutant is compiled in a
forked process, which runs the room's tests up to the first failure.
"""

import argparse
import ast
import copy
import importlib.machinery
import importlib.util
import os
import random
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "tailbeat"
PATIENCE = 5.0  # times what the unchanged code takes: a mutant that hangs is noticed


@dataclass(frozen=True)
class Room:
    """Files to change, and the tests that are to notice it."""

    files: tuple[str, ...]
    tests: tuple[str, ...]
    choose: str = ""  # pytest's -k
    needs: tuple[str, ...] = ("numpy",)  # imported once, before the forks


ROOMS = {
    "search": Room(
        ("identify/search.py",), ("test_search.py",), needs=("numpy", "scipy.stats", "cma")
    ),
    "safety": Room(
        ("robot/safety.py",), ("test_safety_limits.py", "test_runner.py"), "not to_the_bit"
    ),
    "link": Room(("link/*.py",), ("test_link.py", "test_orders.py")),
    "reward": Room(
        ("env/reward.py",),
        ("test_learn.py", "test_train.py"),
        "reward or target",
        ("numpy", "torch", "stable_baselines3"),
    ),
    "control": Room(
        ("control/*.py",),
        ("test_control.py", "test_runner.py", "test_policy.py"),
        "not to_the_bit",
        ("numpy", "torch", "stable_baselines3", "onnx"),
    ),
}
SWAPS: dict[type, type] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.FloorDiv: ast.Div, ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One changed file: where, what stood there, what stands there now, and its syntax tree."""

    file: Path
    line: int
    before: str
    after: str
    tree: ast.Module

    def __str__(self) -> str:
        return f"{self.file.relative_to(SOURCE)}:{self.line}: {self.before}  ->  {self.after}"


# ---- what is changed ----------------------------------------------------------------------------


def changed(node: ast.AST) -> Iterator[ast.AST]:
    """What may stand in a node's place."""
    if isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in SWAPS:
        yield _with(node, op=SWAPS[type(node.op)]())
    elif isinstance(node, ast.Compare) and type(node.ops[0]) in SWAPS:
        yield _with(node, ops=[SWAPS[type(node.ops[0])](), *node.ops[1:]])
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield ast.Constant(node.value + 1)
    elif isinstance(node, ast.Raise) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    ):
        yield ast.Pass()


def _with(node: ast.AST, **fields: object) -> ast.AST:
    other = copy.copy(node)
    for name, value in fields.items():
        setattr(other, name, value)
    return other


def places(node: ast.AST) -> Iterator[tuple[ast.AST, str, int | None]]:
    """Every place in running code: parent, field and index. Types and messages are none."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "exc", "msg"):
            continue
        for index, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                yield node, name, index
                yield from places(child)


def mutants(file: Path) -> Iterator[Mutant]:
    """Every mutant of a file."""
    tree = ast.parse(file.read_text())
    for parent, name, index in places(tree):
        held = getattr(parent, name)
        node = held if index is None else held[index]
        for other in changed(node):
            _put(parent, name, index, ast.copy_location(other, node))
            whole = ast.fix_missing_locations(copy.deepcopy(tree))
            yield Mutant(file, node.lineno, ast.unparse(node), ast.unparse(other), whole)
        _put(parent, name, index, node)


def _put(parent: ast.AST, name: str, index: int | None, node: ast.AST) -> None:
    if index is None:
        setattr(parent, name, node)
    else:
        getattr(parent, name)[index] = node


# ---- whether a test notices ---------------------------------------------------------------------


class Changed(importlib.machinery.SourceFileLoader):
    """Imports a mutant instead of its file."""

    def __init__(self, mutant: Mutant) -> None:
        name = ".".join(mutant.file.relative_to(ROOT / "src").with_suffix("").parts)
        super().__init__(name.removesuffix(".__init__"), str(mutant.file))
        self.mutant = mutant

    def find_spec(self, fullname: str, *_: object) -> importlib.machinery.ModuleSpec | None:
        if fullname != self.name:
            return None
        return importlib.util.spec_from_file_location(fullname, self.path, loader=self)

    def get_code(self, fullname: str) -> CodeType:
        return compile(self.mutant.tree, self.path, "exec")


def noticed(room: Room, mutant: Mutant | None, seconds: float) -> bool:
    """Whether the room's tests fail, or take longer than that, with this mutant."""
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        _test(room, mutant)
    end = time.monotonic() + seconds
    while (done := os.waitpid(child, os.WNOHANG))[0] == 0 and time.monotonic() < end:
        time.sleep(0.02)
    _end_group(child)
    if done[0] == 0:
        os.waitpid(child, 0)
        return True
    return os.waitstatus_to_exitcode(done[1]) != 0


def _end_group(child: int) -> None:
    try:
        os.killpg(child, signal.SIGKILL)
    except ProcessLookupError:
        pass


def _test(room: Room, mutant: Mutant | None) -> None:
    if mutant is not None:
        sys.meta_path.insert(0, Changed(mutant))
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    files = [str(ROOT / "tests" / name) for name in room.tests]
    words = ["-x", "-q", "-p", "no:cacheprovider", "--no-header", f"--rootdir={ROOT}", *files]
    os._exit(int(pytest.main([*words, "-k", room.choose] if room.choose else words)))


def measure(name: str, sample: int | None, seed: int) -> None:
    """Print a room's mutants that no test noticed, and the fraction noticed."""
    room = ROOMS[name]
    for module in room.needs:
        importlib.import_module(module)
    began = time.monotonic()
    assert not noticed(room, None, 600.0), f"{name}: the tests fail without a mutant"
    patience = 10 + PATIENCE * (time.monotonic() - began)
    made = [m for given in room.files for file in SOURCE.glob(given) for m in mutants(file)]
    picked = random.Random(seed).sample(made, min(sample or len(made), len(made)))
    left = 0
    for mutant in picked:
        if not noticed(room, mutant, patience):
            left += 1
            print(f"  {mutant}", flush=True)
    share = 100 * (1 - left / len(picked))
    print(f"{name}: {len(picked) - left} of {len(picked)} noticed ({share:.0f} %)", flush=True)


if __name__ == "__main__":
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("rooms", nargs="*", default=[], choices=[[], *ROOMS], metavar="room")
    words.add_argument("--sample", type=int, help="mutants per room; default all")
    words.add_argument("--seed", type=int, default=0)
    asked = words.parse_args()
    for name in asked.rooms or ROOMS:
        measure(name, asked.sample, asked.seed)
