"""A mixture of nuisances that a user names in a file is a lab like the levels."""

import numpy as np
import pytest

from support import complaint

pytest.importorskip("gymnasium", reason="the train extra is not installed")

from tailbeat.control.policy import load_policy
from tailbeat.evaluate.evaluation import EvaluationConfig, conditions_of, describe, pool_of
from tailbeat.pool import mess

NAME = "pulley-fish-pool-generator"
MINE = '[lab]\ntag_sideways = "20 mm"\nservo_torque = "40 %"\ncurrent = "5 cm/s"\n'


@pytest.fixture
def mine(tmp_path):
    path = tmp_path / "my-lab.toml"
    path.write_text(MINE)
    return path


def test_its_sizes_are_those_of_the_file_and_the_rest_is_right(mine):
    sizes = mess.level(str(mine))
    assert sizes == pytest.approx({"tag sideways": 20, "servo torque": 40, "current": 5})
    lab = mess.lab_at(str(mine), 3)
    assert abs(lab.errors.left) == pytest.approx(0.02) and lab.errors.askew == 0
    assert lab.wear.limit in (pytest.approx(1.4), pytest.approx(1 / 1.4))
    assert lab.wear.slack == 0 and lab.wear.friction == 0
    rough = mess.lab_at("rough", 3)  # the same robot: sides do not depend on sizes
    assert np.sign(lab.errors.left) == np.sign(rough.errors.left)
    full = "\n".join(
        f'{one.name.replace(" ", "_")} = "{2 * one.everyday:.6g} {one.unit.replace("²", "^2")}"'
        for one in mess.NUISANCES
    )
    mine.write_text(f"[lab]\n{full}\n")
    assert mess.level(str(mine)) == pytest.approx(dict(mess.level("rough")))


def test_messy_labs_of_an_evaluation_have_it_beside_the_levels(mine):
    policy = load_policy(NAME)
    pool = pool_of(policy, EvaluationConfig(tasks=("messy",), episodes=3, lab=str(mine)))
    names = [one.name for one in conditions_of(pool, ["messy"])]
    assert names == [f"messy: {one}" for one in (*mess.LEVELS, "my-lab")]
    told = describe(policy, pool).lab
    mine.write_text(MINE.replace("40 %", "50 %"))
    assert describe(policy, pool).lab != told  # another file of the same name is another lab


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = 1\n", "no table [lab] in it"),
        ("[lab]\n", "no table [lab] in it"),
        ("[lab]\nslak = 3\n", "unknown field slak"),
        ('[lab]\nslack = "-3 deg"\n', "lab: slack = '-3 deg'"),
        ("[lab]\nslack = 3\n", "lab.slack is 171.9 deg; allowed is up to 60 deg"),
        ("[lab\n", "not valid TOML"),
    ],
)
def test_what_no_lab_can_be_is_one_sentence(mine, tmp_path, text, said):
    mine.write_text(text)
    words = ("record", "tail", "--fish", "pulley-fish", "--mess", mine, "--out", tmp_path / "out")
    assert said in complaint(*words)
    assert not (tmp_path / "out").exists()


def test_a_file_is_for_the_tasks_that_swim_in_labs(mine, tmp_path):
    words = ("evaluate", NAME, "--tasks", "reach", "--out", tmp_path / "e", "--mess")
    assert "it is for the task track or messy" in complaint(*words, mine)
    level = tmp_path / "rough.toml"
    level.write_text(MINE)
    assert "has the name of a level; rename the file" in complaint(*words, level)
    assert "no such file" in complaint(*words, tmp_path / "none.toml")
    assert not (tmp_path / "e").exists()
