"""What do the verbs of the trials do? Check what fits, swim, write numbers."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from datetime import datetime
from pathlib import Path
from typing import Any

from tailbeat import live_tasks
from tailbeat.control.policy import Policy, check_fits, load_policy
from tailbeat.env.simulator import PERIOD
from tailbeat.evaluate import compare as comparison
from tailbeat.evaluate import evaluation
from tailbeat.evaluate import tour as tours
from tailbeat.evaluate.live_swim import as_seen, tour_of
from tailbeat.evaluate.trial import Pool, Progress
from tailbeat.files import BadInput, write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.store import digest, load_fish
from tailbeat.pool.water import fingerprint
from tailbeat.report import page as pages
from tailbeat.report import tour as tour_figures

Counting = Callable[[], AbstractContextManager[Progress]]  # a bar on the terminal


def twin_of(policy: Policy, twin: str | None) -> Fish:
    """The fish that a policy was trained on, with the servo it had; `twin` names its file where it
    is not a shipped one."""
    contract = policy.contract
    described = load_fish(twin or contract.fish)
    variants = [described.model_copy(update={"servo": name}) for name in described.servos]
    same = [one for one in variants if digest(one) == contract.fish_digest]
    chosen = same[0] if same else described
    check_fits(contract, chosen.name, digest(chosen), chosen.band, PERIOD)
    return chosen


def pool_of(
    policy: Policy,
    fish: str,
    twin: str | None,
    pool: str,
    episodes: int,
    seed: int,
    walls: str = "5.5x2.7",
) -> Pool:
    """Where a policy is tried; raises BadInput where it does not fit the pool's fish."""
    if episodes < 2:
        raise BadInput(f"--episodes {episodes}: give 2 or more.")
    trained, own = twin_of(policy, twin), load_fish(fish)
    evaluation.check_same_body(trained, own)
    check_fits(policy.contract, trained.name, digest(trained), own.band, PERIOD)
    waters = evaluation.waters_of(pool)
    actions = policy.contract.actions
    return Pool(own, trained, actions, waters, episodes, seed, _walls(walls))


def _walls(text: str) -> tuple[float, float]:
    """`length x width` in metres."""
    try:
        length, width = map(float, text.split("x"))
    except ValueError:
        raise BadInput(f"--walls {text!r}: give length x width in metres, as 5.5x2.7.") from None
    return length, width


def evaluate(
    policy: str,
    fish: str,
    twin: str | None,
    pool: str,
    tasks: Sequence[str],
    episodes: int,
    seed: int,
    out: Path,
    progress: Progress,
    walls: str = "5.5x2.7",
) -> dict[str, Any]:
    """Try a policy in the pool; the folder keeps every swim."""
    loaded = load_policy(policy)
    where = pool_of(loaded, fish, twin, pool, episodes, seed, walls)
    return evaluation.evaluate(loaded, where, tasks, out, progress)


def compare(
    policies: Sequence[str],
    fish: str,
    twin: str | None,
    targets: int,
    seed: int,
    share: str,
    out: Path,
    progress: Progress,
) -> dict[str, Any]:
    """Swim every policy in every arm of the pool; numbers of all cells that are there."""
    own, entrants = load_fish(fish), []
    if targets < 2:
        raise BadInput(f"--targets {targets}: give 2 or more.")
    for name in policies:
        policy = load_policy(name)
        trained = twin_of(policy, twin)
        evaluation.check_same_body(trained, own)
        check_fits(policy.contract, trained.name, digest(trained), own.band, PERIOD)
        entrants.append(comparison.Entrant(_label(name), policy, trained))
    if len({one.name for one in entrants}) < len(entrants):
        raise BadInput("two policies of the same name; rename a file or its folder.")
    field = comparison.Field(own, targets, seed)
    comparison.run(entrants, field, out, _share(share), progress)
    found = comparison.read(out)
    write_json(out / "comparison.json", found, overwrite=True)
    return found


def _label(policy: str) -> str:
    """A run's folder where the file has the name that every run gives it."""
    path = Path(policy)
    return path.parent.name if path.name == "policy.onnx" else path.stem


def _share(text: str) -> tuple[int, int]:
    """`i/n` as an index from 0 and a count."""
    first, _, count = text.partition("/")
    if not (first.isdigit() and count.isdigit() and 1 <= int(first) <= int(count)):
        raise BadInput(f"--share {text!r}: give i/n, from 1/n to n/n, one process each.")
    return int(first) - 1, int(count)


