"""What is refused before any work begins, and what is said when Ctrl-C ends it."""

import pytest

from support import complaint, tailbeat

pytest.importorskip("gymnasium", reason="the train extra is not installed")

from tailbeat.cli import app
from tailbeat.files import check_json

NAME = "pulley-fish-pool-generator"
REFINE = ("refine", NAME, "--log", "x.mcap")


@pytest.mark.parametrize(
    ("words", "own"),
    [
        (REFINE, "refined.json policy.onnx retrained.onnx train/x.json"),
        (("first-day", NAME), "report.json report.html figures"),
        (("margins", NAME), "margins.json cells.json"),
        (("evaluate", NAME), "evaluation.json report.json run.json"),
        (("compare", NAME), "comparison.json cells/x.json"),
    ],
    ids=lambda given: given[0] if isinstance(given, tuple) else "",
)
def test_a_json_that_the_command_writes_itself_is_refused_at_once(words, own, tmp_path):
    """Also the folder itself, and another way to write its name."""
    for json in (*(f"R/{name}" for name in own.split()), "R", f"R/../R/{own.split()[0]}"):
        said = complaint(*words, "--out", "R", "--json", json, cwd=tmp_path)
        assert f"--json {json}: the command itself writes R/" in said
        assert not list(tmp_path.iterdir())


def test_any_other_file_in_its_folder_is_allowed(tmp_path):
    check_json(tmp_path / "R" / "mine.json", tmp_path / "R", "refined.json", "train")
    check_json(None, tmp_path, "refined.json")
    (tmp_path / "mine.json").touch()
    said = complaint("report", tmp_path, "--json", tmp_path / "mine.json")
    assert "mine.json: exists already" in said
    said = complaint("report", tmp_path, "--json", tmp_path / "report.json")
    assert "the command itself writes" in said


def test_an_empty_folder_name_is_refused(tmp_path):
    said = complaint(*REFINE, "--out", "", cwd=tmp_path)
    assert "'--out': the name is empty; give a folder" in said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("mess", ["clean", "ruined"])
def test_refining_is_measured_in_messy_labs_alone(mess):
    said = complaint("refinement", NAME, "--mess", mess)
    assert "nothing is wrong there" in said if mess == "clean" else "allowed are clean" in said


@pytest.mark.parametrize(
    ("verbs", "said"),
    [
        ("margins evaluate compare zoo", "interrupted; the same command resumes."),
        ("train sweep", "interrupted; the same command with --resume continues."),
        ("identify", "interrupted; the same command resumes the search."),
        ("swim", "interrupted."),
    ],
)
def test_ctrl_c_says_what_continues_as_the_help_does(verbs, said, monkeypatch):
    def stopped(words):
        raise KeyboardInterrupt

    for verb in verbs.split():
        shown = " ".join(tailbeat(verb, "--help").stdout.split())
        with monkeypatch.context() as patch:
            patch.setattr(app, "run", stopped)
            done = tailbeat(verb, "anything")
        assert done.returncode == 130 and done.stderr.strip().endswith(said), done.stderr
        if verb != "identify":  # its own verbs say it
            assert ("The same command resumes" in shown) == ("same command resumes" in said)
            assert ("--resume" in shown) == ("--resume" in said)
