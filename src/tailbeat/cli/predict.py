"""Test what an identified fish predicts."""

from pathlib import Path
from typing import Annotated

import typer

from tailbeat.cli import identified
from tailbeat.cli.options import FishOption, JsonOption
from tailbeat.files import check_json, put_json


def predict(
    fish: FishOption,
    recordings: Annotated[
        list[Path],
        typer.Argument(help="Recordings or logs, .csv or .parquet, or an evaluation's runs/*.npz."),
    ],
    fitted_on: Annotated[
        list[Path] | None,
        typer.Option("--fitted-on", help="Recordings to fit a naive model of five numbers on."),
    ] = None,
    posterior: Annotated[
        Path | None,
        typer.Option(help="Posterior for 95 % bands; default: the one beside the fish, if any."),
    ] = None,
    check: Annotated[
        list[Path] | None,
        typer.Option("--check", help="Other swims in the same water: they make the bands fit it."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Predict recorded swims with the twin and compare with what was measured. Exit code 1 if the
    twin diverged or reached no steady speed. With --fitted-on, compare it with a naive model. With
    a posterior, give 95 % bands and count the swims inside."""
    from tailbeat.evaluate import replay

    check_json(json)
    found = replay.predict_swims(fish, recordings, fitted_on or [], posterior, check or [])
    result = replay.as_json(found)
    put_json(json, result)
    identified.predicted(result)
    if not found.settled:
        raise typer.Exit(1)


def coverage(
    swims: Annotated[
        list[Path],
        typer.Argument(
            help="A policy's swims: logs as .csv or .parquet, or an evaluation's runs/*.npz."
        ),
    ],
    against: Annotated[
        list[Path], typer.Option("--against", help="Recordings that the fish was identified on.")
    ],
    fish: FishOption,
    json: JsonOption = None,
) -> None:
    """Check whether an identification's recordings cover a policy's swims. List what to record
    next. Exit code 1 if over 5 % of a quantity is outside the recorded range."""
    from tailbeat.evaluate import replay
    from tailbeat.identify.coverage_report import as_json

    check_json(json)
    found = replay.coverage(fish, swims, against)
    result = as_json(found)
    put_json(json, result)
    identified.covered(result)
    if not found.covered:
        raise typer.Exit(1)
