"""The film of a run: its motion against the log and the twin, its pictures against the pose."""

import math
from dataclasses import replace
from pathlib import Path

import imageio.v2 as imageio
import mujoco
import numpy as np
import pytest

pytest.importorskip("mcap", reason="the robot extra is not installed")

from support import complaint, tailbeat
from tailbeat.cli import progress
from tailbeat.control.measure import arrival_of
from tailbeat.evaluate import motion as motions
from tailbeat.evaluate import swim
from tailbeat.evaluate.motion import Motion, Span, of_log, of_tour
from tailbeat.files import BadInput
from tailbeat.fish.description import length_of
from tailbeat.fish.store import load_fish
from tailbeat.fish.twin import Options, compile_twin
from tailbeat.identify.tag_pose import tracked_pose
from tailbeat.report import film as films
from tailbeat.report import film_frames as rendering
from tailbeat.report import tour as page
from tailbeat.report.film_frames import NoPicture, Shot, camera_of, rendered
from tailbeat.report.pool_scene import View, build_scene
from tailbeat.robot.log import read_rows, start
from tailbeat.robot.logged import fish_in

FISH = load_fish("pulley-fish")
SMALL = View(480, 270)
RATE = 30.0


def row(time: float, angle: float, pose: tuple[float, float, float], target=(1.0, 0.5)) -> dict:
    x, y, yaw = pose
    frame = [x, y, yaw, *target, 0.0]
    return {
        "time_s": 50.0 + time, "state": "run", "motor_angle_rad": angle, "pose_age_s": 0.03,
        "x_m": x, "y_m": y, "yaw_rad": yaw, "decided_on": [*frame, *frame, *frame],
    }  # fmt: skip


def write_log(path: Path, rows: list[dict]) -> Path:
    log = start(path, {"policy": "none", "fish": FISH.model_dump_json()})
    for one in rows:
        log.put(one)
    log.close()
    return path


@pytest.fixture(scope="module")
def toured():
    """Four seconds of the shipped policy in the pool's plant, in process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tailbeat.control.measure.PATIENCE", 4.0)
        config = swim.SwimConfig("pulley-fish-pool-generator", FISH.name, targets=1)
        return swim.direct(config, progress.counting)


@pytest.fixture(scope="module")
def swum(toured):
    return toured.tour


@pytest.fixture(scope="module")
def log(swum, tmp_path_factory) -> Path:
    """The same as a robot logs it: the tag's poses of a camera at 50 Hz, 30 ms late."""
    rows = [
        row(0.02 * k, shape[3], tuple(pose), tuple(swum.targets[0]))
        for k, (shape, pose) in enumerate(zip(swum.shape, swum.pose, strict=True))
    ]
    return write_log(tmp_path_factory.mktemp("film") / "swim.mcap", rows)


def test_a_log_s_motion_is_the_swim_s_own(swum, log):
    truth, found = of_tour(swum, Span(20), RATE), of_log(log, FISH, Span(20), RATE)
    assert abs(found.frames - 4.0 * RATE) <= 3 and found.qpos.shape[1] == swum.shape.shape[1]
    assert np.abs(tracked_pose(FISH, found.qpos[:, :3]) - found.tag).max() < 1e-9
    assert np.abs(found.qpos[:100, :2] - truth.qpos[:100, :2]).max() < 0.005
    assert np.allclose(found.target[5:], swum.targets[0]) and np.isnan(found.target[0]).all()
    # The film begins with the first pose, 30 ms before the first row: the shaft is a frame later.
    beats = np.corrcoef(found.qpos[20:100, 4:].sum(axis=1), truth.qpos[19:99, 4:].sum(axis=1))
    assert beats[0, 1] > 0.9  # the pool's tail and the twin's bend alike


