"""The page of a policy's contract, and the page of a swim's log."""

import re
from dataclasses import MISSING, Field, fields
from typing import Any

from reference.fields import described, summary
from reference.markdown import code, page, table
from tailbeat.control.actions import Direct, Filtered, Generator
from tailbeat.control.averages import Averages
from tailbeat.control.motion import MotionFilter
from tailbeat.control.observation import Entry, as_markdown
from tailbeat.control.policy import KEY, VERSIONS, Contract, load_policy, shipped
from tailbeat.files import leaves
from tailbeat.robot import log

COLUMNS = ["field", "type", "default", "meaning"]


def contract_page() -> str:
    """Every field of the metadata in policy.onnx."""
    head = (
        f"A policy is one ONNX file. Its metadata have the key `{KEY}`: JSON with `contract` and"
        f" `digests`, one digest for each field. Its version is {VERSIONS[0]},"
        f" {VERSIONS[1]} for a policy that observes velocities, or {VERSIONS[2]} for one that"
        " observes averages too."
        " `tailbeat policy show FILE` prints it. A file whose contract does not hold is refused."
    )
    kinds = (Contract, Entry, Generator, Direct, Filtered, MotionFilter, Averages)
    return page("Policy contract", head, *map(_section, kinds), _observation(), _training())


def _section(kind: type) -> str:
    texts, given = described(kind), fields(kind)
    rows = [[code(f.name), _type(f), _default(f), texts[f.name]] for f in given]
    return "\n\n".join([f"## {kind.__name__}", summary(kind), table(COLUMNS, rows)])


def _type(field: Field[Any]) -> str:
    name = field.type.__name__ if isinstance(field.type, type) else str(field.type)
    return code(re.sub(r"\b(?:\w+\.)+", "", name))  # without the modules' names


def _default(field: Field[Any]) -> str:
    return "required" if field.default is MISSING else code(field.default)


def _observation() -> str:
    return f"## Observation table\n\nThe network's inputs in their order.\n\n{as_markdown()}"


def _training() -> str:
    """The facts of training, as a shipped policy has them."""
    name = next(iter(shipped()))
    facts = leaves("", load_policy(name).contract.training)
    rows = [[code(key), code(value)] for key, value in facts.items()]
    text = f"`training` of the shipped policy `{name}`:"
    return "\n\n".join(["## Training", text, table(["field", "value"], rows)])


def log_page() -> str:
    """Topics and fields of a log."""
    head = (
        "`tailbeat drive` and `tailbeat swim` write a log as an MCAP file, which Foxglove opens."
        f" Rows lie in the topic `{log.TOPIC}` as JSON with a schema, one row for each period of"
        " control. A number that is not finite is left out of its row."
    )
    notes = (
        f"The file's metadata `{log.NOTES}` name date, policy and fish with their digests, and the"
        " versions. `calibration` is the SHA-256 of the calibration that the station swims with; it"
        " is added as soon as the station tells it, and the last one of a name counts. At the end"
        " of a swim they hold the loop's punctuality too. `tailbeat export` makes a recording of"
        " the columns " + ", ".join(map(code, log.COLUMNS)) + ", with the metadata."
    )
    rows = [
        [code(name), kind["type"], kind["description"]]
        for name, kind in log.schema()["properties"].items()
    ]
    return page("Log", head, table(["field", "type", "meaning"], rows), notes)
