"""A sweep: its file, its rules, and real trainings on a real Ray, of which some are killed."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import polars as pl
import pytest
import torch

from support import command, importing_as_here, tailbeat, tailbeat_process
from tailbeat.benchmarks import sweeps
from tailbeat.benchmarks.sweeps import SweepRow
from tailbeat.cluster import plan, summary, trial, tune
from tailbeat.cluster.plan import Trial
from tailbeat.files import write_json
from tailbeat.link.datagrams import free_address
from tailbeat.train.train import train

EXAMPLE = Path(__file__).parents[1] / "examples" / "sweep.toml"
TINY = """
hours = 1.0
checkpoint_minutes = {checkpoint}
[vary]
fish = "pulley-fish-pool"
recipe = "smoke"
seed = {seeds}
[recipe]
window = 100_000 # never passed: every trial ends by its budget
budget_hours = {hours}
[trial]
targets = 4
arc = 20.0
"""


def tiny(folder: Path, seeds: int = 2, seconds: float = 4.0, checkpoint: float = 1.0) -> Path:
    path = folder / "sweep.toml"
    numbers = {"seeds": list(range(seeds)), "hours": seconds / 3600, "checkpoint": checkpoint / 60}
    path.write_text(TINY.format(**numbers))
    return path


# ---- the file -----------------------------------------------------------------------------------


def test_every_combination_is_a_trial_with_a_name_of_its_own(tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(
        EXAMPLE.read_text().replace("# [recipe] ", "[recipe]").replace("# batch", "batch")
    )
    made = plan.trials(plan.read(path))
    assert len(made) == 2 * 3 * 2 == len({one.name for one in made})
    assert made[0].name == "generator-batch-256-seed-0" and made[0].changed == {"batch": 256}
    assert len({one.group for one in made}) == 4
    assert {one.fish for one in made} == {"pulley-fish-pool"}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("hours = 2.0", "hours = 0", "field hours = 0: input should be greater than 0"),
        ("cores = 1", "core = 1", "field core is unknown"),
        ("cores = 1", "gpus = 2", "field gpus = 2: input should be less than or equal to 1"),
        ("seed = [0, 1, 2]", 'seed = ["0"]', "field vary.seed.0 = '0'"),
        ("seed = [0, 1, 2]", "seed = [1, 1]", "field seed: a value stands there twice"),
        ('fish = "pulley-fish-pool"', "", "field vary.fish is missing"),
        ('fish = "pulley-fish-pool"', 'fish = "nofish"', "nofish"),
        ('actions = ["generator", "direct"]', 'actions = "turning"', "turning"),
        ("[trial]", "[recipe]\nbatches = 3\n[trial]", "field recipe.batches is unknown"),
        ("[trial]", "[recipe]\nbatch = 2.5\n[trial]", "field recipe.batch = 2.5"),
        ("[trial]", "[recipe]\nbatch = 'x'\n[trial]", "field recipe.batch = 'x'"),
        ("[vary]", "[vary", "not TOML"),
        ("[vary]", "recipe = 3\n[vary]", "field recipe = 3"),
        ("seed = [0, 1, 2]", "seed = -1", "field vary.seed.0 = -1"),
        ("seed = [0, 1, 2]", "seed = []", "field vary.seed = ()"),
        ("[trial]", "[recipe]\nbatch = []\n[trial]", "field recipe.batch = []"),
        ('fish = "pulley-fish"', 'fish = "no-pool"', "no-pool"),
        ('pool = "full"', 'pool = "sea"', "--pool 'sea'"),
    ],
)
def test_a_file_that_is_wrong_is_refused_before_anything_starts(tmp_path, old, new, said):
    path, text = tmp_path / "sweep.toml", EXAMPLE.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    done = tailbeat("sweep", path, "--out", tmp_path / "out")
    assert done.returncode == 2 and said in done.stderr
    assert len(done.stderr.strip().split("\n")) == 1 and not (tmp_path / "out").exists()


def test_a_fish_that_does_not_compile_names_its_trial(tmp_path):
    fish = tmp_path / "bad.toml"
    fish.write_text("name = 'bad'")
    path = tmp_path / "sweep.toml"
    path.write_text(EXAMPLE.read_text().replace('"pulley-fish-pool"', f'"{fish}"'))
    done = tailbeat("sweep", path, "--out", tmp_path / "out")
    assert done.returncode == 2 and "trial generator-seed-0: " in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
@pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:10001", "nowhere"])
def test_an_address_without_a_cluster_is_said_at_once(tmp_path, address):
    """Not tried: auto, which would find a cluster that another test started here."""
    words = ("sweep", tiny(tmp_path), "--out", tmp_path / "out", "--address", address)
    done = tailbeat_process(*words)
    assert done.returncode == 2 and "no Ray cluster answers" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.skipif(torch.cuda.is_available(), reason="Ray would find a GPU here")
def test_a_share_of_a_gpu_is_refused_where_there_is_none(tmp_path):
    path = tiny(tmp_path)
    path.write_text("gpus = 0.5\n" + path.read_text())
    done = tailbeat_process("sweep", path, "--out", tmp_path / "out")
    assert done.returncode == 2 and "field gpus = 0.5: Ray found 0 GPUs" in done.stderr
    assert not list((tmp_path / "out").rglob("trial.json"))


# ---- rules --------------------------------------------------------------------------------------


def test_no_trial_is_ended_for_its_success_in_the_first_stage():
    assert tune.score({"stage": 1, "success": 0.1}) == tune.score({"stage": 1, "success": 0.9}) == 0
    assert tune.score({"stage": 3, "success": 0.5}) == 2.5


# ---- real trainings -----------------------------------------------------------------------------


def results(out: Path) -> dict[str, dict[str, float]]:
    """What each trial's training came to."""
    found = (out / "trials").glob("*/trained.json")
    return {path.parent.name: json.loads(path.read_text()) for path in found}


