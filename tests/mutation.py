"""Mutation testing: change the code in one place at a time and see whether a test notices.

`python tests/mutation.py [room …] [--sample N] [--seed 0]` prints the mutants that no test noticed,
those that only the time limit ended, and how many a test noticed. A mutant swaps an operator, adds
1 to a number, turns a truth value over, removes a `not` or a sign, or leaves out a `raise` or a
call. Skipped is what cannot change a result: annotations, decorators, messages, `__all__`, blocks
for type checkers, and `strict=` of `zip`, which only guards against our own mistakes.

It needs no other copy of the code: each mutant is compiled in a forked process, which runs the
room's tests, the quickest first, up to the first failure. The limit is one of CPU time, or of sleep
without a break, so that a busy machine meets neither sooner. After every 25 mutants the unchanged
code runs too: a test that fails there fails by chance, and that room's numbers are worth nothing.

Why not a tool? `mutmut` 3.8 changes functions only, so neither the limits of `robot/safety.py` nor
its rules. `cosmic-ray` 8.7 starts Python anew for each mutant (5 s of CPU for a room of 0.1 s) and
has no limit but one of wall time.
"""

import argparse
import ast
import copy
import importlib.machinery
import importlib.util
import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType

import psutil
import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "tailbeat"
PATIENCE = 4.0  # times the CPU time of the unchanged code
HUNG = 60.0  # s of sleep without an end: a mutant that waits for ever computes nothing
QUICK_START = ("-p", "no:cacheprovider", "-p", "xdist", "--assert=plain")
MARKED = "not slow and not gpu"  # thorough tests notice what `make test` leaves to them
CHECK = 25  # mutants between two runs of the unchanged code


@dataclass(frozen=True)
class Room:
    """Files to change, and the tests that are to notice it."""

    files: tuple[str, ...]
    tests: tuple[str, ...]
    choose: str = ""  # pytest's -k
    needs: tuple[str, ...] = ("numpy",)  # imported once, before the forks


LEARNING = ("onnx", "onnxruntime", "pydantic", "mujoco", "numba", "gymnasium", "stable_baselines3")
ROOMS = {
    "search": Room(
        ("identify/search.py", "identify/polish.py", "identify/space.py", "identify/intervals.py"),
        ("test_fit.py", "test_search.py"),
        needs=("numpy", "scipy.stats", "cma"),
    ),
    "safety": Room(("robot/safety.py",), ("test_safety.py",)),
    "link": Room(
        ("link/*.py",),
        ("test_clock.py", "test_places.py", "test_link.py", "test_sender.py", "test_orders.py",
         "test_keys.py"),
        "not random",
        ("numpy", "typer", "rich"),
    ),
    "reward": Room(("env/reward.py",), ("test_reward.py",)),
    "control": Room(
        ("control/actions.py", "control/band.py", "control/network_file.py",
         "control/observation.py", "control/policy*.py", "control/runner.py"),
        ("test_control.py", "test_band.py", "test_contract.py", "test_policy_attacks.py",
         "test_runner.py", "test_turning.py", "test_camera_yaw.py"),
        # without imports alone, swims of minutes, and a training
        "not needs_neither and not steers_to and not taken_by_turning and not training_without",
        LEARNING,
    ),
    "measure": Room(
        ("control/measure.py", "control/camera_yaw.py"),
        ("test_measure.py", "test_camera_yaw.py"),
        "not training_without",
        LEARNING,
    ),
    "motion": Room(("control/motion.py",), ("test_motion.py",), needs=LEARNING),
    "signals": Room(
        tuple(f"control/{one}.py" for one in ("consistency", "expected", "load", "sign_test")),
        ("test_signal_models.py", "test_signals.py", "test_load.py", "test_expected.py"),
        "not one_period and not no_tour_of_an_everyday_lab",  # they swim for minutes
        LEARNING,
    ),
}  # fmt: skip
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


@dataclass(frozen=True)
class End:
    """How a run of a room's tests ended: `passed`, `failed` or at the `limit`; its CPU time [s]."""

    how: str
    seconds: float


# ---- what is changed ----------------------------------------------------------------------------


def changed(node: ast.AST) -> Iterator[ast.AST]:
    """What may stand in a node's place."""
    if isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in SWAPS:
        yield _with(node, op=SWAPS[type(node.op)]())
    elif isinstance(node, ast.Compare):
        for k, op in enumerate(node.ops):
            if type(op) in SWAPS:
                yield _with(node, ops=[*node.ops[:k], SWAPS[type(op)](), *node.ops[k + 1 :]])
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


def matters(node: ast.AST) -> bool:
    """Whether a change inside this node could change a result; see the module's first lines."""
    if isinstance(node, ast.Assign):
        return not any(isinstance(one, ast.Name) and one.id == "__all__" for one in node.targets)
    if isinstance(node, ast.If):
        return "TYPE_CHECKING" not in ast.unparse(node.test)
    return not (isinstance(node, ast.JoinedStr) or getattr(node, "arg", "") == "strict")


