"""The way of every fish of a zoo, from a wrong first guess to targets in the pool, unattended.

A fish stands in the virtual pool. It is recorded, identified, trained, evaluated, and swims in real
time through emulated devices, by the verbs that a user types, each with its defaults. A hand-made
steering rule swims to the same targets as its policy. What a verb refuses stays in the table with
its sentence.
"""

import json
import shutil
import time
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tailbeat.control.policy import load_policy
from tailbeat.evaluate.evaluation import read
from tailbeat.evaluate.reach import OPEN
from tailbeat.evaluate.store import read_json, read_record
from tailbeat.evaluate.zoo import COUNT, SERVO, Animal, animals, guess
from tailbeat.files import BadInput, write_json
from tailbeat.fish.proportions import Given
from tailbeat.fish.store import load_fish
from tailbeat.processes import end, start_verb
from tailbeat.train.progress import begun

Say = Callable[[str], None]
RUN = "zoo-run.json"  # what a folder was asked for
STEPS = ("new-fish", "record", "identify", "train", "evaluate", "rule", "swim")
CRANK_STEPS = ("train", "evaluate")  # described already; no driver turns a motor without end
TOUR = 4  # targets of the swim in real time, through camera, network, servo and IMU
# To see in minutes that all steps fit together: few recordings, a short search, and a training too
# short for a policy that swims well.
QUICK = {
    "servo": ("servo-chirp", "servo-steps", "servo-triangle", "servo-beat"),
    "fluid": ("fluid-02", "fluid-06", "fluid-28-turn"),
}
QUICK_IDENTIFY, QUICK_TRAIN = (
    ("--zones", "1", "--generations", "1", "--iterations", "2", "--draws", "2"),
    ("--recipe", "smoke", "--hours", "0.001"),
)
CRANK = "crank-fish"  # shipped; no test bench for a motor that turns on, so not identified
RULE = "rule.onnx"
DONE, REFUSED = (0, 1), 2  # exit codes; 1: done, but not all met. Others: interrupted
UNDECIDED = "not decided"  # in the source of an identified number


@dataclass(frozen=True)
class ZooConfig:
    """Which fish of a `seed` (None: all), into which folder `out`; swims of the evaluation; with
    `quick` few swims, a short search and a training of seconds."""

    out: Path
    seed: int = 0
    only: tuple[int, ...] | None = None
    targets: int = 100
    quick: bool = False


@dataclass(frozen=True)
class Step:
    """One step: time that it took [s], exit code, and the last line that it printed."""

    seconds: float
    code: int
    said: str


@dataclass(frozen=True)
class Outcome:
    """What became of a fish.

    The steps by name; its length [m], mass [kg], hinges and servo; how many numbers of tail and
    servo were called decided, and how many of these intervals hold the fish's own number; stages
    passed, updates; of the targets in the pool the fraction reached (None: not swum) within
    `arrival_m`, by its policy and by the hand-made `ruled`, and how many of its policy's swims were
    `lost`: diverged, or out of range; of the targets of the tour in real time how many.
    """

    name: str
    steps: dict[str, Step]
    length: float | None = None
    mass: float | None = None
    hinges: int | None = None
    servo: str = ""
    decided: int = 0
    held: int = 0
    stages: int = 0
    updates: int = 0
    reached: float | None = None
    interval: tuple[float, float] | None = None
    lost: int | None = None
    ruled: float | None = None
    arrival_m: float | None = None
    toured: int | None = None


def zoo(config: ZooConfig, say: Say) -> tuple[Outcome, ...]:
    """Take every fish along the whole way; a finished step is not repeated, and the table is
    written after every fish. Raises BadInput for a number that no fish has, or no targets."""
    if wrong := sorted(set(config.only or ()) - set(range(COUNT))):
        raise BadInput(f"--only {wrong[0]}: allowed are 0 to {COUNT - 1}.")
    if config.targets < 2:  # as an evaluation wants
        raise BadInput(f"--targets {config.targets}: give 2 or more.")
    _begin(config)
    chosen = [
        (number, one)
        for number, one in enumerate(animals(config.seed))
        if config.only is None or number in config.only
    ]
    found: list[Outcome] = []
    for number, animal in chosen:
        found.append(_taken(animal, config, number, say))
        write_json(config.out / "zoo.json", {"fish": found}, overwrite=True)
    return tuple(found)