def beginnings(out: Path) -> dict[str, int]:
    """When each trial's training was begun; one that is begun anew writes its file again."""
    found = (out / "trials").glob("*/run/run.json")
    return {path.parent.parent.name: path.stat().st_mtime_ns for path in found}


def wait_for(found, seconds: float = 180.0):
    """Wait until `found()` is true; returns it. Beside other tests Ray takes a minute to start."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if value := found():
            return value
        time.sleep(0.2)
    raise AssertionError("waited too long")


def working(out: Path) -> list[int]:
    """The processes that work in a sweep's trials."""
    done = subprocess.run(["pgrep", "-f", f"cluster.trial {out.resolve()}"], capture_output=True)
    return [int(word) for word in done.stdout.split()]


@pytest.mark.slow
@pytest.mark.realtime
def test_a_sweep_that_is_killed_goes_on_and_loses_nothing(tmp_path):
    """Killed with -9 after a checkpoint, continued by --resume: both trainings go on from there,
    have had the time of their budget, not more, and no process is left."""
    path, out = tiny(tmp_path, seconds=6.0), tmp_path / "out"
    words = [sys.executable, "-m", "tailbeat", "sweep", str(path), "--out", str(out)]
    first = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_for(lambda: len(list(out.glob("trials/*/run/checkpoint"))) == 2)
    os.kill(first.pid, signal.SIGKILL)
    first.wait()
    wait_for(lambda: not working(out))
    assert len(results(out)) < 2
    begun = beginnings(out)
    other = tailbeat("sweep", tiny(tmp_path, seeds=3, seconds=6.0), "--out", out, "--resume")
    assert other.returncode == 2 and "another sweep than in" in other.stderr
    done = tailbeat_process("sweep", tiny(tmp_path, seconds=6.0), "--out", out, "--resume")
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    found = results(out)
    assert sorted(found) == ["pulley-fish-pool-seed-0", "pulley-fish-pool-seed-1"]
    assert all(6.0 <= one["seconds"] < 12.0 and one["stalled"] for one in found.values()), found
    assert beginnings(out) == begun
    table = pl.read_parquet(out / "sweep.parquet")
    assert table["state"].to_list() == ["done", "done"] and table["seed"].to_list() == [0, 1]
    assert (out / "report.html").is_file() and not working(out)


def test_a_training_that_was_over_when_its_trial_was_killed_is_not_continued(tmp_path):
    """It would be refused, because it has passed its stages, or given a second budget."""
    made, folder = plan.read(tiny(tmp_path)), tmp_path / "a"
    run = trial.run_of(plan.trials(made)[0], made, folder)
    curve = {"finished": False, "stalled": True, "seconds": 4.0, "history": [], "promotions": []}
    write_json(run.out / "curve.json", curve)
    trial._train(run, folder)
    assert json.loads((folder / "trained.json").read_text())["seconds"] == 4.0
    assert [path.name for path in run.out.iterdir()] == ["curve.json"]