def test_a_held_shaft_bends_the_tail_as_the_twin_s_statics_do():
    """Each hinge's spring balances the tendon's pull: q = pull * arm / k, sum of arm * q the
    pulley's travel."""
    angle, links = 0.5, FISH.tail.links
    at = np.linspace(0, 4, 50)
    shape = motions.bent_tail(FISH, at, np.full(50, angle), np.array([4.0]))
    assert shape is not None and shape[0, 0] == pytest.approx(angle, abs=1e-3)
    arms = np.array([np.mean([abs(guide[1]) for guide in one.guides]) for one in links])
    arms = np.array([19.5, 14.5, 10.8, 7.6, 4.5]) / 1000 if len(links) == 5 else arms
    give = arms / np.array([one.stiffness for one in links])
    expected = give * FISH.motor.radius * angle / (arms @ give)
    assert shape[0, 1:] == pytest.approx(expected, rel=0.05)
    mirrored = motions.bent_tail(FISH, at, np.full(50, -angle), np.array([4.0]))
    assert mirrored is not None and mirrored[0] == pytest.approx(-shape[0], abs=1e-6)


def test_the_scene_s_tail_is_the_twin_s(log):
    """The scene places each link where the twin has it at these coordinates."""
    found = of_log(log, FISH, Span(20), RATE)
    scene, twin = build_scene(FISH, SMALL), compile_twin(FISH, Options()).model
    assert scene.nq == twin.nq
    tips = []
    for model in (scene, twin):
        data = mujoco.MjData(model)
        data.qpos[:] = found.qpos[60]
        mujoco.mj_kinematics(model, data)
        tips.append(data.body(f"link{len(FISH.tail.links) - 1}").xpos[:2].copy())
    assert tips[0] == pytest.approx(tips[1], abs=1e-9)