def _begin(config: ZooConfig) -> None:
    """Write what the folder's steps are asked for. Raises BadInput if that was something else."""
    path, asked = config.out / RUN, {"seed": config.seed, "targets": config.targets}
    if not path.is_file():
        write_json(path, asked)
        return
    held = read_json(path)
    for name, value in asked.items():
        if held.get(name) != value:
            raise BadInput(
                f"{config.out}: was begun with --{name} {held.get(name)}, now {value}; use the"
                f" same, or a new folder."
            )


def _taken(animal: Animal, config: ZooConfig, number: int, say: Say) -> Outcome:
    folder = config.out / (f"{animal.name}-quick" if config.quick else animal.name)
    steps: dict[str, Step] = {}
    folder.mkdir(parents=True, exist_ok=True)
    for name in STEPS if animal.given else CRANK_STEPS:
        steps[name] = _step(animal, name, config, number, folder)
        say(f"{animal.name} {name}: {steps[name].seconds:.0f} s, exit code {steps[name].code}")
        if steps[name].code not in DONE:
            break
    return outcome(animal, folder, steps)


def _step(animal: Animal, name: str, config: ZooConfig, number: int, folder: Path) -> Step:
    """Take one step, or read what came of it before."""
    kept = folder / f"{name}.json"
    if kept.is_file():
        return read_record(Step, kept)
    _clear(name, folder)
    began, last = time.monotonic(), Step(0.0, 0, "")
    for words in commands(animal, name, config, folder):
        code, said = _typed(words, folder / f"{name}.log")
        last = Step(time.monotonic() - began, code, said)
        if code:
            break
    if name == "new-fish" and not last.code:
        guess(folder / "lab.toml", folder / "guess.toml", 100 * config.seed + number)
    if last.code in (*DONE, REFUSED):  # an interrupted one is taken up again
        write_json(kept, last, overwrite=True)
    return last


def _clear(name: str, folder: Path) -> None:
    """Remove what an interrupted step has left, if its verbs would not go on from it."""
    if name == "new-fish":
        (folder / "lab.toml").unlink(missing_ok=True)
    if name == "record":
        for left in ("data", "commands"):
            shutil.rmtree(folder / left, ignore_errors=True)
    if name == "swim":
        (folder / "tour.json").unlink(missing_ok=True)
    if name == "rule":
        (folder / RULE).unlink(missing_ok=True)


def commands(animal: Animal, name: str, config: ZooConfig, folder: Path) -> list[list[str]]:
    """What a user types in a step."""
    lab, mine, data = (str(folder / one) for one in ("lab.toml", "mine.toml", "data"))
    if animal.given is None:
        lab = mine = CRANK
    run, policy = folder / "train", str(folder / "train" / "policy.onnx")
    again = ["--resume"] if begun(run) else []
    first = str(folder / "guess.toml")
    return {
        "new-fish": [_new_fish(animal.given, lab)] if animal.given else [],
        "record": _record(lab, data, folder / "commands" if config.quick else None),
        "identify": [["identify", "all", "--fish", first, "--from", data, "--out", mine,
                      *(QUICK_IDENTIFY if config.quick else ())]],
        "train": [["train", "--fish", mine, "--out", str(run),
                   *again, *(QUICK_TRAIN if config.quick else ())]],
        "evaluate": [_evaluate(policy, lab, config.targets, folder / "evaluation")],
        "rule": [["policy", "rule", "--fish", mine, "--out", str(folder / RULE)],
                 _evaluate(str(folder / RULE), lab, config.targets, folder / "ruled")],
        "swim": [["swim", "--headless", "--policy", policy, "--pool-fish", lab, "--targets",
                  str(TOUR), "--out", str(folder / "swim"), "--json", str(folder / "tour.json")]],
    }[name]  # fmt: skip


