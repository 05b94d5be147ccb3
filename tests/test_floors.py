"""The house stands: imports go down the floors, the robot installs little, rooms stay small."""

from pathlib import Path

import pytest

from house import (
    LEVEL,
    House,
    Module,
    long_functions,
    loose_aliases,
    untyped_signatures,
    wide_functions,
)

SOURCE = Path(__file__).parents[1] / "src" / "tailbeat"
MAX_FILE_LINES, MAX_FOLDERS = 400, 2
LONG_FILE_LINES, MAX_LONG_FILES = 300, 6
MAX_WIDE_FUNCTIONS = 5  # how many may have more parameters than usual
# Where a public signature may pass a dictionary of anything, by file: results as JSON and rows of
# tables, rows of the robot's log, contents of files, other people's interfaces. All others name a
# type.
EDGES = {
    f"tailbeat.{file}.{name}"
    for file, names in {
        "cluster.plan": "as_row",
        "cluster.summary": "write_table",
        "cluster.tune": "_Told.on_trial_result",
        "control.policy": "Contract.training Contract.description",
        "env.vector_env": "FishVectorEnv.reset FishEnv.reset",
        "evaluate.replay": "as_json",
        "files": "leaves",
        "fish.check_rows": "check_tables",
        "fish.show": "tables show Shown.tables",
        "fish.store": "fish_of",
        "identify.bands": "as_rows as_json",
        "identify.chain": "Drawings.page",
        "identify.coverage_report": "as_json",
        "identify.estimate": "as_row",
        "identify.fluid_report": "as_report",
        "identify.glitch_report": "as_rows",
        "identify.kinematic": "errors_row as_json",
        "identify.launch": "tables",
        "identify.posterior": "as_rows",
        "identify.predict": "as_json row",
        "identify.servo_report": "as_report",
        "identify.step_check": "as_row",
        "identify.tail_report": "as_report",
        "importers.table": "Table.header",
        "operator.client": "OperatorClient.show OperatorClient.commands",
        "operator.replay": "snapshot Run.rows",
        "operator.snapshot": "snapshot",
        "report.first_day": "as_report",
        "report.following": "row",
        "report.html": "table values Block.rows",
        "report.identified": "page",
        "report.sweep": "kinds trials write",
        "report.tables": "as_rows",
        "report.tour": "rows",
        "robot.log": "read_rows Log.waiting Log.put Swim.rows",
        "robot.log_rows": "read_row schema",
        "robot.log_salvage": "Part.rows",
        "robot.loop": "Loop.put",
        "robot.reporter": "Reporter.report",
        "robot.results": "summarise drive_json",
        "vision.calibration": "Calibration.provenance",
    }.items()
    for name in names.split()
}


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


def test_files_of_tests_are_short() -> None:
    tests = Path(__file__).parent.glob("*.py")
    long = [f"{p.name} has {n} lines" for p in tests if (n := lines(p)) > MAX_FILE_LINES]
    assert not long, report([*long, f"{MAX_FILE_LINES} are allowed; split it by subject"])


def lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def test_few_files_are_longer_than_three_hundred_lines(house: House) -> None:
    long = [m.name for m in house.modules.values() if len(m.text.splitlines()) > LONG_FILE_LINES]
    assert len(long) <= MAX_LONG_FILES, report(long)


def test_few_functions_take_more_than_seven_parameters(house: House) -> None:
    wide = [w for m in house.modules.values() if m.room != "cli" for w in wide_functions(m)]
    assert len(wide) <= MAX_WIDE_FUNCTIONS, report([*wide, "give them one frozen config"])


def test_results_that_leave_a_room_have_a_type(house: House) -> None:
    rooms = [module for module in house.modules.values() if module.room != "cli"]
    aliases = loose_aliases(rooms)
    loose = {name for module in rooms for name in untyped_signatures(module, aliases)}
    more = sorted(loose - EDGES)
    assert not more, report([*more, "return a frozen dataclass, or list an edge in EDGES"])
    assert not EDGES - loose, f"these have a type now; take them out of EDGES: {EDGES - loose}"


def test_folders_are_at_most_two_deep() -> None:
    folders = (path.relative_to(SOURCE) for path in SOURCE.rglob("*") if path.is_dir())
    deep = [str(f) for f in folders if len(f.parts) > MAX_FOLDERS and f.name != "__pycache__"]
    assert not deep, f"more than {MAX_FOLDERS} folders deep: {deep}"
