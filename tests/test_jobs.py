"""Jobs in many processes: in order, as if swum alone; an error ends them; cells of a comparison."""

import os
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from pickle import loads

import pytest

from support import complaint
from synthetic import record
from tailbeat.cluster import comparison
from tailbeat.cluster.jobs import map_jobs
from tailbeat.control.policy import load_policy
from tailbeat.evaluate.compare import ComparisonConfig, cells_of, swim_cell
from tailbeat.evaluate.comparison import cell_path
from tailbeat.evaluate.evaluation import EvaluationConfig, evaluate
from tailbeat.evaluate.margins import MarginsConfig, margins
from tailbeat.files import BadInput, write_json
from tailbeat.fish.store import load_fish
from tailbeat.identify import stages
from tailbeat.identify.job import FluidConfig, search_ahead, seeds_of
from tailbeat.identify.search import Effort
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


@pytest.mark.realtime
def test_ctrl_c_ends_all_processes_at_once():
    """As a terminal sends it: to the whole group."""
    words = [sys.executable, "-c", INTERRUPTED, str(Path(__file__).parent)]
    done = subprocess.run(
        words, capture_output=True, text=True, timeout=60, start_new_session=True
    )  # it would wait for forty jobs
    assert done.stdout == "interrupted\n" and "Traceback" not in done.stderr


@pytest.mark.long
def test_a_comparison_goes_on_and_its_cells_are_those_swum_alone(tmp_path):
    """To the bit. A cell on disk is not swum again."""
    out, (first, second, *_) = tmp_path / "c", cells_of(CONFIG)
    write_json(cell_path(out, *first), {**vars(swim_cell(CONFIG, *first)), "targets": 7})
    steps: list[int] = []
    done = comparison.compare(CONFIG, out, lambda name, k, n: steps.append(n))
    assert steps == [7] * 7 and len(done.rows) == 8
    alone, path = tmp_path / "alone.json", cell_path(out, *second)
    write_json(alone, swim_cell(CONFIG, *second))
    assert alone.read_bytes() == path.read_bytes()
    assert b'"targets": 7' in cell_path(out, *first).read_bytes()


@pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed")
@pytest.mark.parametrize("verb", ["evaluate", "identify fluid"])
def test_an_address_without_a_cluster_leaves_nothing_behind(tmp_path, verb):
    write_recording(
        record(load_fish("pulley-fish"), "s", 1.5, 0.5, seconds=3.0), tmp_path / "s.csv"
    )
    own = {"evaluate": (POLICY,), "identify fluid": ("--fish", "pulley-fish", "--fit", "s.csv")}
    words = (*verb.split(), *own[verb], "--out", "new.toml", "--address", "127.0.0.1:1")
    said = complaint(*words, cwd=tmp_path)
    assert "--address 127.0.0.1:1: no Ray cluster answers" in said
    assert [path.name for path in tmp_path.iterdir()] == ["s.csv"]


ON_RAY = """
import sys
from pathlib import Path
from ray.cluster_utils import Cluster
from tailbeat.cluster.comparison import compare
from tailbeat.cluster.evaluation import evaluate_on
from tailbeat.cluster.identification import search_ahead
from tailbeat.cluster.margins import margins_on
from tailbeat.evaluate.compare import ComparisonConfig
from tailbeat.evaluate.margins import MarginsConfig
cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "include_dashboard": False})
config = ComparisonConfig((sys.argv[1],), targets=2)
out = Path(sys.argv[2])
compare(config, out, print, cluster.address)
asked = MarginsConfig(targets=16, nuisances=("encoder",))
margins_on(cluster.address, sys.argv[1], asked, out / "margins", print)
from test_jobs import EVALUATED, FITTED, fitted
evaluate_on(cluster.address, sys.argv[1], EVALUATED, out / "evaluated", print)
search_ahead(cluster.address, fitted(Path(sys.argv[3]), out), FITTED, print)
"""
EVALUATED = EvaluationConfig(pool="full", tasks=("reach",), episodes=2)
FITTED = FluidConfig(zones=1, seeds=2, effort=Effort(generations=2, polish=2), draws=4)


def fitted(swim: Path, out: Path) -> stages.Paths:
    return stages.Paths("pulley-fish", [swim], out / "fitted.toml", [], None, [])


@pytest.mark.slow
def test_what_is_swum_on_a_cluster_is_what_this_machine_swims(tmp_path):
    """To the bit: a comparison, margins, an evaluation, the searches of an identification."""
    swim = tmp_path / "swim.csv"
    write_recording(record(load_fish("pulley-fish"), "swim", 1.5, 0.5, seconds=3.0), swim)
    words = [sys.executable, "-c", ON_RAY, POLICY, str(tmp_path / "ray"), str(swim)]
    paths = [str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
    own = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(words, capture_output=True, text=True, timeout=400, env=own)
    assert done.returncode == 0, done.stderr[-3000:]
    comparison.compare(CONFIG, tmp_path / "here", lambda *_: None)
    for cell in cells_of(CONFIG):
        there, here = (cell_path(tmp_path / name, *cell) for name in ("ray", "here"))
        assert there.read_bytes() == here.read_bytes(), cell
    asked = MarginsConfig(targets=16, nuisances=("encoder",))
    margins(load_policy(POLICY), asked, tmp_path / "margins", lambda *_: None)
    there, here = (path / "margins/cells.json" for path in (tmp_path / "ray", tmp_path))
    assert there.read_bytes() == here.read_bytes()
    evaluate(load_policy(POLICY), EVALUATED, tmp_path / "evaluated", lambda *_: None)
    names = [path.name for path in (tmp_path / "evaluated/runs").glob("*.npz")]
    assert len(names) > 3
    for name in names:
        there, here = (path / "evaluated/runs" / name for path in (tmp_path / "ray", tmp_path))
        assert there.read_bytes() == here.read_bytes(), name
    (scratch := tmp_path / "scratch").mkdir()
    fish, (fit, *_) = stages.swims_of(fitted(swim, tmp_path), FITTED)
    for seed in seeds_of(FITTED):
        search_ahead(fish, fit, FITTED, scratch, seed)
        (there,), (here,) = (
            [loads(path.read_bytes()) for path in folder.glob(f"**/*/seed{seed}.fit")]
            for folder in (tmp_path / "ray", scratch)
        )
        assert there.cost == here.cost and there.z.tolist() == here.z.tolist()
