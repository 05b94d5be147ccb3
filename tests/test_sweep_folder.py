"""What a sweep keeps in its folder: copies of its fish, and how long each trial has trained."""

from dataclasses import asdict

import pytest

pytest.importorskip("ray", reason="the cluster extra is not installed")

from tailbeat.cli.sweep import _kept
from tailbeat.cluster import plan, trial
from tailbeat.files import BadInput, write_json
from tailbeat.fish.store import fish_path
from tailbeat.train.progress import Progress
from test_sweep import tiny


def test_the_pool_s_fish_is_copied_and_has_the_body_of_every_trial(tmp_path, monkeypatch):
    """Trials work in other folders, and would have found it missing after their training."""
    monkeypatch.chdir(tmp_path)
    text = fish_path("pulley-fish").read_text()
    (tmp_path / "lab.toml").write_text(text)
    (tmp_path / "other.toml").write_text(text.replace('"180 g"', '"190 g"'))
    path, out = tmp_path / "sweep.toml", tmp_path / "out"
    for name in ("other", "lab"):
        told = tiny(tmp_path).read_text() + f'[evaluate]\nfish = "{name}.toml"\nepisodes = 2\n'
        path.write_text(told)
        asked = plan.read(path)
        if name == "other":
            with pytest.raises(BadInput, match=r"trial pulley-fish-pool-seed-0: .*is not the pool"):
                _kept(path, asked, plan.trials(asked), out, False)
            assert not out.exists()
            continue
        for resume in (False, True):
            kept, _ = _kept(path, asked, plan.trials(asked), out, resume)
            assert kept.evaluate is not None and kept.evaluate.fish == str(out / "pool/lab.toml")
    assert (out / "pool" / "lab.toml").read_text() == text


def test_a_trial_s_hours_include_those_before_it_was_killed(tmp_path, monkeypatch):
    """They began anew each time: a trial of twelve hours that was killed late trained for a day."""
    made, folder, asked = plan.read(tiny(tmp_path)), tmp_path / "a", list[float]()
    run = trial.run_of(plan.trials(made)[0], made, folder)
    monkeypatch.setattr(trial, "train", lambda run, *_, **more: asked.append(run.hours))
    for before in (0.0, 2700.0, 4000.0):
        if before:
            state = {"decisions": 0, "updates": 0, "buffer": (0, False)}
            place = run.out / "checkpoint"
            write_json(place / "state.json", asdict(Progress(seconds=before)) | state, True)
            write_json(place / "random.json", {}, True)
        trial._learn(run)
    assert asked == pytest.approx([1.0, 0.25, 1 / 3600])
