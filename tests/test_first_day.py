"""The page that a lab prints before its first day: it says what was measured, and names the command
for what was not."""

import json
import math
import re
from html import unescape

import pytest

from policies import EARLIER
from support import complaint, tailbeat

pytest.importorskip("gymnasium", reason="the train extra is not installed")

from tailbeat.control.policy import contract_digest, load_policy
from tailbeat.evaluate.margin_cells import BASES, RESTS, Cell, Hits
from tailbeat.evaluate.margins import Margins, MarginsRun, numbers
from tailbeat.files import write_json
from tailbeat.fish.show import tables
from tailbeat.fish.store import load_fish
from tailbeat.pool.mess import BY_NAME, fingerprint
from tailbeat.robot import findings

NAME = "pulley-fish-pool-generator"
DIGEST = contract_digest(load_policy(NAME).contract)


def margins(folder, digest):
    """Margins of a made policy that stands three times everyday of every nuisance, once of an
    askew tag, and any latency."""
    run = MarginsRun(digest, "pulley-fish", "x", fingerprint(), 16, 0)
    stood = dict.fromkeys(BY_NAME, 3.0) | {"tag askew": 1.0, "latency": math.inf}
    table = {base: Hits((True,) * 16, (True,) * 16) for base in BASES.values()}
    for name, most in stood.items():
        for rest in RESTS:
            for factor in (1.0, 2.0, 4.0):
                hit = (factor <= most,) * 16
                table[Cell(name, rest, factor)] = Hits(hit, hit)
    found: Margins = numbers(table, tuple(BY_NAME), run, {})
    write_json(folder / "margins.json", found)
    return found


def text_of(folder):
    return unescape(re.sub("<[^>]+>", " ", (folder / "report.html").read_text()))


def test_the_page_names_what_nobody_measured_and_every_check(tmp_path):
    report = tmp_path / "day.json"
    own = ("--twin", EARLIER)
    done = tailbeat("first-day", NAME, *own, "--out", tmp_path / "page", "--json", report)
    assert done.returncode == 0, done.stderr
    text = text_of(tmp_path / "page")
    assert "tailbeat evaluate POLICY --tasks messy" in text
    assert "tailbeat margins POLICY" in text
    assert "<img" in (tmp_path / "page" / "report.html").read_text()
    assert all(check in text for check in findings.ADVICE)
    (command,) = re.findall(r"tailbeat doctor .*", text)
    words = command.replace("HOST:PORT", "127.0.0.1:1").split()
    answer = complaint(*words[1:], cwd=tmp_path)  # it is understood, and asks for what a lab has
    assert "FISH: no such" in answer or "PORT: no such" in answer, answer
    said = re.search(r"numbers that the recordings decide\s+(\d+) of 18", text)
    held = json.loads(report.read_text())
    assert said and int(said[1]) == held["decided"] and len(held["twin"]) == 18
    assert held["policy_digest"] == DIGEST and held["margins"] is held["messy"] is None
    assert held["checks"] == dict(findings.ADVICE) and held["length_m"] == pytest.approx(0.54)
    assert "exists" in complaint("first-day", NAME, "--out", tmp_path / "page")
    own_mass = tables(load_fish("pulley-fish-pool"))["fish"][0]["mass_kg"]  # as `show` prints it
    shown = re.search(r"mass \[kg\]\s+([\d.]+)", text)
    assert shown and own_mass == pytest.approx(1.218, abs=1e-3)  # without the water that it carries
    assert float(shown[1]) == pytest.approx(own_mass, rel=5e-3) and held["mass_kg"] == own_mass


def test_the_doubt_of_a_newer_twin_is_not_printed_as_that_of_the_policy_s(tmp_path):
    """The policy was trained before the shipped fish of its name was identified anew."""
    done = tailbeat("first-day", NAME, "--out", tmp_path / "page")
    assert done.returncode == 0, done.stderr
    text = text_of(tmp_path / "page")
    assert "numbers that the recordings decide" not in text
    assert "give its file with --twin" in text


@pytest.mark.thorough
def test_the_page_shows_the_thinnest_margin_first_and_what_widens_it(tmp_path):
    found = margins(tmp_path / "margins", DIGEST)
    assert found.thinnest[0] == "tag askew"
    out = tmp_path / "page"
    done = tailbeat("first-day", NAME, "--out", out, "--margins", tmp_path / "margins")
    assert done.returncode == 0, done.stderr
    text = text_of(out)
    first = text.index("tag askew: tag glued")
    assert all(first <= text.index(f"{name}: {one.what}") for name, one in BY_NAME.items())
    assert "glue the tag along a straight edge" in text
    words = " ".join(text.split())
    assert "latency: camera later than the contract ms 20 more than 150 more than 7.5" in words


@pytest.mark.thorough
def test_measurements_of_another_policy_are_refused(tmp_path):
    margins(tmp_path / "margins", "another")
    words = ("first-day", NAME, "--out", tmp_path / "page")
    said = complaint(*words, "--margins", tmp_path / "margins")
    assert "of another policy (another, not " in said
    assert not (tmp_path / "page").exists()


def test_a_folder_without_margins_is_refused(tmp_path):
    """A missing one, and one of a run that was interrupted."""
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / "margins-run.json").write_text("{}")
    for name in ("missing", "begun"):
        folder = tmp_path / name
        said = complaint("first-day", NAME, "--out", tmp_path / "page", "--margins", folder)
        assert f"{folder}: no margins in it" in said and "run `tailbeat margins` to its end" in said
    assert not (tmp_path / "page").exists()
