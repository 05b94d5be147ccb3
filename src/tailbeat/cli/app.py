"""The command `tailbeat`: its verbs, its options that take lists, its exit codes."""

import sys

import typer

from tailbeat.cli import (
    camera,
    check,
    describe,
    evaluate,
    identify,
    learn,
    measure,
    output,
    swim,
)
from tailbeat.cli.renamed import refuse_old_names
from tailbeat.files import EXTRA_OF, BadInput, missing

app = typer.Typer(
    name="tailbeat",
    help="From bench recordings of a soft robotic fish to a twin that swims like it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.add_typer(identify.identify, name="identify")
app.add_typer(measure.importing, name="import")
app.add_typer(learn.policy, name="policy")
for verb in (
    learn.train,
    swim.swim,
    evaluate.evaluate,
    evaluate.compare,
    evaluate.report,
    swim.key,
    swim.emulate,
    swim.drive,
    swim.export,
    camera.tags,
    camera.calibrate,
    camera.track,
    camera.camera,
    swim.station,
    check.faults,
    check.latency,
    check.torque_off,
    check.doctor,
    check.unit,
    describe.new_fish,
    describe.show,
    measure.protocol,
    measure.record,
    identify.speed_map,
    identify.predict,
    identify.coverage,
    evaluate.benchmark,
):
    app.command(verb.__name__.replace("_", "-"))(verb)

# options that take any number of values; a servo's port, elsewhere, is one
LISTS = {"--fit": "identify", "--validate": "identify", "--commands": "record"}
LISTS |= {"--servo": "speed-map", "--tasks": "evaluate", "--only": "faults"}
LISTS |= {"--against": "coverage", "--fitted-on": "predict"}


def spread_lists(arguments: list[str]) -> list[str]:
    """`--fit A B` as `--fit A --fit B`, the only way the parser takes lists."""
    spread: list[str] = []
    option = None
    for word in arguments:
        if word.startswith("-"):
            option = word if LISTS.get(word) == arguments[0] else None
        elif option is not None and spread[-1] != option:
            spread.append(option)
        spread.append(word)
    return spread


def main() -> None:
    """Entry point: bad input is one sentence and exit code 2."""
    try:
        refuse_old_names(sys.argv[1:])
        app(args=spread_lists(sys.argv[1:]), standalone_mode=True)
    except BadInput as error:
        output.complain(str(error))
        sys.exit(2)
    except ModuleNotFoundError as error:
        if error.name not in EXTRA_OF:
            raise
        output.complain(f"this verb needs {missing(error.name)}")
        sys.exit(2)
    except KeyboardInterrupt:
        resumes = sys.argv[1:2] == ["identify"]
        again = "; the same command takes the search up where it stopped." if resumes else "."
        output.complain(f"interrupted{again}")
        sys.exit(130)
