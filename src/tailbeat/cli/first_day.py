"""Write what a lab prints before its first day at the pool."""

from pathlib import Path
from typing import Annotated

import typer

from tailbeat.cli import output
from tailbeat.cli.options import JsonOption, PolicyFile, TwinOption
from tailbeat.files import check_json, put_json, refuse_existing


def first_day(
    policy: PolicyFile,
    out: Annotated[Path, typer.Option("--out", help="Folder of the page.")],
    twin: TwinOption = None,
    evaluation: Annotated[
        Path | None, typer.Option(help="Folder of `evaluate --tasks messy`.")
    ] = None,
    margins: Annotated[Path | None, typer.Option(help="Folder of `margins`.")] = None,
    json: JsonOption = None,
) -> None:
    """Write a page to print before the first day at the pool. It has the fish, the success to
    expect in messy labs, what the policy stands, how sure the twin is, and what to check on site.
    What nobody measured is named with the command that measures it."""
    check_json(json, out, "report.html", "report.json", "figures")
    refuse_existing(out / "report.html")
    from tailbeat.control.policy import load_policy
    from tailbeat.identify import posterior
    from tailbeat.report import first_day as page
    from tailbeat.robot.fits import twin_of

    loaded = load_policy(policy)
    fish = twin_of(loaded, twin)
    doubt = posterior.at_hand(twin or loaded.contract.fish, fish)
    known = page.measured(loaded, evaluation, margins, doubt)
    output.say(f"page: {page.write(loaded, policy, fish, known, out)}")
    put_json(json, page.as_report(loaded, policy, fish, known))
