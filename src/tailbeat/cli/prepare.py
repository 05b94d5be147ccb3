"""Set a servo up for a fish."""

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli import output
from tailbeat.cli.extras import need_robot
from tailbeat.cli.options import FishOption, JsonOption, ServoPort
from tailbeat.files import BadInput, check_json, write_json

if TYPE_CHECKING:
    from tailbeat.robot.prepare import Change, Looked
    from tailbeat.robot.settings import Setting


def prepare(
    servo: ServoPort,
    fish: FishOption,
    ident: Annotated[
        int | None, typer.Option("--id", min=0, max=252, help="Id of the servo; default: any.")
    ] = None,
    baud: Annotated[
        int | None, typer.Option(help="Baud rate of the servo; default: all usual ones.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Write without asking.")] = False,
    json: JsonOption = None,
) -> None:
    """Set a servo up for a fish: find it, compare its registers, write those that differ. Nothing
    moves; torque goes off. It asks before it writes; without a terminal it needs --yes. Exit code 1
    if a register does not hold what was written."""
    check_json(json)
    need_robot()
    from tailbeat.fish.store import load_fish
    from tailbeat.robot import prepare as preparing

    described = load_fish(fish)
    looked = preparing.look(servo, described, ident, baud)
    found = looked.found
    output.say(f"{servo}: model number {found.number}, id {found.ident}, {found.baud} baud")
    rows = [_row(one) for one in looked.settings]
    output.tables({"registers": rows})
    changes: tuple[Change, ...] = ()
    if looked.wrong and _agreed(servo, len(looked.wrong), yes):
        changes = preparing.write(servo, described, looked)
        output.tables({"written": [_written(one) for one in changes]})
    ready = all(one.done for one in changes) if changes else not looked.wrong
    output.say(f"{servo}: {_last_words(looked, changes, ready)}")
    if json is not None:
        written = [_written(one) for one in changes]
        own = {"port": servo, "found": vars(found), "ready": ready}
        write_json(json, {**own, "registers": rows, "written": written})
    if not ready:
        raise typer.Exit(1)


def _agreed(servo: str, count: int, yes: bool) -> bool:
    """Whether the registers may be written. Raises BadInput where nobody can be asked."""
    if yes:
        return True
    if not sys.stdin.isatty():
        raise BadInput(
            f"{servo}: {count} registers differ and nothing was changed; there is no terminal to"
            f" ask at, so give --yes to write them."
        )
    return typer.confirm(f"Turn torque off and write {count} registers?")


def _row(setting: "Setting") -> dict[str, Any]:
    return {
        "name": setting.name,
        "register": setting.register[0],
        "now": setting.now,
        "wanted": setting.wanted,
    }


def _written(change: "Change") -> dict[str, Any]:
    said = "done" if change.done else change.said or "the servo did not take it"
    before = {"name": change.setting.name, "before": change.setting.now}
    return {**before, "after": change.after, "result": said}


def _last_words(looked: "Looked", changes: Sequence["Change"], ready: bool) -> str:
    """What was done, in one sentence."""
    if not looked.wrong:
        return "ready; nothing had to be changed"
    if not changes:
        return "nothing was changed"
    kept = [one.setting.name for one in changes if not one.done]
    if ready:
        return f"ready; {len(changes)} registers were written and read back"
    return f"not ready; not taken: {', '.join(kept)}"
