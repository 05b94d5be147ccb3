"""Train many policies from one file, on this machine or a cluster."""

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli import output, progress
from tailbeat.cli.extras import need_training
from tailbeat.cli.options import AddressOption, JsonOption
from tailbeat.files import BadInput, check_folder, check_json, leaves, need, put_json, write_json

if TYPE_CHECKING:
    from tailbeat.cluster.plan import Sweep, Trial
    from tailbeat.cluster.summary import SweepResult
    from tailbeat.cluster.tune import Row

PLAN = "sweep.json"
OVER = ("done", "failed", "ended early")


def sweep(
    file: Annotated[Path, typer.Argument(help="What to train, .toml.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of all trials.")],
    address: AddressOption = None,
    resume: Annotated[bool, typer.Option(help="Continue the sweep in --out.")] = False,
    json: JsonOption = None,
) -> None:
    """Train many policies from one file, try and evaluate each, and compare them. Exit code 1 if a
    trial failed or is not done."""
    check_json(json)
    need_training()
    need("sweeps", "ray")
    from tailbeat.cluster import connection, plan

    asked = plan.read(file)
    made = plan.trials(asked)
    plan.check_names(file, made)
    check_folder(out)
    if address is not None:
        connection.connect(address)
    asked, made = _kept(file, asked, made, out, resume)
    if address is None:
        connection.connect(None)
    done = _swim(asked, made, out)
    _print(out, done)
    put_json(json, done)
    if not done.complete:
        raise typer.Exit(1)


def _kept(
    file: Path, asked: "Sweep", made: Sequence["Trial"], out: Path, resume: bool
) -> tuple["Sweep", list["Trial"]]:
    """Check every trial, and write the sweep into its folder, with the fish that are files. Returns
    both with the copies. Raises BadInput before anything is written."""
    from tailbeat.cluster.trial import check_trial

    if resume:
        _check_same(file, asked, out)
        return _with_pool_copy(asked, out), [_with_copy(one, out) for one in made]
    if out.exists() and any(out.iterdir()):
        raise BadInput(
            f"{out}: contains another sweep; continue it with --resume, or choose a new folder."
        )
    for one in made:
        try:
            check_trial(one, asked, out / "trials" / one.name)
        except BadInput as error:
            raise BadInput(f"{file}: trial {one.name}: {error}") from None
    for fish in {one.fish for one in made if Path(one.fish).is_file()}:
        _copy(Path(fish), out / "fish")
    if asked.evaluate is not None and Path(asked.evaluate.fish).is_file():
        _copy(Path(asked.evaluate.fish), out / "pool")
    write_json(out / PLAN, asked.model_dump(mode="json"))
    return _with_pool_copy(asked, out), [_with_copy(one, out) for one in made]


def _copy(fish: Path, folder: Path) -> None:
    """Copy a fish and the posterior beside it: a change of either later changes no trial."""
    from tailbeat.identify.posterior import beside

    folder.mkdir(parents=True, exist_ok=True)
    for path in (fish, beside(fish)):
        if path.is_file():
            shutil.copy(path, folder / path.name)


def _with_copy(trial: "Trial", out: Path) -> "Trial":
    copy = out.resolve() / "fish" / Path(trial.fish).name
    return replace(trial, fish=str(copy)) if copy.is_file() else trial


def _with_pool_copy(asked: "Sweep", out: Path) -> "Sweep":
    """The sweep with the copy of the pool's fish: trials work in other folders."""
    if asked.evaluate is None:
        return asked
    copy = out.resolve() / "pool" / Path(asked.evaluate.fish).name
    if not copy.is_file():
        return asked
    return asked.model_copy(
        update={"evaluate": asked.evaluate.model_copy(update={"fish": str(copy)})}
    )


