"""The checks of the house can fail: each finds the fault that it is for."""

import pytest

from house import (
    MAX_FUNCTION_LINES,
    House,
    Module,
    long_functions,
    loose_aliases,
    untyped_signatures,
    wide_functions,
)

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
    assert untyped_signatures(module) == ["tailbeat.fish.show.g", "tailbeat.fish.show.A.x"]


@pytest.mark.parametrize(
    "text",
    [
        "async def g(a: dict[str, Any]) -> str: ...",
        "def g(a: Mapping[str, Any]) -> str: ...",
        "def g(a: int, *, b: list[MutableMapping[str, Any]]) -> str: ...",
        "def g(a: 'queue.Queue[dict[str, Any]]') -> str: ...",
        "class A:\n    def g(self) -> Mapping[str, Any]: ...",
        "class A:\n    class B:\n        async def g(self) -> dict[str, Any]: ...",
        "Row = dict[str, Any]\ndef g(a: list[Row]) -> str: ...",
        "from tailbeat.files import Rows\ndef g(a: Rows) -> str: ...",
    ],
)
def test_a_loose_signature_is_found_in_every_guise(text: str) -> None:
    files = Module("tailbeat.files", "Rows = list[dict[str, Any]]")
    module = Module("tailbeat.fish.show", text)
    assert len(untyped_signatures(module, loose_aliases([files, module]))) == 1


def test_typed_and_private_signatures_pass() -> None:
    text = "def g(a: Mapping[str, int]) -> dict[str, str]: ...\ndef _h() -> dict[str, Any]: ...\n"
    module = Module("tailbeat.fish.show", text + "Row = dict[str, int]\ndef k(a: Row) -> Row: ...")
    assert not untyped_signatures(module, loose_aliases([module]))