@pytest.mark.slow
@pytest.mark.realtime
def test_a_training_that_stalled_gets_no_second_budget_when_its_trial_is_killed(tmp_path):
    """Killed after the checkpoint that says so, before its curve was written."""
    made, folder = plan.read(tiny(tmp_path, seconds=2.0)), tmp_path / "a"
    run = trial.run_of(plan.trials(made)[0], made, folder)
    first = train(run)
    assert first.stalled and 2.0 <= first.seconds < 4.0
    for name in ("curve.json", "policy.onnx"):
        (run.out / name).unlink()
    trial._train(run, folder)
    found = json.loads((folder / "trained.json").read_text())
    assert found["stalled"] and found["seconds"] < first.seconds + 1.0
    assert (run.out / "policy.onnx").is_file()


@pytest.mark.thorough
def test_a_training_that_ends_by_its_hours_was_not_told_to_end(tmp_path):
    """Seven seconds, of which the first five have no report: it is over, not to be begun again."""
    path, folder = tiny(tmp_path, seconds=600.0), tmp_path / "a"
    path.write_text(path.read_text().replace("hours = 1.0", "hours = 0.002", 1))
    made = plan.read(path)
    run = trial.run_of(plan.trials(made)[0], made, folder)
    trial._train(run, folder)
    found = json.loads((folder / "trained.json").read_text())
    assert 7.2 <= found["seconds"] < 15.0 and not found["finished"] and not found["stalled"]


def test_a_worker_with_other_versions_is_refused(tmp_path):
    """Before it starts anything; the sentence says what differs."""
    config = {"out": str(tmp_path), "name": "a", "cores": 1}
    other = tune.versions() | {"mujoco": "3.3.0"}
    with pytest.raises(RuntimeError, match=r"mujoco 4\.0\.0, not 3\.3\.0: install the same"):
        tune._work({**config, "versions": other})
    assert not (tmp_path / "trials").exists()


NODES = """
import sys, time
from pathlib import Path
from ray.cluster_utils import Cluster
from tailbeat.cluster import connection, plan, tune
made = plan.read(Path(sys.argv[1]))
cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
second = cluster.add_node(num_cpus=1)
connection.connect(cluster.address)
out, killed = Path(sys.argv[2]), []
def report(row):
    if row.numbers and not killed and len(list(out.glob("trials/*/run/checkpoint"))) == 2:
        killed.append(row.name)
        cluster.remove_node(second, allow_graceful=False)
        cluster.add_node(num_cpus=1)
print(tune.swim(made, plan.trials(made), out, report), killed)
"""


