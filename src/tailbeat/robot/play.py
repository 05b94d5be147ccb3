"""Play command files on a real servo, one after the other, and write what was recorded."""

import contextlib
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from tailbeat import __version__
from tailbeat.files import BadInput, refuse_existing
from tailbeat.fish.description import Fish, Hardware
from tailbeat.fish.store import hardware_of, load_fish
from tailbeat.link import datagrams as link
from tailbeat.recording import Recording, read_recordings, write_recording
from tailbeat.robot import safety, servo, watchdog
from tailbeat.robot.devices import Line
from tailbeat.robot.doctor_devices import check_before_driving
from tailbeat.robot.player import Player

Say = Callable[[str], None]
SWIMS = ("fluid-", "check-")  # names of commands that need the camera's poses
BENCH = ("tail-", "servo-")  # names of commands that are played without


@dataclass(frozen=True)
class Station:
    """Where poses come from: our address, the station's, and the file of the shared key."""

    listen: tuple[str, int]
    station: tuple[str, int]
    key: Path


@dataclass(frozen=True)
class PlayConfig:
    """The fish (its motor's range and its `[hardware]` count), the servo's port, the folder of the
    recordings, the station of the camera (None: no poses), and how long to wait before each
    recording [s], for calm water."""

    fish: str
    servo: str
    out: Path
    station: Station | None = None
    rest: float = 1.0


@dataclass(frozen=True)
class Played:
    """A recording: its file, rows, length [s], and how many commands have no row."""

    recording: Path
    rows: int
    seconds: float
    missing: int


def play(config: PlayConfig, commands: Sequence[Path], say: Say) -> list[Played]:
    """Play every command file, and write a recording of its name into the folder. What was played
    before something ended it stays. Raises BadInput, also if a rule of `safety` was broken."""
    fish = load_fish(config.fish)
    todo = [checked(one, fish, config) for one in read_recordings(commands)]
    for one in todo:
        refuse_existing(_path(config, one))
    hardware, done = hardware_of(fish), list[Played]()
    with _ready(config, hardware) as player, _stoppable(player):
        for one in todo:
            say(f"{one.name}: {one.time[-1] - one.time[0]:.0f} s")
            swim = config.station is not None and not one.name.startswith(BENCH)
            made = player.play(one, config.rest, swim)
            done.append(_written(config, one, made, hardware))
    return done


def checked(commands: Recording, fish: Fish, config: PlayConfig) -> Recording:
    """Commands that this fish may play. Raises BadInput."""
    if fish.motor.range is None:
        raise BadInput(f"{fish.name}: its motor turns without end; only a servo plays commands.")
    if "command_rad" not in commands.columns:
        raise BadInput(
            f"{commands.name}: column command_rad is missing; give a file of `tailbeat protocol`."
        )
    (low, high), command = fish.motor.range, commands.columns["command_rad"]
    if command.min() < low or command.max() > high:
        raise BadInput(
            f"{commands.name}: command_rad reaches {command.min():.3f} to {command.max():.3f} rad,"
            f" {fish.name} allows {low:.3f} to {high:.3f}; write the protocol with this fish."
        )
    if commands.name.startswith(SWIMS) and config.station is None:
        raise BadInput(
            f"{commands.name}: a swim needs the camera's poses; give --listen, --station and --key,"
            f" or --emulated."
        )
    return commands


def _path(config: PlayConfig, commands: Recording) -> Path:
    return config.out / f"{commands.name.replace('/', '-')}.csv"


@contextlib.contextmanager
def _ready(config: PlayConfig, hardware: Hardware) -> Iterator[Player]:
    """An open servo, guarded by the watchdog process, and the station's link."""
    with contextlib.ExitStack() as stack:
        line = None
        if config.station is not None:
            asked = config.station
            receiver = link.Receiver(link.read_key(asked.key))
            line = Line(receiver, stack.enter_context(link.bind(*asked.listen)), asked.station)
        motor = servo.connect(config.servo, hardware)
        stack.callback(motor.close)
        check_before_driving(config.servo, motor, hardware)
        watcher = stack.enter_context(watchdog.guard(config.servo, families=[hardware.family]))
        player = Player(motor, watcher, safety.limits_for(hardware), line)
        try:
            yield player
        finally:
            if not player.torque.owing:
                watcher.farewell()


@contextlib.contextmanager
def _stoppable(player: Player) -> Iterator[None]:
    """Ctrl-C and SIGTERM stop the player: torque goes off in the next period."""

    def stop(number: int, _: object) -> None:
        player.stop_asked = "the operator"

    ends = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, stop) for number in ends}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _written(
    config: PlayConfig, commands: Recording, made: Recording, hardware: Hardware
) -> Played:
    """Write a recording, with where it is from. Raises BadInput if it has no rows."""
    path, missing = _path(config, commands), commands.time.size - made.time.size
    if made.time.size < 2:
        raise BadInput(f"{made.name}: the camera saw the fish in none of its rows.")
    told = {
        "source": f"tailbeat {__version__} play",
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "servo_model": hardware.model,
    }
    write_recording(replace(made, meta={**made.meta, **told}), path)
    return Played(path, made.time.size, float(made.time[-1] - made.time[0]), missing)
