"""Jobs in many processes: in order, as if swum alone; an error ends them; cells of a comparison."""

import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from pickle import loads

import pytest
from psutil import pid_exists

from support import complaint, importing_as_here, until
from synthetic import record
from tailbeat.cluster import comparison
from tailbeat.cluster.jobs import map_jobs
from tailbeat.cluster.same import load_same
from tailbeat.control.policy import contract_digest, load_policy, shipped
from tailbeat.evaluate.compare import ComparisonConfig, cells_of, swim_cell
from tailbeat.evaluate.comparison import cell_path
from tailbeat.evaluate.evaluation import EvaluationConfig, evaluate
from tailbeat.evaluate.margins import MarginsConfig, margins
from tailbeat.files import BadInput, write_json
from tailbeat.fish.store import load_fish
from tailbeat.identify import servo_search, stages
from tailbeat.identify.job import FluidConfig, search_ahead, seeds_of
from tailbeat.identify.search import Effort
from tailbeat.identify.servo_search import ServoConfig
from tailbeat.recording import write_recording

POLICY = "pulley-fish-pool-generator"
CONFIG = ComparisonConfig((POLICY,), targets=2)


def slow_first(job: int) -> tuple[int, int]:
    time.sleep(0.5 if job == 0 else 0.0)
    return job, os.getpid()


def refusing(job: int) -> int:
    if job == 3:
        raise BadInput(f"job {job} is wrong.")
    return job


def test_results_come_in_the_order_of_their_jobs_from_other_processes():
    """The first job ends last."""
    done: list[tuple[int, int]] = []
    found = map_jobs(slow_first, range(6), lambda *row: done.append(row))
    assert [job for job, _ in found] == list(range(6))
    assert os.getpid() not in {pid for _, pid in found}
    assert done == [(k, 6) for k in range(1, 7)]
    assert map_jobs(slow_first, [], lambda *row: None) == []


def test_the_first_error_ends_all_and_is_the_job_s_own():
    with pytest.raises(BadInput, match="job 3 is wrong"):
        map_jobs(refusing, range(50), lambda *row: None)


INTERRUPTED = """
import os, signal, sys, threading, time
sys.path.insert(0, sys.argv[1])
from test_jobs import slow
from tailbeat.cluster.jobs import map_jobs
def press():
    while True:  # it is not heard while the processes start
        time.sleep(1.0)
        os.killpg(0, signal.SIGINT)
threading.Thread(target=press, daemon=True).start()
try:
    map_jobs(slow, range(40), lambda *row: None)
except KeyboardInterrupt:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    print("interrupted", flush=True)
"""


def slow(job: int) -> None:
    time.sleep(5.0)


@pytest.mark.thorough
@pytest.mark.realtime
def test_ctrl_c_ends_all_processes_at_once():
    """As a terminal sends it: to the whole group."""
    words = [sys.executable, "-c", INTERRUPTED, str(Path(__file__).parent)]
    done = subprocess.run(
        words, capture_output=True, text=True, timeout=60, start_new_session=True
    )  # it would wait for forty jobs
    assert done.stdout == "interrupted\n" and "Traceback" not in done.stderr


KILLED = """
import sys
sys.path.insert(0, sys.argv[1])
from test_jobs import where
from tailbeat.cluster.jobs import map_jobs
map_jobs(where, [sys.argv[2]] * 2, lambda *row: None)
"""


def where(folder: str) -> None:
    (Path(folder) / str(os.getpid())).touch()
    time.sleep(60.0)


@pytest.mark.thorough
@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_processes_end_with_the_one_that_wants_their_results(tmp_path, number):
    """They waited for jobs for ever, and one wrote a cell that a new comparison swam too."""
    words = [sys.executable, "-c", KILLED, str(Path(__file__).parent), str(tmp_path)]
    driver = subprocess.Popen(words, stderr=subprocess.DEVNULL)
    until(lambda: any(tmp_path.iterdir()))
    workers = [int(path.name) for path in tmp_path.iterdir()]
    driver.send_signal(number)
    driver.wait(10.0)
    until(lambda: not any(map(pid_exists, workers)), seconds=10.0)


def test_a_node_with_another_file_of_a_policy_refuses_its_jobs(tmp_path, monkeypatch):
    """Its swims were stored as those of the policy that the command had loaded."""
    path, config = tmp_path / "mine.onnx", replace(CONFIG, policies=("mine.onnx",), only=("twin",))
    shutil.copyfile(shipped()[POLICY], path)
    monkeypatch.chdir(tmp_path)
    jobs = list[comparison.CellJob]()
    monkeypatch.setattr(comparison, "map_jobs", lambda swim, own, *_, **more: jobs.extend(own))
    monkeypatch.setattr(comparison, "conclude", lambda out: None)
    comparison.compare(config, tmp_path / "out", print)
    monkeypatch.chdir("/")  # a node works in another folder
    shutil.copyfile(shipped()["pulley-fish-pool-follow"], path)
    (job,) = jobs
    with pytest.raises(BadInput, match=r"mine: on .* this is another policy than where"):
        comparison.swim(job)
    assert not job.path.exists()
    digest = contract_digest(load_policy(POLICY).contract)
    with pytest.raises(BadInput, match="this is another policy"):
        load_same(str(path), digest)