@pytest.mark.slow
def test_a_node_that_is_killed_loses_no_trial(tmp_path):
    """Two nodes as processes of this machine, four trainings; one node is killed in the middle."""
    path, out = tiny(tmp_path, seeds=4, seconds=20.0, checkpoint=2.0), tmp_path / "out"
    (tmp_path / "nodes.py").write_text(NODES)
    words = [sys.executable, str(tmp_path / "nodes.py"), str(path), str(out)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.splitlines()[-1].startswith("{} ['pulley-fish-pool-seed-"), done.stdout
    found = results(out)
    assert len(found) == 4
    assert all(20.0 <= one["seconds"] < 30.0 for one in found.values())
    made = plan.trials(plan.read(path))
    assert summary.collect(out, made, {}).complete
    assert not working(out)


@pytest.fixture
def token(monkeypatch) -> None:
    """Ray's own token, for cluster and client alike, whatever this machine has."""
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    monkeypatch.setenv("RAY_AUTH_TOKEN", "0123456789abcdef" * 4)


@contextmanager
def head() -> Iterator[str]:
    """A cluster of two cores that a client reaches from outside; yields its address."""
    first, clients = (free_address()[1] for _ in range(2))
    words = ["--head", "--block", f"--port={first}", f"--ray-client-server-port={clients}"]
    words += ["--num-cpus=2", "--include-dashboard=false", "--disable-usage-stats"]
    ray = Path(sys.executable).parent / "ray"
    started = subprocess.Popen(
        [ray, "start", *words], stdout=subprocess.DEVNULL, env=importing_as_here()
    )
    try:
        wait_for(lambda: connects(clients))
        yield f"ray://127.0.0.1:{clients}"
    finally:
        started.send_signal(signal.SIGTERM)  # which ends all that it started
        started.wait(60)


@pytest.mark.slow
def test_a_cluster_that_ends_while_a_machine_outside_uses_it_is_one_sentence(tmp_path, token):
    with head() as address:
        words = ["sweep", tiny(tmp_path, seconds=60.0), "--out", tmp_path / "out"]
        swimming = subprocess.Popen(
            command(*words, "--address", address), stderr=subprocess.PIPE, text=True
        )
        wait_for(lambda: beginnings(tmp_path / "out"), 120.0)
    said = swimming.communicate(timeout=120)[1]
    assert swimming.returncode == 2 and "the Ray cluster was lost" in said, said[-2000:]
    assert "Traceback" not in said and "--resume" in said


def connects(port: int) -> bool:
    with contextlib.suppress(OSError):
        socket.create_connection(("127.0.0.1", port)).close()
        return True
    return False


FROM_OUTSIDE = """
import sys
from test_jobs import slow_first
from tailbeat.cluster.jobs import map_jobs
print([job for job, _ in map_jobs(slow_first, range(6), lambda *row: None, sys.argv[1])])
"""


@pytest.mark.slow
def test_a_machine_outside_a_cluster_swims_a_sweep_and_jobs_there(tmp_path, token):
    with head() as address:
        path, out = tiny(tmp_path), tmp_path / "out"
        done = tailbeat_process("sweep", path, "--out", out, "--address", address)
        assert done.returncode == 0, done.stderr
        assert len(results(out)) == 2 and not working(out)
        assert "trials over: 2 of 2" in done.stdout + done.stderr
        words = [sys.executable, "-c", FROM_OUTSIDE, address]
        found = subprocess.run(words, capture_output=True, text=True, env=importing_as_here())
        assert found.stdout.strip() == str(list(range(6))), found.stderr


def test_a_trial_s_fields_are_those_of_a_sweep():
    """A field that may vary and that no trial has would be ignored."""
    own = set(Trial.__dataclass_fields__) - {"name", "group", "changed"}
    assert own == set(plan.Varied.model_fields)


# ---- how efficient it is ------------------------------------------------------------------------


def test_more_cores_are_as_the_arithmetic_says():
    """A thousand trials of 10 s, each with 1 s more, on 100 cores: ten rounds. A driver that needs
    0.1 s of each serves 100 at once, and more cores give nothing."""
    row = SweepRow(8, 2, 50.0, 60.0, 50 / 60, 5.0, 10.0, 1.0, 0.1)
    ten, hundred, thousand, _, *usual = sweeps.more_cores(row)
    assert ten.hours == pytest.approx((5 + 100 * 11) / 3600)
    assert hundred.hours == thousand.hours == pytest.approx((5 + 10 * 11) / 3600)
    assert hundred.efficiency == pytest.approx(1000 * 10 / (100 * 115))
    assert hundred.most_cores == 100
    assert thousand.efficiency == pytest.approx(hundred.efficiency / 10)
    assert usual[0].efficiency > 0.99 and usual[0].most_cores == 12_000


def test_a_core_is_idle_once_no_trial_is_left():
    """Three trials on two cores: the third starts at 10 s, and its neighbour ends at 14 s."""
    spans = [(0.0, 10.0), (0.0, 14.0), (10.0, 21.0)]
    assert sweeps.idle(spans, 2) == pytest.approx(7.0)
    assert sweeps.idle(spans[:1], 2) == pytest.approx(10.0)
    assert sweeps.idle([(0.0, 10.0), (10.5, 20.0)], 1) == 0.0


@pytest.mark.slow
def test_a_sweep_is_measured_against_one_training_after_the_other():
    row = sweeps.sweep_bench(trials=2)
    assert row.trials == 2 and row.ratio == pytest.approx(row.sweep_s / row.in_turn_s)
    assert 5 < row.trial_s < row.sweep_s and row.overhead_s > 0 and 0 < row.driver_s < row.trial_s