def report(
    out: Path, fish: str, twin: str | None = None, data: dict[str, Any] | None = None
) -> tuple[Path, dict[str, Any]]:
    """One page of what a folder holds; `data` are its numbers, if they are at hand."""
    if not out.is_dir() or not any(out.iterdir()):
        raise BadInput(f"{out}: an empty or missing folder; evaluate into it first.")
    described = load_fish(fish)
    plan = out / "plan.json"
    held = evaluation.read_json(plan) if plan.is_file() else {}
    name = twin or held.get("twin", fish)
    return pages.report(out, described, load_fish(name), data)


def swim(
    policy: str, fish: str, twin: str | None, targets: int, seed: int, out: Path, counting: Counting
) -> Any:
    """A policy swims to targets in the pool's plant, without bytes and faster than real time; film,
    picture and page in a folder."""
    loaded, where, drawn = _entered(policy, fish, twin, targets, seed)
    with counting() as progress:
        swum = tours.tour(loaded, where.fish, where.waters[0], drawn, seed, progress)
    return _told(swum, loaded, where, {"policy": policy, "seed": seed}, out, counting)


def live(
    policy: str,
    fish: str,
    twin: str | None,
    targets: int,
    seed: int,
    out: Path,
    counting: Counting,
    say: Any,
) -> Any:
    """The same in real time, through camera, network, servo and IMU; told from the fish's log."""
    loaded, where, drawn = _entered(policy, fish, twin, targets, seed)
    log, seen = _room(out), out / "tour.json"
    seen.unlink(missing_ok=True)
    live_tasks.swim(policy, fish, targets, seed, "127.0.0.1:0", out, say)
    toured = evaluation.read_json(seen)
    swum = as_seen(tour_of(log, where.fish, drawn), toured["targets"])
    asked = {"policy": policy, "seed": seed, "log": str(log), "armed_anew": toured["armed_anew"]}
    return _told(swum, loaded, where, asked, out, counting)


def attended(
    policy: str, fish: str, twin: str | None, seed: int, console: str, out: Path, say: Any
) -> None:
    """In real time after the target that the operator drags, until Ctrl-C; the log is kept."""
    _entered(policy, fish, twin, 1, seed)
    log = _room(out)
    live_tasks.swim(policy, fish, 0, seed, console, out, say)
    say(f"log: {log}; `tailbeat export {log} --out swim.csv` makes a recording of it")


def _room(out: Path) -> Path:
    """Make a folder for a swim; the log that it will have. One that lies there is kept beside."""
    out.mkdir(parents=True, exist_ok=True)
    log = out / "swim.mcap"
    if log.exists():
        log.rename(out / f"swim-{datetime.now():%Y%m%d-%H%M%S}.mcap")
    return log


def _entered(
    policy: str, fish: str, twin: str | None, targets: int, seed: int
) -> tuple[Policy, Pool, Any]:
    """What was asked for, checked: the policy, where it swims, its targets."""
    if not 1 <= targets <= 100:
        raise BadInput(f"--targets {targets}: allowed are 1 to 100.")
    loaded = load_policy(policy)
    where = pool_of(loaded, fish, twin, "full", 2, seed)
    return loaded, where, tours.draw_targets(targets, seed)


def _told(
    swum: Any,
    loaded: Policy,
    where: Pool,
    asked: dict[str, Any],
    out: Path,
    counting: Counting,
) -> dict[str, Any]:
    """Film, picture, page and summary of a swim; the summary first: a long film takes minutes."""
    own, contract = where.fish, loaded.contract
    data = {
        **asked,
        "fish": own.name,
        "water": fingerprint(where.waters),
        **tours.as_json(swum),
        "training": contract.training,
        "provenance": evaluation.provenance(),
    }
    write_json(out / "summary.json", data, overwrite=True)
    with counting() as progress:
        tour_figures.film(swum, own, out / "swim.mp4", progress)
    drawn = pages.figure(tour_figures.picture(swum, own), out, "swim")
    rows = [{"": k, "value": v} for k, v in {**data["provenance"], **contract.training}.items()]
    sections = [
        ("The swim", [drawn, pages.video(out / "swim.mp4"), pages.table(data["targets"])]),
        ("Where this comes from", [pages.table(rows)]),
    ]
    pages.write(out, sections, data, f"{own.name} in the virtual pool")
    return data
