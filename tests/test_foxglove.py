"""The Foxglove layout of examples/ against a log that the loop wrote: every path is in the log, and
log and schema are in what Foxglove reads. Foxglove itself is not run here."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")
pytest.importorskip("mcap", reason="the robot extra is not installed")

from mcap.reader import make_reader

from support import tailbeat
from tailbeat.robot.log import schema

LAYOUT = json.loads((Path(__file__).parents[1] / "examples/foxglove-layout.json").read_text())
PANELS = LAYOUT["configById"]
ONE_OF_US = {"Plot", "RawMessages", "StateTransitions", "Tab"}
Found = dict[str, tuple[dict[str, Any], list[dict[str, Any]]]]  # schema and messages by topic
TYPES: dict[str, Any] = {"number": int | float, "string": str, "array": list}


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Found:
    """A swim of the emulated fish: the policy swims for two seconds and more. On a busy machine the
    robot may hold before it swims; then it swims again."""
    for attempt in range(3):
        path = tmp_path_factory.mktemp("foxglove") / f"{attempt}.mcap"
        words = ("--emulated", "--log", path, "--seconds", 9)
        tailbeat("drive", "pulley-fish-pool-generator", *words)
        found = read(path)
        if sum(bool(row["action"]) for row in found["/swim"][1]) > 50:
            break
    return found


def read(path: Path) -> Found:
    """Schemas and messages of a log."""
    found: Found = {}
    with path.open("rb") as file:
        for kind, channel, message in make_reader(file).iter_messages():
            assert kind is not None and (kind.encoding, channel.message_encoding) == (
                "jsonschema",
                "json",
            )
            rows = found.setdefault(channel.topic, (json.loads(kind.data), []))[1]
            rows.append(json.loads(message.data))
    return found


def leaves(node: Any) -> Iterator[str]:
    """Panels of a layout's tree."""
    if isinstance(node, str):
        yield node
        return
    assert node["direction"] in ("row", "column") and 0 < node["splitPercentage"] < 100
    yield from leaves(node["first"])
    yield from leaves(node["second"])


def paths(panel: dict[str, Any]) -> Iterator[str]:
    """Message paths of a panel; a number is a reference line."""
    given = [*panel.get("paths", ()), *([panel["xAxisPath"]] if "xAxisPath" in panel else ())]
    values = [one["value"] for one in given] + [panel.get("topicPath", "")]
    yield from (value for value in values if value and not value[0].isdigit())


def fault(path: str, log: Found) -> str:
    """Why a message path shows nothing, or nothing."""
    matched = re.fullmatch(r"(/\w+)(?:\.(\w+)(?:\[(\d+)\])?)?", path)
    if matched is None or matched[1] not in log:
        return "no such topic"
    (kinds, rows), name, place = log[matched[1]], matched[2], matched[3]
    if name is None:
        return ""
    if name not in kinds["properties"]:
        return "not in the schema"
    values = [row[name] for row in rows if name in row]
    if place is not None:
        values = [value[int(place)] for value in values if len(value) > int(place)]
    return "" if values and not isinstance(values[0], list) else "no value in any row"


@pytest.mark.slow
@pytest.mark.realtime
def test_every_path_of_the_layout_has_values_in_a_log(log):
    used = {path for panel in PANELS.values() for path in paths(panel)}
    assert len(used) > 20
    assert not {path: why for path in sorted(used) if (why := fault(path, log))}


@pytest.mark.thorough
@pytest.mark.realtime
def test_rows_are_as_their_schema_says(log):
    kinds, rows = log["/swim"]
    assert kinds == schema() and any(row["state"] == "run" for row in rows)
    for row in rows:
        assert row.keys() <= kinds["properties"].keys()
        for name, value in row.items():
            kind = kinds["properties"][name]
            assert isinstance(value, TYPES[kind["type"]]), (name, value)
            if kind["type"] == "array":
                assert all(isinstance(one, int | float) for one in value), (name, value)


def test_the_schema_has_one_type_a_field_as_foxglove_s_parser_wants():
    """A list of types makes the parser refuse the topic: parseJsonSchema.ts, Foxglove Studio."""
    for name, field in schema()["properties"].items():
        assert field["type"] in ("number", "string", "array"), name
        assert field["type"] != "array" or field["items"] == {"type": "number"}, name


def test_the_layout_holds_together():
    tree = list(leaves(LAYOUT["layout"]))
    tabs = [tab["layout"] for panel in PANELS.values() for tab in panel.get("tabs", ())]
    shown = [*tree, *(leaf for tab in tabs for leaf in leaves(tab))]
    assert sorted(shown) == sorted(PANELS), "each panel once, none without a place"
    assert {name.split("!")[0] for name in PANELS} == ONE_OF_US
    assert LAYOUT.keys() == {
        "configById",
        "globalVariables",
        "userNodes",
        "playbackConfig",
        "layout",
    }


@pytest.mark.thorough
@pytest.mark.parametrize(
    "path", ["/swam.x_m", "/swim.x", "/swim.observation", "/swim.decided_on[18]", "/swim.x_m."]
)
@pytest.mark.realtime
def test_a_wrong_path_is_found(path, log):
    assert fault(path, log)
