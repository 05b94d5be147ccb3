"""Outputs appear whole or not at all."""

import json

import numpy as np
import pytest

from tailbeat.files import BadInput, new_file, write_json


def test_failure_leaves_nothing_behind(tmp_path):
    with pytest.raises(RuntimeError), new_file(tmp_path / "a.txt") as path:
        path.write_text("half")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_existing_output_is_refused_and_kept(tmp_path):
    target = tmp_path / "a.json"
    target.write_text("old")
    with pytest.raises(BadInput, match=r"a\.json: exists already"):
        write_json(target, {})
    assert target.read_text() == "old"


def test_json_holds_numpy_and_no_nan(tmp_path):
    write_json(tmp_path / "b.json", {"a": np.arange(2), "b": np.float64("nan"), "c": (1.5, True)})
    assert json.loads((tmp_path / "b.json").read_text()) == {
        "a": [0, 1],
        "b": None,
        "c": [1.5, True],
    }


def test_a_full_disk_is_one_sentence_and_nothing_stays(tmp_path):
    with (
        pytest.raises(BadInput, match=r"a\.json: No space left on device; free some space"),
        new_file(tmp_path / "a.json"),
        open("/dev/full", "w", encoding="utf-8") as full,
    ):
        full.write("x" * 100_000)
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    for target in (tmp_path, tmp_path / "file" / "a.json"):
        with pytest.raises(BadInput, match=r"is a folder|choose a folder"):
            write_json(target, {}, overwrite=True)
