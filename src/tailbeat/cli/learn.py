"""Inspect, compare and try policies."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from tailbeat.cli import output, progress, results
from tailbeat.cli.extras import need_training
from tailbeat.cli.options import FishOption, JsonOption, PolicyFile, SeedOption
from tailbeat.files import BadInput, check_json, put_json
from tailbeat.report.tables import as_rows

if TYPE_CHECKING:
    from tailbeat.control.camera_yaw import Source

SeenImu = Annotated[
    Literal["bno055", "none"] | None,
    typer.Option(
        "--imu",
        help="Yaw rate that the policy sees. bno055: this IMU's; none: the camera's. Default: the"
        " policy's own; a new policy's is an IMU's.",
    ),
]


def source(imu: str | None) -> "Source | None":
    """Source of the yaw rate; None if it is not given."""
    return None if imu is None else "camera" if imu == "none" else "imu"


def show(file: PolicyFile, json: JsonOption = None) -> None:
    """Print a policy's contract. Its golden pairs are checked first."""
    from tailbeat.control.policy import contract_digest, load_policy

    loaded = load_policy(file).contract
    contract, digest = asdict(loaded), contract_digest(loaded)
    results.contract(contract)
    output.say(f"digest {digest}: a refined policy names it as its parent")
    put_json(json, {"digest": digest, **contract})


def diff(
    first: PolicyFile,
    second: Annotated[str, typer.Argument(help="A second policy, .onnx, or a shipped one's name.")],
    json: JsonOption = None,
) -> None:
    """List the fields in which two policies' contracts differ. Exit code 1 if any does."""
    from tailbeat.control.contract_diff import differences
    from tailbeat.control.policy import load_policy

    found = differences(load_policy(first).contract, load_policy(second).contract)
    rows = [asdict(one) for one in found]
    results.differences(rows)
    put_json(json, rows)
    if rows:
        raise typer.Exit(1)


def try_(
    file: PolicyFile,
    fish: FishOption,
    arc: Annotated[
        float, typer.Option(help="Largest bearing of a target to either side [deg].")
    ] = 120.0,
    least_arc: Annotated[
        float,
        typer.Option(
            help="Smallest bearing of a target to either side [deg]; 165 with --arc 180: targets"
            " behind the fish."
        ),
    ] = 0.0,
    nearest: Annotated[
        float | None,
        typer.Option(help="Smallest distance [m]; default: 0.5, by the fish's measure."),
    ] = None,
    farthest: Annotated[
        float | None,
        typer.Option(help="Largest distance [m]; default: 2.5, by the fish's measure."),
    ] = None,
    targets: Annotated[int, typer.Option(help="Number of targets.")] = 1000,
    exact: Annotated[bool, typer.Option(help="Swim without noise and randomisation.")] = False,
    pools: Annotated[
        int,
        typer.Option(
            help="Number of variants of the virtual pool to swim in; 0: swim in the twin. Above 0,"
            " --fish is the fish in the pool."
        ),
    ] = 0,
    newer: Annotated[
        bool,
        typer.Option(
            "--newer", help="--fish is a newer identification of the fish it was trained on."
        ),
    ] = False,
    imu: SeenImu = None,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Swim a policy to seeded targets in its twin or in the virtual pool. Noise and randomisation
    are on in the twin, unless --exact."""
    check_json(json)
    need_training()
    from tailbeat.evaluate.seeded_trial import TrialConfig, try_policy

    where = (least_arc, nearest, farthest)
    config = TrialConfig(arc, targets, seed, exact, pools, newer, source(imu), *where)
    done = try_policy(file, fish, config)
    water = "in the virtual pool" if pools else "in the twin"
    sectors = [
        {"bearing [deg]": f"{row.low:g}-{row.high:g}", **one}
        for row, one in zip(done.sectors, as_rows(done.sectors, "low", "high"), strict=True)
    ]
    asked = {"policy": file, "least_arc_deg": least_arc, "arc_deg": arc, "pools": pools}
    asked |= {"nearest_m": nearest, "farthest_m": farthest}  # None: the task's own
    output.tables({f"{water}, by bearing": sectors})
    output.tables({water: [asked | row for row in as_rows([done], "sectors")]})
    put_json(json, asked | vars(done))


def expect(file: PolicyFile, json: JsonOption = None) -> None:
    """Write into a policy's file what its swims look like to the robot's own sensors. `drive` needs
    it for its sign test and its monitors; `train` does it at its end. The contract does not
    change."""
    check_json(json)
    need_training()
    found = _expect(file)
    put_json(json, found)


def expect_or_say(file: str, recipe: str) -> None:
    """What a new policy's swims look like; or why that is not known, which fails no training."""
    from tailbeat.train.expect import FEWER

    try:
        _expect(file, FEWER if recipe == "smoke" else None)
    except BadInput as error:
        output.say(f"{error} `drive` has no sign test for it until `tailbeat policy expect`.")


def _expect(file: str, size: tuple[int, float] | None = None) -> dict[str, Any]:
    """Swim a policy's tours, write what they show into its file, and print it."""
    from tailbeat.train.expect import FISH, SECONDS, of_file

    with progress.counting() as counted:
        told = lambda done: counted("tours", int(100 * done), 100)  # noqa: E731
        found = of_file(file, told, size or (FISH, SECONDS))
    bounds = {name: f"{value:.3g}" for name, value in asdict(found.limits).items()}
    output.tables({f"signals of {found.seconds / 60:.0f} min of tours": [bounds]})
    return asdict(found)
