"""What people type and what programs leave: each is one sentence, and nothing is half-written."""

from pathlib import Path

import pytest

from support import complaint, tailbeat
from tailbeat.fish.store import fish_path, load_fish

FISH = fish_path("pulley-fish").read_text("utf-8")
LONG = "n" * 300


def written(path: Path, old: str, new: str) -> Path:
    path.write_text(FISH.replace(old, new), encoding="utf-8")
    return path


def test_a_byte_order_mark_of_a_windows_editor_is_read_over(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xef\xbb\xbf" + FISH.encode())
    assert load_fish(path) == load_fish("pulley-fish")


def test_a_body_without_mass_and_a_size_beyond_all_are_named(tmp_path):
    light = tmp_path / "light.toml"
    lines = [line for line in FISH.split("\n") if not line.startswith("mass =")]
    light.write_text("\n".join(lines), encoding="utf-8")
    assert "mass" in complaint("show", light)
    huge = written(tmp_path / "huge.toml", 'size = "220 70 110 mm"', 'size = "1e300 70 110 mm"')
    assert "1e+300 is beyond 1e+10 in SI" in complaint("show", huge)
    bare = written(tmp_path / "bare.toml", 'size = "220 70 110 mm"', "size = [1e300, 0.07, 0.11]")
    assert "is beyond 1e+10 in SI" in complaint("show", bare)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("show", LONG), "File name too long; choose another path"),
        (("new-fish", f"{LONG}.toml", "--length", "280mm", "--mass", "350g"), "File name too long"),
        (("show", "pulley-fish", "--picture", "a.xyz"), "--picture a.xyz: allowed are .png"),
        (("record", "tail", "--fish", "pulley-fish", "--out", "d", "--seed", "-1"), "'--seed'"),
    ],
    ids=["fish", "new fish", "picture", "seed"],
)
def test_words_that_cannot_be_are_one_sentence(tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    assert said in complaint(*words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["deep.toml", "deep.json"])
def test_nesting_without_end_is_one_sentence(tmp_path, name):
    text = "a = " + "[" * 3000 + "]" * 3000 if name.endswith("toml") else "[" * 100_000
    (tmp_path / name).write_text(text)
    verb = ("show",) if name.endswith("toml") else ("import", "table")
    more = () if verb == ("show",) else ("--map", "time=t", "--out", tmp_path / "o.csv")
    done = tailbeat(*verb, tmp_path / name, *more)
    assert done.returncode == 2 and "nested too deeply" in done.stderr