def places(node: ast.AST) -> Iterator[tuple[ast.AST, str, int | None]]:
    """Every place in running code: parent, field and index."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "exc", "msg", "decorator_list"):
            continue
        for index, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if isinstance(child, ast.AST) and matters(child):
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


def tried(room: Room, mutant: Mutant | None, seconds: float, times: Path) -> End:
    """How the room's tests end with this mutant, or without one, in this CPU time [s]."""
    child = os.fork()
    if child == 0:
        _test(room, mutant, seconds, times)
    worked = time.monotonic()
    while (done := os.wait4(child, os.WNOHANG))[0] == 0 and time.monotonic() - worked < HUNG:
        worked = time.monotonic() if _works(child) else worked
        time.sleep(0.02)
    _end_group(child)
    hung = done[0] == 0
    _, status, used = os.wait4(child, 0) if hung else done
    seconds = used.ru_utime + used.ru_stime
    if hung or os.waitstatus_to_exitcode(status) in (-signal.SIGXCPU, -signal.SIGKILL):
        return End("limit", seconds)
    return End("failed" if status else "passed", seconds)


def _works(child: int) -> bool:
    """Whether a process computes, or waits for a core: a busy machine may keep it waiting long."""
    try:
        return psutil.Process(child).status() == psutil.STATUS_RUNNING
    except psutil.NoSuchProcess:
        return False


def _end_group(child: int) -> None:
    try:
        os.killpg(child, signal.SIGKILL)
    except ProcessLookupError:
        pass


def _test(room: Room, mutant: Mutant | None, seconds: float, times: Path) -> None:
    """Run the tests in this process, with this mutant, and end it."""
    os.setpgid(0, 0)
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    resource.setrlimit(resource.RLIMIT_CPU, (max(1, round(seconds)),) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if mutant is not None:
        sys.meta_path.insert(0, Changed(mutant))
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    files = [str(ROOT / "tests" / name) for name in room.tests]
    words = [*QUICK_START, "-x", "-q", "-m", MARKED, f"--rootdir={ROOT}", *files]
    words += ["-k", room.choose] if room.choose else []
    os._exit(int(pytest.main(words, plugins=[QuickestFirst(times)])))


class QuickestFirst:
    """Orders tests by their CPU time without a mutant, which the first run writes down."""

    def __init__(self, times: Path) -> None:
        self.times, self.known = times, times.exists()
        self.took: dict[str, float] = json.loads(times.read_text()) if self.known else {}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items.sort(key=lambda item: self.took.get(item.nodeid, 0.0))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        began = time.process_time()
        result = yield
        self.took[item.nodeid] = time.process_time() - began
        return result

    def pytest_sessionfinish(self) -> None:
        if not self.known:
            self.times.write_text(json.dumps(self.took))


def measure(name: str, sample: int | None, seed: int, times: Path) -> None:
    """Print a room's mutants that no test noticed, and how many were noticed."""
    room = ROOMS[name]
    for module in ("_pytest.logging", "xdist.plugin", "xdist.scheduler", *room.needs):
        importlib.import_module(module)
    unchanged = tried(room, None, 600.0, times)
    assert unchanged.how == "passed", f"{name}: the tests fail without a mutant"
    limit = 5 + PATIENCE * unchanged.seconds
    print(f"{name}: {unchanged.seconds:.1f} s of CPU without a mutant", flush=True)
    made = [m for given in room.files for file in sorted(SOURCE.glob(given)) for m in mutants(file)]
    picked = random.Random(seed).sample(made, min(sample or len(made), len(made)))
    ends: list[str] = []
    for k, mutant in enumerate(picked, 1):
        ends.append(tried(room, mutant, limit, times).how)
        if ends[-1] != "failed":
            print(f"  {ends[-1]}  {mutant}", flush=True)
        if k % CHECK == 0:
            unchanged = tried(room, None, limit, times)
            print(f"  after {k} of {len(picked)}, without a mutant: {unchanged.how}", flush=True)
    noticed, by_limit = ends.count("failed"), ends.count("limit")
    share = 100 * noticed / len(picked)
    print(
        f"{name}: {noticed} of {len(picked)} noticed by a test ({share:.1f} %),"
        f" {by_limit} ended by the limit, {ends.count('passed')} not noticed",
        flush=True,
    )


if __name__ == "__main__":
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("rooms", nargs="*", default=[], choices=[[], *ROOMS], metavar="room")
    words.add_argument("--sample", type=int, help="mutants per room; default all")
    words.add_argument("--seed", type=int, default=0)
    asked = words.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sys.dont_write_bytecode, sys.pycache_prefix = False, folder
        for name in asked.rooms or ROOMS:
            measure(name, asked.sample, asked.seed, Path(folder) / f"{name}.json")
