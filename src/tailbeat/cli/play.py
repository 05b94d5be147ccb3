"""Play a protocol's commands on the real servo."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tailbeat.cli import output
from tailbeat.cli.extras import need_robot
from tailbeat.cli.options import FishOption, JsonOption, SeedOption
from tailbeat.files import BadInput, check_json, need, put_json
from tailbeat.link.addresses import address

if TYPE_CHECKING:
    from tailbeat.robot.play import Played, Station


def play(
    commands: Annotated[list[Path], typer.Argument(help="Files of `tailbeat protocol`.")],
    fish: FishOption,
    out: Annotated[Path, typer.Option("--out", help="Folder of the recordings.")],
    servo: Annotated[str, typer.Option(help="Serial port of the servo.")] = "",
    listen: Annotated[str, typer.Option(help="host:port on which to listen for poses.")] = "",
    station: Annotated[str, typer.Option(help="host:port of the station.")] = "",
    key: Annotated[Path | None, typer.Option("--key", help="File of the shared key.")] = None,
    emulated: Annotated[
        bool, typer.Option("--emulated", help="Start emulated devices and play on them.")
    ] = False,
    rest: Annotated[
        float, typer.Option(help="Wait before each recording [s], for calm water.")
    ] = 1.0,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Play commands on the fish's servo and record shaft and, of swims, poses. The tail moves."""
    need_robot()
    need("playing", "polars")
    from tailbeat.robot import play as player
    from tailbeat.robot import timing

    check_json(json)
    if not 0 <= rest <= 3600:
        raise BadInput(f"--rest {rest:g}: give 0 to 3600 s.")
    timing.claim()  # real-time priority, if it is allowed
    if emulated:
        done = _emulated(fish, seed, commands, out, rest)
    else:
        where = _station(listen, station, key)
        if not servo:
            raise BadInput("play: give --servo, or --emulated.")
        config = player.PlayConfig(fish, servo, out, where, rest)
        done = player.play(config, commands, output.say)
    rows = [asdict(one) | {"recording": str(one.recording)} for one in done]
    output.tables({"recordings": rows})
    put_json(json, {"recordings": rows})


def _station(listen: str, station: str, key: Path | None) -> "Station | None":
    """The station of the camera, if it is given. Raises BadInput."""
    from tailbeat.robot.play import Station

    if not (listen or station or key):
        return None
    if not (listen and station and key):
        raise BadInput("play: give all of --listen, --station and --key, or none of them.")
    return Station(address(listen, "--listen"), address(station, "--station"), key)


def _emulated(fish: str, seed: int, commands: list[Path], out: Path, rest: float) -> "list[Played]":
    """Play on emulated devices: a servo on a pseudo-terminal, poses over the network."""
    from tailbeat.emulators.own_devices import own_devices
    from tailbeat.robot.play import PlayConfig, Station, play

    with own_devices(fish, seed, say=output.say) as (ports, key):
        where = Station(ports.listen, ports.station, key)
        return play(PlayConfig(fish, ports.servo, out, where, rest), commands, output.say)