def _check_same(file: Path, asked: "Sweep", out: Path) -> None:
    """Raises BadInput if the folder has no sweep, or another one; names each difference. A
    field that came later had its default."""
    from tailbeat.cluster.plan import Sweep

    path = out / PLAN
    if not path.is_file():
        raise BadInput(f"{out}: no sweep to continue ({PLAN} is missing); start without --resume.")
    try:
        before = Sweep.model_validate_json(path.read_text(encoding="utf-8"), strict=False)
    except ValueError:
        raise BadInput(
            f"{path}: not a sweep that this release can read; begin anew in another folder."
        ) from None
    held, ours = (leaves("", one.model_dump(mode="json")) for one in (before, asked))
    wrong = [
        f"{name} was {held.get(name)}, now {ours.get(name)}"
        for name in sorted({*held, *ours})
        if held.get(name) != ours.get(name)
    ]
    if wrong:
        raise BadInput(f"{file}: another sweep than in {out}: {'; '.join(wrong)}.")


def _swim(asked: "Sweep", made: Sequence["Trial"], out: Path) -> "SweepResult":
    """Swim what is not done; write table and page. Prints the rule before it begins."""
    from tailbeat.cluster import connection, plan, summary, tune
    from tailbeat.report import sweep as page

    todo = [one for one in made if not (out / "trials" / one.name / summary.RESULT).is_file()]
    output.say(f"{len(made)} trials, {len(made) - len(todo)} done. Chosen is {summary.RULE}.")
    failed: dict[str, str] = {}
    seen = TrialTable(len(made), len(made) - len(todo))
    if todo:
        try:
            with _shown(seen) as report:
                failed = tune.swim(asked, todo, out, report)
        except connection.RayEnded:
            connection.abandon()
            raise
    early = [name for name, row in seen.rows.items() if row.state == "ended early"]
    done = summary.collect(out, made, failed, early)
    summary.write_table(out / "sweep.parquet", done, {t.name: plan.as_row(t) for t in made})
    page.write(out, done, asked.model_dump(mode="json"))
    return done


@dataclass
class TrialTable:
    """How far a sweep is: the number of trials, those done before, and the newest row of each."""

    trials: int
    before: int
    rows: dict[str, "Row"] = field(default_factory=dict)

    def add(self, row: "Row") -> None:
        """Take the newest row of a trial; numbers stay where a row has none."""
        last = self.rows.get(row.name)
        numbers = row.numbers or (last.numbers if last else {})
        self.rows[row.name] = replace(row, numbers=numbers)

    @property
    def over(self) -> int:
        """Number of trials that are over."""
        return self.before + sum(row.state in OVER for row in self.rows.values())

    def lines(self) -> list[dict[str, Any]]:
        """A row of the table for each trial that was begun."""
        return [
            {"trial": row.name, "state": row.state, **_rounded(row.numbers)}
            for row in self.rows.values()
        ]


def _rounded(numbers: Any) -> dict[str, Any]:
    if not numbers:
        return {"stage": None, "success [%]": None, "updates": None}
    share = round(100 * numbers["success"])
    return {
        "stage": int(numbers["stage"]),
        "success [%]": share,
        "updates": int(numbers["updates"]),
    }


@contextmanager
def _shown(table: TrialTable) -> Iterator[Any]:
    """Show a table of trials at every change of a state, with the time left."""
    count = progress.now_and_then(every=0.0)

    def report(row: "Row") -> None:
        last = table.rows.get(row.name)
        table.add(row)
        if last is None or last.state != row.state:
            output.tables({"trials": table.lines()})
            count(f"trials over: {table.over} of {table.trials}", table.over / table.trials)

    yield report


def _print(out: Path, done: "SweepResult") -> None:
    from tailbeat.report.sweep import kinds, trials

    output.tables({"trials": trials(done)})
    output.tables({"kinds, over their seeds": kinds(done)})
    if done.chosen:
        output.say(f"chosen: {out / 'trials' / done.chosen / 'run' / 'policy.onnx'}")
    output.say(f"page: {out / 'report.html'}, table: {out / 'sweep.parquet'}")
    left = [one.name for one in done.trials if one.state in ("not done", "failed")]
    if left:
        output.say(f"{len(left)} trials have no result; continue them with --resume.")
