"""Experiments in the pool are recorded as a lab's are, and a fish is identified from the folder."""

import json
import shutil
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tailbeat.cluster import identification
from tailbeat.evaluate import fresh_recordings
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.show import shaft_stiffness
from tailbeat.fish.store import load_fish
from tailbeat.identify import posterior
from tailbeat.identify.chain import Ahead, ChainPaths, Folder, _keys, identify_all, read_folder
from tailbeat.identify.check_swims import check_swims
from tailbeat.identify.job import FluidConfig
from tailbeat.identify.manoeuvres import FULL, manoeuvres
from tailbeat.identify.protocol import fluid_runs, limits, servo_commands
from tailbeat.identify.search import Effort
from tailbeat.identify.tail import identify_tail
from tailbeat.pool.protocols import record_fluid, record_servo
from tailbeat.pool.record import record
from tailbeat.pool.recorder import COUNT, Sensors
from tailbeat.pool.water import Water, fingerprint
from tailbeat.recording import Recording, crop, read_recording, write_recording
from tailbeat.report.identified import DRAWINGS

FISH = load_fish("pulley-fish")
SERVO = ("servo-chirp", "servo-steps", "servo-beat")
LITTLE = FluidConfig(1, 1, effort=Effort(generations=1, population=8, polish=3), draws=4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """All experiments, as files; three of the 45 swims."""
    out = tmp_path_factory.mktemp("pool")
    for kind in ("tail", "check"):
        record(kind, "pulley-fish", out, seed=0)
    servo = servo_commands(FISH, limits(FISH))
    for bench in record_servo(FISH, commands=[servo[name] for name in SERVO]):
        write_recording(bench, out / f"{bench.name}.csv")
    swims = fluid_runs(FISH, limits(FISH))
    chosen = [swims[f"fluid-{number:02d}"] for number in (1, 5, 7)]
    for swim in record_fluid(FISH, commands=chosen):
        write_recording(swim, out / f"{swim.name}.csv")
    return out


@pytest.mark.thorough
def test_what_is_recorded_is_what_sensors_give(folder):
    sweep = read_recording(folder / "tail-sweep.csv")
    counts = sweep.columns["angle_rad"] / COUNT
    assert counts == pytest.approx(np.round(counts), abs=1e-6)
    assert np.ptp(np.diff(sweep.time)) > 1e-4  # the clock is uneven
    assert sweep.meta["water"] == fingerprint([Water()])
    swim = read_recording(folder / "fluid-01.csv")
    assert set(swim.columns) == {"motor_angle_rad", "x_m", "y_m", "yaw_rad"}
    gaps = np.diff(swim.time) * Sensors().frame_rate
    assert 0.005 < np.mean(gaps > 1.5) < 0.05  # frames without a tag
    still = swim.time < 1.0
    noise = swim.columns["x_m"][still].std()
    assert noise == pytest.approx(Sensors().position_noise, rel=0.4)


def test_the_same_seed_is_the_same_recording_and_the_plant_stays_hidden():
    chirp = crop(servo_commands(FISH, limits(FISH))["servo-chirp"], 0.0, 4.0)
    first, again = (next(record_servo(FISH, seed=3, commands=[chirp])) for _ in range(2))
    assert np.array_equal(first.columns["angle_rad"], again.columns["angle_rad"])
    other = next(record_servo(FISH, seed=4, commands=[chirp]))
    assert first.time.size != other.time.size or not np.array_equal(first.time, other.time)
    hidden = {f.name for f in fields(Water)}
    assert not hidden & set(first.meta) and not hidden & set(first.columns)


@pytest.mark.thorough
def test_swims_start_at_rest_cover_the_band_and_stay_off_the_walls():
    swims = list(record_fluid(FISH, seed=1))
    assert len(swims) == 45
    for swim in swims:
        assert np.abs(swim.columns["x_m"]).max() < 2.75
        assert np.abs(swim.columns["y_m"]).max() < 1.35
        assert swim.time[-1] > 4.5
    steady = swims[:12]
    for swim in steady:
        x, y = swim.columns["x_m"], swim.columns["y_m"]
        assert np.hypot(x[30] - x[0], y[30] - y[0]) < 0.02
    turns = [abs(swim.columns["yaw_rad"][-1]) for swim in steady]
    assert sum(turn > 0.7 for turn in turns) >= 3
    ways = [np.hypot(np.ptp(one.columns["x_m"]), np.ptp(one.columns["y_m"])) for one in swims]
    speeds = [way / one.time[-1] for way, one in zip(ways, swims, strict=True)]
    # `generator` swims at 0.33 m/s, and the twin must not be extrapolated to it.
    assert max(speeds[:36]) < 0.3 < 0.35 < min(speeds[36:39])


def test_check_swims_stay_inside_the_limits_and_every_seed_has_others():
    limit = limits(FISH)
    made = check_swims(FISH, limit)
    kinds = [name.split("-")[2] for name in made]
    assert kinds == 10 * ["wander"] + 5 * ["steady"]
    for command in made.values():
        angle = command.columns["command_rad"] - limit.centre
        assert np.abs(angle).max() <= limit.angle + 1e-9
        assert np.abs(np.gradient(angle, command.time)).max() < 1.3 * FULL * limit.speed
        assert angle[0] == 0.0
    # They turn as hard as policies do: some rest against the range's end, as cut setpoints do.
    rests = [np.mean(np.abs(c.columns["command_rad"]) > 0.99 * limit.angle) for c in made.values()]
    assert np.mean(rests[:10]) > 0.05 > max(rests[10:])
    other = check_swims(FISH, limit, seed=1)
    for name, command in made.items():
        mine, theirs = (one.columns["command_rad"] for one in (command, other[name]))
        assert abs(np.corrcoef(mine, theirs)[0, 1]) < 0.9, name


@pytest.mark.thorough
def test_check_swims_judge_the_fit_and_are_never_fitted(folder):
    sorted_out = read_folder(folder)
    assert len(sorted_out.check) == 15
    assert not {*sorted_out.check} & {*sorted_out.fluid_fit, *sorted_out.fluid_validate}


@pytest.mark.thorough
def test_the_bench_gives_back_the_plant_s_stiffness(folder):
    fit = identify_tail([read_recording(folder / "tail-sweep.csv")])
    assert fit.k_eff.value == pytest.approx(shaft_stiffness(FISH), rel=0.02)
    assert fit.k_eff.interval[0] < shaft_stiffness(FISH) < fit.k_eff.interval[1]


@pytest.mark.thorough
def test_a_change_of_one_stage_s_inputs_keeps_the_stages_before_it(folder):
    """It was one key for all: other draws, and tail and servo were fitted anew."""
    data = read_folder(folder)
    keys = _keys("pulley-fish", data, LITTLE)

    def kept(fish: str, recordings: Folder, config: FluidConfig) -> list[str]:
        other = _keys(fish, recordings, config)
        return [name for name, key in keys.items() if other[name] == key]

    assert kept("pulley-fish", data, LITTLE) == ["tail", "servo", "fluid"]
    assert kept("pulley-fish", data, replace(LITTLE, draws=7)) == ["tail", "servo"]
    assert kept("pulley-fish", data, replace(LITTLE, seeds=2)) == ["tail"]
    fewer = replace(data, fluid_fit=data.fluid_fit[1:])
    assert kept("pulley-fish", fewer, LITTLE) == ["tail", "servo"]
    assert kept("pulley-fish", replace(data, servo_fit=data.servo_fit[1:]), LITTLE) == ["tail"]
    assert kept("pulley-fish-pool", data, LITTLE) == []


@pytest.mark.thorough
def test_one_folder_one_command(folder, tmp_path, monkeypatch):
    """The whole chain with little effort: every stage runs, and its result goes on to the next."""
    few = tmp_path / "few"
    few.mkdir()
    for name in ("tail-sweep", *SERVO):
        (few / f"{name}.csv").write_bytes((folder / f"{name}.csv").read_bytes())
    for name in ("fluid-01", "fluid-05", "fluid-07", "check-01-wander", "check-02-wander"):
        short = crop(read_recording(folder / f"{name}.csv"), 0.0, 3.0)
        name = name.replace("-07", "-06")  # so that the third swim is held out
        write_recording(replace(short, name=name), few / f"{name}.csv")
    out = tmp_path / "mine.toml"
    paths = ChainPaths("pulley-fish", few, out)
    found = identify_all(paths, LITTLE, lambda *_: None, DRAWINGS)
    assert found.k_eff == pytest.approx(0.98, rel=0.02)
    assert found.servo_mae_deg is not None and found.servo_mae_deg < 0.2
    assert len(found.position_error_share) == 1
    fish = load_fish(out)
    assert fish.tail.k_eff == pytest.approx(found.k_eff, rel=1e-4)
    assert fish.servo == "identified" and fish.name == "mine"
    page = (tmp_path / "mine.md").read_text()
    assert "fluid-06 | held out" in page and "mine-tail.png" in page
    saved = json.loads((tmp_path / "mine.json").read_text())
    assert saved["stages"]["servo"]["parameters"]["kp"]["value"] == pytest.approx(5.41, rel=0.05)
    known = posterior.of(str(out))
    assert known is not None and known.held_out == ("check-01-wander", "check-02-wander")
    assert known.discrepancy is not None and known.discrepancy.swims == 2
    assert not list(tmp_path.glob(".*"))
    elsewhere = searched_elsewhere(few, tmp_path / "other.toml", monkeypatch)
    assert elsewhere.model_copy(update={"name": "mine"}) == fish


def searched_elsewhere(few: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> Fish:
    """The fish of a whole chain whose searches were done before their stages, as a cluster does
    them; the stages themselves must search no more."""
    seen: list[tuple[str, float]] = []  # stage, fraction done

    def mapped(function, jobs, report, address):
        assert address == "here"
        for job in jobs:
            function(job)
        report(1, 1)
        assert seen.pop() == ("search", 1.0)

    monkeypatch.setattr(identification, "map_jobs", mapped)
    ahead = Ahead(
        partial(identification.servo_ahead, "here"), partial(identification.fluid_ahead, "here")
    )
    paths = ChainPaths("pulley-fish", few, out)
    identify_all(paths, LITTLE, lambda *row: seen.append(row[1:3]), DRAWINGS, ahead)
    searches = [share for stage, share in seen if stage != "draws"]
    assert [share for share in searches if share < 1] == []  # none has begun
    return load_fish(out)


def test_a_folder_recorded_before_the_renaming_is_read(tmp_path):
    """The servo's recordings were called `motor-*.csv`; the same ones are held out."""
    samples = sorted((Path(__file__).parents[1] / "examples/bench").glob("servo-*.csv"))
    for path in samples:
        shutil.copy(path, tmp_path / path.name.replace("servo-", "motor-"))
    for name in ("tail-sweep", "fluid-01"):
        shutil.copy(samples[0], tmp_path / f"{name}.csv")
    found = read_folder(tmp_path)
    assert [path.stem for path in found.servo_fit] == [
        "motor-chirp",
        "motor-steps",
        "motor-triangle",
    ]
    assert [path.stem for path in found.servo_validate] == ["motor-beat", "motor-mixed"]
    assert len(fresh_recordings.read(tmp_path).servo) == 5
    with pytest.raises(BadInput, match="servo recordings exist already"):
        record("servo", "pulley-fish", tmp_path, 0)


def test_given_commands_are_played_and_checked(tmp_path):
    time = np.arange(0, 6, 0.02)
    sine = 0.4 * np.sin(2 * np.pi * 1.5 * time)
    write_recording(Recording("c", time, {"command_rad": sine}), tmp_path / "fluid-mine.csv")
    write_recording(Recording("c", time, {"command_rad": 4 * sine}), tmp_path / "fluid-wild.csv")
    made = record("fluid", "pulley-fish", tmp_path / "out", 0, [tmp_path / "fluid-mine.csv"])
    swim = read_recording(made[0])
    assert made[0].name == "fluid-mine.csv" and np.ptp(swim.columns["x_m"]) > 0.2
    with pytest.raises(BadInput, match=r"fluid-wild: column command_rad, row \d+: .* outside"):
        record("fluid", "pulley-fish", tmp_path / "two", 0, [tmp_path / "fluid-wild.csv"])
    assert not list((tmp_path / "two").glob("*"))


def test_given_commands_may_begin_at_any_time_of_day_and_names_are_checked_first(tmp_path):
    """Times of a log made a traceback of a billion steps, or held the first command for hours."""
    time = np.arange(0, 3, 0.02)
    sine = 0.4 * np.sin(2 * np.pi * 1.5 * time)
    for name, begin in (("a", 0.0), ("b", 1.7e9), ("c", -5.0)):
        one = Recording(name, begin + time, {"command_rad": sine})
        write_recording(one, tmp_path / name / "servo-mine.csv")
    found = []
    for name in "abc":
        (path,) = record("servo", "pulley-fish", tmp_path / f"out-{name}", 0,
                         [tmp_path / name / "servo-mine.csv"])  # fmt: skip
        found.append(read_recording(path).columns["angle_rad"])
    assert np.allclose(found[0], found[2]) and np.allclose(found[0], found[1], atol=2e-3)
    both = [tmp_path / name / "servo-mine.csv" for name in "ab"]
    made = record("servo", "pulley-fish", tmp_path / "both", 0, both)
    assert [path.name for path in made] == ["a-servo-mine.csv", "b-servo-mine.csv"]
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "x.csv").write_text("mine")
    write_recording(Recording("x", time, {"command_rad": sine}), tmp_path / "x.csv")
    with pytest.raises(BadInput, match=r"x\.csv: exists already"):
        record("servo", "pulley-fish", tmp_path / "taken", 0, [both[0], tmp_path / "x.csv"])
    assert [path.name for path in (tmp_path / "taken").iterdir()] == ["x.csv"]


@pytest.mark.parametrize("degrees", [45, 60, 70, 80])
def test_turning_swims_beat_however_narrow_the_motor_s_range(degrees):
    """Their centres were 0.8 rad for every fish: one of 45 degrees held its tail aside."""
    ends = (-np.radians(degrees), np.radians(degrees))
    one = load_fish("pulley-fish")
    fish = one.model_copy(update={"motor": one.motor.model_copy(update={"range": ends})})
    limit = limits(fish)
    for name, made in manoeuvres(fish, limit).items():
        command = made.columns["command_rad"]
        assert np.abs(command).max() <= limit.angle + 1e-9
        if name.endswith("turn"):
            late = command[len(command) // 2 :]
            assert np.ptp(late) > 0.2 * limit.angle, name
            assert abs(late.mean()) > 0.4 * limit.angle, name


@pytest.mark.thorough
def test_a_folder_without_a_bench_is_refused(folder, tmp_path):
    with pytest.raises(BadInput, match="begins with tail-sweep"):
        identify_all(
            ChainPaths("pulley-fish", tmp_path, tmp_path / "f.toml"),
            LITTLE,
            lambda *_: None,
            DRAWINGS,
        )
    with pytest.raises(BadInput, match="exist already"):
        record("tail", "pulley-fish", folder, 0)
    with pytest.raises(BadInput, match="allowed are tail, servo, fluid"):
        record("wings", "pulley-fish", tmp_path, 0)


def test_a_crank_plays_given_commands_and_has_no_protocol_of_its_own():
    time = np.arange(0, 2, 0.02)
    turning = Recording("turning", time, {"command_rad": 2 * np.pi * time})
    (swum,) = record_fluid(load_fish("crank-fish"), commands=[turning])
    assert swum.columns["motor_angle_rad"][-1] == pytest.approx(4 * np.pi, abs=0.8)
    with pytest.raises(BadInput, match="cannot swing to both sides"):
        next(record_fluid(load_fish("crank-fish")))