def _evaluate(policy: str, lab: str, targets: int, out: Path) -> list[str]:
    words = ["evaluate", policy, "--fish", lab, "--tasks", "reach"]
    return [*words, "--episodes", str(targets), "--out", str(out)]


def _record(lab: str, data: str, commands: Path | None) -> list[list[str]]:
    """All three recordings; with a folder for the protocol's `commands`, a few of them."""
    typed = [["record", kind, "--fish", lab, "--out", data] for kind in ("tail", "servo", "fluid")]
    if commands is None:
        return typed
    short = typed[:1]
    for words, (kind, chosen) in zip(typed[1:], QUICK.items(), strict=True):
        short.append(["protocol", kind, "--fish", lab, "--out", str(commands)])
        short.append([*words, "--commands", *(str(commands / f"{name}.csv") for name in chosen)])
    return short


def _new_fish(one: Given, path: str) -> list[str]:
    words = ["--length", f"{one.length:g}", "--mass", f"{one.mass:g}", "--hinges", f"{one.hinges}"]
    words += ["--servo", one.servo]
    return ["new-fish", path, *words, *(["--k-eff", f"{one.k_eff:g}"] if one.k_eff else [])]


def _typed(words: Sequence[str], log: Path) -> tuple[int, str]:
    """Run a verb, on every core as for a user; returns its exit code and the last line of its
    output, which goes to `log`."""
    with log.open("a", encoding="utf-8") as kept:
        kept.write(f"$ tailbeat {' '.join(words)}\n")
        kept.flush()
        process = start_verb(words, every_core=True, stdout=kept, stderr=kept)
        try:
            code = process.wait()
        finally:
            end(process)
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    return code, next((one.strip() for one in reversed(lines) if one.strip()), "")


# ---- what came of it ----------------------------------------------------------------------------


def outcome(animal: Animal, folder: Path, steps: dict[str, Step]) -> Outcome:
    """Read what came of a fish from its folder."""
    found = Outcome(animal.name, steps)
    if (one := animal.given) is not None:
        found = Outcome(animal.name, steps, one.length, one.mass, one.hinges, one.servo)
    if (folder / "mine.toml").is_file():
        held = intervals_hold(folder / "lab.toml", folder / "mine.toml")
        found = replace(found, decided=len(held), held=sum(held.values()))
    if (folder / "train" / "policy.onnx").is_file():
        contract = load_policy(folder / "train" / "policy.onnx").contract
        passed, updates = (int(contract.training[name]) for name in ("stages_passed", "updates"))
        found = replace(found, stages=passed, updates=updates, arrival_m=contract.measure.arrival)
    if steps.get("evaluate") and steps["evaluate"].code == 0:
        rates = read(folder / "evaluation").reach[OPEN]
        reached, interval = rates.arrived, rates.arrived_interval
        found = replace(found, reached=reached, interval=interval, lost=rates.lost)
    if steps.get("rule") and steps["rule"].code == 0:
        found = replace(found, ruled=read(folder / "ruled").reach[OPEN].arrived)
    if (folder / "tour.json").is_file():
        toured = json.loads((folder / "tour.json").read_text(encoding="utf-8"))["arrived"]
        found = replace(found, toured=toured)
    return found


def intervals_hold(lab: Path, mine: Path) -> dict[str, bool]:
    """Of each number of servo and tail that is called decided in the fish file `mine`, whether its
    95 % interval holds the number of the fish in the pool, `lab`."""
    fish, found = load_fish(lab), tomllib.loads(mine.read_text(encoding="utf-8"))
    servo = found["servos"][found["servo"]]
    pairs = {name: (servo.get(name), getattr(fish.servos[fish.servo], name)) for name in SERVO}
    pairs["k_eff"] = found["tail"].get("k_eff"), fish.tail.k_eff
    return {
        name: one["interval"][0] <= true <= one["interval"][1]
        for name, (one, true) in pairs.items()
        if isinstance(one, dict) and "interval" in one and UNDECIDED not in one["source"]
    }