@pytest.mark.slow
@pytest.mark.long
def test_a_comparison_goes_on_and_its_cells_are_those_swum_alone(tmp_path):
    """To the bit. A cell on disk is not swum again."""
    out, (first, second, *_) = tmp_path / "c", cells_of(CONFIG)
    write_json(cell_path(out, *first), {**vars(swim_cell(CONFIG, *first)), "targets": 7})
    steps: list[int] = []
    done = comparison.compare(CONFIG, out, lambda name, k, n: steps.append(n))
    assert steps == [9] * 9 and len(done.rows) == 10
    alone, path = tmp_path / "alone.json", cell_path(out, *second)
    write_json(alone, swim_cell(CONFIG, *second))
    assert alone.read_bytes() == path.read_bytes()
    assert b'"targets": 7' in cell_path(out, *first).read_bytes()


@pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed")
@pytest.mark.parametrize("verb", ["evaluate", "identify fluid", "identify servo"])
def test_an_address_without_a_cluster_leaves_nothing_behind(tmp_path, verb):
    write_recording(
        record(load_fish("pulley-fish"), "s", 1.5, 0.5, seconds=3.0), tmp_path / "s.csv"
    )
    fit = ("--fish", "pulley-fish", "--fit", "s.csv")
    own = {"evaluate": (POLICY,), "identify fluid": fit, "identify servo": fit}
    words = (*verb.split(), *own[verb], "--out", "new.toml", "--address", "127.0.0.1:1")
    said = complaint(*words, cwd=tmp_path)
    assert "--address 127.0.0.1:1: no Ray cluster answers" in said
    assert [path.name for path in tmp_path.iterdir()] == ["s.csv"]


CLUSTER = """
import sys
from pathlib import Path
from ray.cluster_utils import Cluster
from tailbeat.cluster.jobs import map_jobs
from tailbeat.files import BadInput
from test_jobs import ASKED, CONFIG, EVALUATED, FITTED, POLICY, SERVO, bench, fitted, refusing
from tailbeat.cluster.comparison import compare
from tailbeat.cluster.evaluation import evaluate_on
from tailbeat.cluster.identification import fluid_ahead, servo_ahead
from tailbeat.cluster.margins import margins_on
cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "include_dashboard": False})
address, out = cluster.address, Path(sys.argv[1])
"""
ASKED = MarginsConfig(targets=16, nuisances=("encoder",))
EVALUATED = EvaluationConfig(pool="full", tasks=("reach",), episodes=2)
FITTED = FluidConfig(zones=1, seeds=2, effort=Effort(generations=2, polish=2), draws=4)


def fitted(out: Path) -> stages.Paths:
    return stages.Paths("pulley-fish", [out / "swim.csv"], out / "fitted.toml", [], None, [])


SERVO = ServoConfig(seeds=2, effort=Effort(generations=3, population=8, polish=2, scouts=20))
STEPS = Path(__file__).parents[1] / "examples/bench/servo-steps.csv"


def bench(out: Path) -> stages.Paths:
    return stages.Paths("pulley-fish", [STEPS], out / "servo.toml")


def on_ray(script: str, out: Path) -> None:
    """Run a script on a cluster of two cores; nodes import what this process imports."""
    words = [sys.executable, "-c", CLUSTER + script, str(out)]
    done = subprocess.run(
        words, capture_output=True, text=True, timeout=280, env=importing_as_here()
    )
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.mark.slow
def test_comparison_and_margins_on_a_cluster_are_those_of_this_machine(tmp_path):
    there, here = tmp_path / "there", tmp_path / "here"
    on_ray(
        """
try:
    map_jobs(refusing, range(8), print, address)
    raise SystemExit("no job was refused")
except BadInput as error:
    assert str(error) == "job 3 is wrong.", error
compare(CONFIG, out, print, address)
margins_on(address, POLICY, ASKED, out / "margins", print)
""",
        there,
    )
    comparison.compare(CONFIG, here, lambda *_: None)
    for cell in cells_of(CONFIG):
        assert cell_path(there, *cell).read_bytes() == cell_path(here, *cell).read_bytes(), cell
    margins(load_policy(POLICY), ASKED, here / "margins", lambda *_: None)
    name = "margins/cells.json"
    assert (there / name).read_bytes() == (here / name).read_bytes()


@pytest.mark.slow
def test_an_evaluation_and_searches_on_a_cluster_are_those_of_this_machine(tmp_path):
    there, here = tmp_path / "there", tmp_path / "here"
    for folder in (there, here):
        folder.mkdir()
        swim = record(load_fish("pulley-fish"), "swim", 1.5, 0.5, seconds=3.0)
        write_recording(swim, folder / "swim.csv")
    on_ray(
        """
evaluate_on(address, POLICY, EVALUATED, out / "evaluated", print)
fluid_ahead(address, fitted(out), FITTED, print)
servo_ahead(address, bench(out), SERVO, print)
""",
        there,
    )
    evaluate(load_policy(POLICY), EVALUATED, here / "evaluated", lambda *_: None)
    names = [path.relative_to(here) for path in here.glob("evaluated/runs/*.npz")]
    assert len(names) > 3
    for name in names:
        assert (there / name).read_bytes() == (here / name).read_bytes(), name
    fish, (fit, *_) = stages.swims_of(fitted(here), FITTED)
    _, (commands, _) = stages.benches_of(bench(here), SERVO)
    for seed in seeds_of(FITTED):
        search_ahead(fish, fit, FITTED, fitted(here).scratch, seed)
        servo_search.search_ahead(commands, SERVO, bench(here).scratch, True, seed)
    found = sorted(path.relative_to(here) for path in here.rglob("seed*.fit"))
    assert len(found) == 4
    for name in found:
        theirs, ours = (loads((folder / name).read_bytes()) for folder in (there, here))
        assert theirs.cost == ours.cost and theirs.z.tolist() == ours.z.tolist()