def test_the_camera_s_noise_and_steps_are_smoothed_away(tmp_path):
    rng = np.random.default_rng(0)
    rows = []
    for k in range(200):
        x = 0.1 * 0.02 * (k // 2 * 2) + rng.normal(0, 0.001)
        rows.append(row(0.02 * k, 0.0, (x, 0.0, 3.1 + 0.01 * k if k < 5 else -3.1)))
    found = of_log(write_log(tmp_path / "a.mcap", rows), FISH, Span(20), RATE)
    speed = np.diff(found.tag[5:-5, 0]) * RATE
    assert np.abs(speed - 0.1).max() < 0.06  # the raw poses jump by 0.3 m/s
    assert np.abs(np.diff(found.tag[:, 2])).max() < 0.2  # no turn at the wrap


def turning(frames: int = 4) -> Motion:
    tag = np.column_stack(
        [np.linspace(0.5, 0.6, frames), np.full(frames, -0.4), np.full(frames, 0.7)]
    )
    rows = np.zeros((frames, 4 + len(FISH.tail.links)))
    rows[:, :3] = motions.root(FISH, tag)
    return Motion(RATE, rows, tag, np.full((frames, 2), np.nan))


def pictures(shot: Shot, frames: range) -> list[np.ndarray]:
    try:
        return list(rendered(shot, frames))
    except NoPicture as error:
        pytest.skip(str(error))


def project(camera: mujoco.MjvCamera, place: np.ndarray, view: View, fovy: float) -> np.ndarray:
    """Column and row of a place (3,) [m] by the camera's azimuth, elevation and distance."""
    a, e = math.radians(camera.azimuth), math.radians(camera.elevation)
    ahead = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([math.sin(a), -math.cos(a), 0.0])
    seen = place - (camera.lookat - camera.distance * ahead)
    up = np.cross(right, ahead)
    scale = view.height / 2 / math.tan(math.radians(fovy) / 2) / (seen @ ahead)
    return np.array(
        [view.width / 2 + scale * (seen @ right), view.height / 2 - scale * (seen @ up)]
    )


@pytest.mark.thorough
@pytest.mark.parametrize("side", ["follow", "side"])
def test_the_fish_s_pixels_are_where_its_pose_projects_to(side):
    here, away = turning(), turning()
    away.qpos[:, :2] += 100.0
    shots = [Shot(FISH, one, side, SMALL) for one in (here, away)]
    with_fish, without = (pictures(shot, range(1))[0].astype(float) for shot in shots)
    changed = np.argwhere(np.abs(with_fish - without).sum(axis=2) > 60)[:, ::-1]
    model = build_scene(FISH, SMALL)
    data = mujoco.MjData(model)
    data.qpos[:] = here.qpos[0]
    mujoco.mj_kinematics(model, data)
    camera = camera_of(shots[0], 0, motions.followed(here))
    for part in ("tag", "tail0", "fin"):
        middle = project(camera, data.geom(part).xpos, SMALL, model.vis.global_.fovy)
        assert np.abs(changed - middle).sum(axis=1).min() < 5, (part, middle)
    assert 100 < len(changed) < 0.1 * SMALL.width * SMALL.height


def test_the_tag_in_the_picture_is_the_fish_s_own_and_not_mirrored(monkeypatch):
    pyapriltags = pytest.importorskip("pyapriltags")
    monkeypatch.setattr(rendering, "FOLLOW_ELEVATION", -89.0)
    monkeypatch.setattr(rendering, "FOLLOW_DISTANCE", 0.6)
    image = pictures(Shot(FISH, turning(), "follow", View()), range(1))[0]
    grey = np.ascontiguousarray(image.mean(axis=2).astype(np.uint8))
    assert [one.tag_id for one in pyapriltags.Detector("tag36h11").detect(grey)] == [0]


@pytest.mark.thorough
def test_a_film_has_the_frames_and_length_asked_for(log, tmp_path):
    words = [log, "--seconds", "0.6", "--start", "1.0", "--json", tmp_path / "film.json"]
    done = tailbeat("film", *words, "--out", tmp_path / "a.mp4", "--view", "side")
    if "no GL library" in done.stderr:
        pytest.skip(done.stderr)
    assert done.returncode == 0, done.stderr
    movie = imageio.get_reader(tmp_path / "a.mp4")
    assert movie.get_meta_data()["size"] == films.SIZES[".mp4"]
    assert movie.count_frames() == 18  # type: ignore[attr-defined]
    movie.close()
    assert '"frames": 18' in (tmp_path / "film.json").read_text()


@pytest.mark.thorough
@pytest.mark.parametrize("end", [".webp", ".gif"])
def test_an_animated_picture_is_as_good_as_fits(log, tmp_path, monkeypatch, end):
    width, height = films.SIZES[end]
    coarse = np.random.default_rng(0).integers(0, 255, (2, height // 45, width // 40, 3), np.uint8)
    noise = coarse.repeat(45, axis=1).repeat(40, axis=2)
    noise = np.pad(noise, ((0, 0), (0, height - noise.shape[1]), (0, 0), (0, 0)))
    monkeypatch.setattr(
        films, "frames", lambda shot: (noise[k % 2] for k in range(shot.motion.frames))
    )
    best, less, none = (tmp_path / f"{name}{end}" for name in ("best", "less", "none"))
    assert tailbeat("film", log, "--seconds", "0.5", "--out", best).returncode == 0
    frames = imageio.mimread(best)
    assert len(frames) == int(0.5 * films.RATES[end])
    assert frames[0].shape[1::-1] == (width, height)
    monkeypatch.setattr(films, "LIMIT", best.stat().st_size - 1)
    assert tailbeat("film", log, "--seconds", "0.5", "--out", less).returncode == 0
    assert less.stat().st_size < best.stat().st_size
    monkeypatch.setattr(films, "LIMIT", 100)
    done = tailbeat("film", log, "--seconds", "0.5", "--out", none)
    assert done.returncode == 2 and "fewer --seconds" in done.stderr and not none.exists()


def _first_frame(log: Path) -> np.ndarray:
    out = log.with_suffix(".mp4")
    films.film(films.FilmConfig(log, out, Span(0.5)), lambda *_: None)
    return imageio.mimread(out)[0].astype(float)


def test_a_film_shows_the_fish_that_its_log_tells(log, tmp_path):
    shell, *rest = FISH.head.parts
    parts = (shell.model_copy(update={"size": (0.22, 0.03, 0.11)}), *rest)
    thin = FISH.model_copy(update={"head": FISH.head.model_copy(update={"parts": parts})})
    notes = {"own": {"fish": thin.model_dump_json()}, "policy": {"contract": "pulley-fish-pool"}}
    for name, head in notes.items():
        made = start(tmp_path / f"{name}.mcap", head)
        for one in read_rows(log):
            made.put(one)
        made.close()
    assert fish_in(log) == FISH and fish_in(tmp_path / "own.mcap") == thin
    assert fish_in(tmp_path / "policy.mcap") == load_fish("pulley-fish-pool")
    seen = [_first_frame(path) for path in (log, tmp_path / "own.mcap")]
    assert (np.abs(seen[0] - seen[1]).max(axis=2) > 60).sum() > 100


def test_a_log_that_tells_no_fish_asks_for_it(log, tmp_path):
    heads = {"none": {"policy": "p"}, "text": {"fish": "[1"}, "zero": {"fish": "{}"}}
    for name, head in heads.items():
        made = start(tmp_path / f"{name}.mcap", head)
        made.put(row(0.0, 0.0, (0.0, 0.0, 0.0)))
        made.close()
    with pytest.raises(BadInput, match=r"none.mcap: it does not tell which fish swam; .*--fish"):
        fish_in(tmp_path / "none.mcap")
    with pytest.raises(BadInput, match=r"text.mcap: the fish in its head is no JSON object"):
        fish_in(tmp_path / "text.mcap")
    with pytest.raises(BadInput, match=r"fish without a name: field name is missing"):
        fish_in(tmp_path / "zero.mcap")


def test_an_arrival_is_told_once_for_each_target():
    tag = np.column_stack([np.linspace(0, 1, 41), np.zeros(41), np.zeros(41)])
    target = np.where(np.arange(41)[:, None] < 24, [0.5, 0.0], [0.9, 0.0])
    motion = Motion(10.0, np.zeros((41, 9)), tag, target)
    assert motion.arrivals() == ((18, 0.5, 0.0), (34, 0.9, 0.0))
    small = replace(motion, arrival=0.025)
    assert small.arrivals() == ((19, 0.5, 0.0), (35, 0.9, 0.0))


def test_a_moving_target_is_no_arrival_in_a_film_and_one_that_rests_is():
    rate, count = 30.0, 90
    at = np.arange(count) / rate
    tag = np.column_stack([0.12 * at, np.zeros((count, 2))])
    moving = Motion(rate, np.zeros((count, 9)), tag, tag[:, :2] + [0.02, 0.0])
    assert [frame for frame, _, _ in moving.arrivals() if frame > 3] == []
    noise = np.random.default_rng(0).normal(scale=1e-3, size=(count, 2))
    resting = Motion(rate, np.zeros((count, 9)), tag, np.array([0.2, 0.0]) + noise)
    assert len(resting.arrivals()) == 1


def test_the_ring_about_a_target_is_of_the_fish_s_size():
    assert arrival_of(length_of(FISH)) == pytest.approx(0.05)
    assert arrival_of(0.28) == pytest.approx(0.025, rel=0.01)


def test_a_cut_off_log_is_filmed_up_to_its_end_and_said_to_be(log, tmp_path, monkeypatch):
    half = tmp_path / "half.mcap"
    half.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    black = np.zeros((270, 480, 3), np.uint8)
    monkeypatch.setattr(films, "frames", lambda shot: (black for _ in range(shot.motion.frames)))
    done = tailbeat("film", half, "--out", tmp_path / "half.gif")
    assert done.returncode == 0 and "cut off" in done.stdout
    seconds = float(done.stdout.split("half.gif: ")[1].split(" s")[0])
    assert 1.0 < seconds < 3.0
    whole = tailbeat("film", log, "--out", tmp_path / "whole.gif")
    assert whole.returncode == 0 and "cut off" not in whole.stdout


def refused(tmp_path: Path, *words: object) -> str:
    """What a film is refused with; nothing is left behind."""
    before = sorted(tmp_path.iterdir())
    said = complaint("film", *words)
    assert sorted(tmp_path.iterdir()) == before
    return said


def test_bad_logs_and_outputs_are_refused_in_one_sentence(log, tmp_path):
    empty, text, cut = (tmp_path / name for name in ("empty.mcap", "text.mcap", "cut.mcap"))
    empty.touch()
    text.write_text("time,x\n1,2\n")
    cut.write_bytes(log.read_bytes()[:300])
    for path in (empty, text, cut):
        assert "no row of a swim" in refused(tmp_path, path)
    assert "no such file" in refused(tmp_path, tmp_path / "none.mcap")
    blind = [{"time_s": 0.02 * k, "state": "run", "motor_angle_rad": 0.0} for k in range(50)]
    said = refused(tmp_path, write_log(tmp_path / "blind.mcap", blind))
    assert "no row has x_m, y_m, yaw_rad" in said and "camera" in said
    short = [row(0.02 * k, 0.0, (0.001 * k, 0, 0)) for k in range(10)]
    assert "10 poses" in refused(tmp_path, write_log(tmp_path / "short.mcap", short))
    out = tmp_path / "film.avi"
    assert ".mp4, .webp, .gif" in refused(tmp_path, log, "--out", out)
    assert "choose a folder" in refused(tmp_path, log, "--out", text / "a.mp4", "--seconds", 1)
    assert "exists already" in refused(tmp_path, log, "--out", text)
    for words in (("--seconds", "0"), ("--start", "-1"), ("--start", "60"), ("--pool", "3")):
        assert words[0] in refused(tmp_path, log, "--out", tmp_path / "a.mp4", *words)


def test_without_gl_the_film_says_so_and_leaves_nothing(log, tmp_path, monkeypatch):
    monkeypatch.setattr(mujoco.gl_context, "GLContext", None, raising=False)
    with pytest.raises(NoPicture, match="no GL library renders here"):
        next(rendered(Shot(FISH, turning(), "follow", SMALL), range(1)))
    monkeypatch.setattr(films, "frames", lambda shot: rendered(shot, range(1)))
    assert "no GL library" in refused(tmp_path, log, "--out", tmp_path / "a.mp4")


@pytest.mark.thorough
def test_a_tour_s_page_opens_with_the_film_or_says_why_there_is_none(toured, tmp_path, monkeypatch):
    width, height = films.SIZES[".mp4"]
    black = np.zeros((height, width, 3), np.uint8)
    monkeypatch.setattr(films, "frames", lambda shot: (black for _ in range(shot.motion.frames)))
    page.write(toured, tmp_path, progress.counting, film_seconds=0.3)
    text = (tmp_path / "report.html").read_text()
    assert 0 < text.index("<video") < text.index("<img")
    assert imageio.get_reader(tmp_path / "swim.mp4").count_frames() == 9  # type: ignore[attr-defined]
    monkeypatch.setattr(mujoco.gl_context, "GLContext", None, raising=False)
    monkeypatch.setattr(films, "frames", lambda shot: rendered(shot, range(1)))
    page.write(toured, tmp_path, progress.counting, film_seconds=0.3)
    text = (tmp_path / "report.html").read_text()
    assert "There is no film: no GL library" in text and "<video" not in text
    assert "<img" in text and not (tmp_path / "swim.mp4").exists()
